"""What theory says of swept names, against closed forms of a scalar loop; and implementations on the command line."""

import json
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.integrate
from typer.testing import CliRunner

from qsmc_jax.cli.main import app
from qsmc_jax.robustness.limits import limits

STUDY = """
import qsmc_jax as qj
from qsmc_jax import actuators, noises, Implementation

class Scalar(qj.AbstractPlant):
    order = 1

    def drift(self, t, x):
        return 0.0 * x[0]

    def gain(self, t, x):
        return 2.0

def scenario(draw):
    milliseconds = draw.parameter("milliseconds", 1.0, bounds=(0.01, 1e3))
    delay = draw.parameter("delay", 0.0, bounds=(0.0, 20.0))
    limit = draw.parameter("limit", 10.0, bounds=(0.1, 100.0))
    nu = draw.parameter("nu", 0.01, bounds=(0.0, 1.0))
    mu = draw.parameter("mu", 2.0, bounds=(0.5, 4.0))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, mu, 0.1))
    loop = qj.ClosedLoop(Scalar(), qj.references.Constant(0.0), qj.disturbances.Constant(0.6), control, {made})
    return qj.Scenario(loop, x0=draw.uniform("x0", -0.3, 0.3, shape=(1,)), t1=8.0)

study = qj.Study(scenario, bandwidth=0.2)
"""
ALL = (
    "Implementation(1e-3 * milliseconds, delay=delay, saturation=limit, noise=noises.uniform(draw, 'noise', [nu]), "
    "queue=32)"
)
G, W, RHO = 2.0, 0.6, 0.1


def written(folder, made):
    path = Path(folder) / "study.py"
    path.write_text(STUDY.format(made=made))
    return path


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    from qsmc_jax.cli.study_file import Source, load_study

    return load_study(Source.read(written(tmp_path_factory.mktemp("limits"), ALL)), [])


def ideal_peak():
    """Of |u| in sigma' = w - g u from sigma = 0, by SciPy."""

    def rate(t, sigma):
        return W - G * np.tan(0.5 * np.pi * sigma / (np.exp(-2.0 * t) + RHO))

    ts = np.linspace(0.0, 8.0, 80001)
    sigma = scipy.integrate.solve_ivp(rate, (0.0, 8.0), [0.0], "Radau", t_eval=ts, rtol=1e-10, atol=1e-12).y[0]
    return np.max(np.abs(np.tan(0.5 * np.pi * sigma / (np.exp(-2.0 * ts) + RHO))))


def known(study, **grids):
    found = limits(study, {name: np.asarray(grid) for name, grid in grids.items()})
    return {(line.name, line.axis_name): line for line in found.thresholds}, found.scales


@pytest.mark.slow
def test_a_period_in_milliseconds_is_recognised(study):
    lines, scales = known(study, milliseconds=[1.0, 10.0, 100.0])
    wanted = 1e3 * 4.0 * RHO * G / (math.pi * (G**2 + W**2))
    # The loop rests at the end of the horizon; in the nominal run rho is still 1e-7 wider.
    assert lines["hold", "milliseconds"].value == pytest.approx(wanted, rel=1e-5)
    assert 0.0 < lines["hold, bounds met", "milliseconds"].value < wanted
    factor, label = scales["milliseconds"]
    assert factor * wanted == pytest.approx(2.0, rel=1e-5)
    assert "tau" in label


def test_delay_saturation_and_noise_are_recognised(study):
    lines, scales = known(study, delay=[0.001, 0.01], limit=[0.5, 5.0])
    assert lines["delay", "delay"].value == pytest.approx(RHO * G / (G**2 + W**2) - 0.5e-3, rel=1e-5)
    assert lines["peak of the ideal input", "limit"].value == pytest.approx(ideal_peak(), rel=1e-5)
    assert lines["bound on w met", "limit"].value == pytest.approx((W + 2.0 * 1.0) / G, rel=1e-9)
    assert scales["delay"][0] == pytest.approx(0.5 * math.pi * (G + W**2 / G) / RHO, rel=1e-5)
    lines, scales = known(study, nu=[0.01, 0.2])
    assert lines["noise as wide as the funnel", "nu"].value == pytest.approx(RHO)
    assert scales["nu"][0] == pytest.approx(1.0 / RHO)


def test_names_that_set_nothing_of_the_implementation_have_no_limits(study):
    assert known(study, mu=[1.0, 2.0]) == ({}, {})


@pytest.mark.slow
def test_a_map_has_its_thresholds_and_can_be_drawn_in_natural_units(tmp_path):
    out, path = tmp_path / "map", written(tmp_path, "Implementation(1e-3 * milliseconds)")
    grid = ["--over", "milliseconds=60,130", "--runs", "64", "--block", "64", "--dimensionless", "--out", str(out)]
    done = CliRunner().invoke(app, ["map", str(path), *grid, "--no-cache"])
    assert done.exit_code == 0, done.output
    content = json.loads((out / "map.json").read_text())
    (line,) = (line for line in content["thresholds"] if line["kind"] == "local")
    assert line["value"] == pytest.approx(1e3 * 4.0 * RHO * G / (math.pi * (G**2 + W**2)), rel=1e-5)
    assert content["claims"]["funnel"]["violated"] == [0, 64]


def test_a_run_of_an_implemented_loop_is_solved_in_full_and_written(tmp_path):
    out, path = tmp_path / "run", written(tmp_path, "Implementation(1e-3 * milliseconds)")
    done = CliRunner().invoke(app, ["simulate", str(path), "--index", "3", "--out", str(out), "--no-cache"])
    assert done.exit_code == 0, done.output
    assert "excess variation of u" in done.output
    numbers = json.loads((out / "run.json").read_text())
    assert numbers["verdict"] == "HELD"
    assert numbers["recovery_time"] == 0.0
    assert {"run.png", "signals.parquet"} <= {file.name for file in out.iterdir()}


def test_natural_units_are_refused_before_anything_is_solved(tmp_path):
    path = written(tmp_path, "Implementation(1e-3 * milliseconds)")
    grid = ["--over", "mu=1,2", "--dimensionless", "--out", str(tmp_path / "map")]
    done = CliRunner().invoke(app, ["map", str(path), *grid, "--no-cache"])
    assert done.exit_code == 2
    assert "`--dimensionless` needs a name with a natural unit, but `mu` has none" in done.output


@pytest.mark.parametrize(
    ("made", "words"),
    [
        ("Implementation(0.0)", "`sample_period` must be positive and finite, but is 0"),
        ("Implementation(-1e-3)", "`sample_period` must be positive and finite, but is -0.001"),
        ("Implementation(1.0, delay=9.0)", "`delay` must not be longer than the horizon, 8 s, but is 9"),
        ("Implementation(1e-3, saturation=0.0)", "`saturation` must be positive and finite, but is 0"),
        ("Implementation(1e-3, noise=noises.Uniform([-0.1]))", "`amplitude` must be finite and not negative"),
        ("Implementation(1e-3, noise=noises.White([-0.1]))", "`std` must be finite and not negative"),
        ("Implementation(1e-3, actuator=actuators.ThirdOrderLag(0.1))", "has no attribute 'ThirdOrderLag'"),
        ("Implementation(1e-3, actuator='third order')", "actuator"),  # by whichever check comes first
    ],
)
@pytest.mark.parametrize("command", [("verify",), ("map", "--over", "mu=1,2")], ids=["verify", "map"])
def test_bad_implementations_exit_2_and_are_named(tmp_path, command, made, words):
    done = CliRunner().invoke(app, [command[0], str(written(tmp_path, made)), *command[1:], "--no-cache"])
    assert done.exit_code == 2
    assert words in done.output
    assert "Traceback" not in done.output

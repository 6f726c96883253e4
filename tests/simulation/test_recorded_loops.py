"""Loops with recorded signals: no sample is stepped over, by closed forms and by SciPy started anew at each sample."""

import dataclasses
import math

import numpy as np
import pytest
import scipy.integrate
import scipy.optimize
from scipy.interpolate import CubicSpline, PchipInterpolator
from typer.testing import CliRunner

import qsmc_jax as qj
from own_plants import Scalar
from problems import chain
from qsmc_jax.cli.main import app

T1, SAMPLES, AT = 0.08, 4001, 2717  # steps would be a thousand times as long as a sample
TIMES = np.linspace(0.0, T1, SAMPLES)
FUNNEL = qj.Funnel(4.0, 1.0, 0.05)
IMPLEMENTED = qj.Implementation(sample_period=0.03)
SPACING = T1 / (SAMPLES - 1)


ENGINES = pytest.mark.parametrize("implementation", [None, IMPLEMENTED], ids=["ideal", "implemented"])
# Of the held samples of d, of those joined by lines, and of the reference.
SPIKES = pytest.mark.parametrize("heights", [(1e6, 0, 0), (0, 1e6, 0), (0, 0, -9)], ids=["held", "lines", "reference"])


def spike(kind, height):
    times = TIMES if height else 1000.0 * TIMES  # what has no spike must not lend its samples to what has one
    return qj.Recording(times, np.where(np.arange(SAMPLES) == AT, 1.0 * height, 0.0), kind)


def simulate(implementation, held, lines, reference):
    """A loop without a gain under spikes of these heights: one program for an engine, whichever has one."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL)
    disturbance = qj.disturbances.Recorded(spike("hold", held)) + qj.disturbances.Recorded(spike("linear", lines))
    desired = qj.references.Recorded(spike("linear", reference))
    loop = qj.ClosedLoop(chain(1)(gain_scale=0.0), desired, disturbance, control, implementation)
    return qj.simulate(loop, [0.0], T1, ts=np.array([0.0, T1]))


def sigma(t, held, lines, reference):
    """The integral of d less the reference: nothing else moves the plant."""
    s = (t - TIMES[AT]) / SPACING
    rise, fall = min(max(s + 1.0, 0.0), 1.0), min(max(s, 0.0), 1.0)
    return SPACING * (held * fall + lines * (0.5 * rise**2 + fall - 0.5 * fall**2)) - reference * (rise - fall)


@ENGINES
@SPIKES
def test_one_large_sample_among_thousands_is_met_when_it_comes(heights, implementation):
    run = simulate(implementation, *heights)
    outside = lambda t: sigma(t, *heights) - 4.0 * math.exp(-t) - 0.05  # noqa: E731
    leaves = scipy.optimize.brentq(outside, TIMES[AT - 1], TIMES[AT if heights[2] else AT + 1], xtol=1e-15)
    assert run.verdict.name == "VIOLATED"
    assert float(run.metrics.violation_time) == pytest.approx(leaves, abs=1e-9)


@ENGINES
def test_a_sample_that_is_not_too_large_has_its_effect_and_no_more(implementation):
    run = simulate(implementation, 0.03 / SPACING, 0.01 / SPACING, 0.0)
    assert run.verdict.name == "HELD"
    assert float(run.x[-1, 0]) == pytest.approx(0.04, rel=1e-6)


@pytest.mark.slow
def test_a_tracked_record_is_what_scipy_makes_of_it_from_sample_to_sample():
    generator, times = np.random.default_rng(2), np.linspace(0.0, 2.0, 21)
    wanted, push = np.sin(times) + generator.normal(0.0, 2e-3, 21), generator.normal(0.0, 0.5, 21)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(4.0, 1.0, 0.3))
    reference = qj.references.Recorded(qj.Recording(times, wanted, "pchip"))
    disturbance = 2.0 * qj.disturbances.Recorded(qj.Recording(times, push, "cubic"))
    loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), reference, disturbance, control)
    run = qj.simulate(loop, [0.3, 0.5], 2.0, ts=times, settings=qj.SolverSettings(rtol=1e-9, atol=1e-9))
    desired, d, plant = PchipInterpolator(times, wanted), CubicSpline(times, push), loop.plant
    mass, length, friction, gravity = (float(getattr(plant, n)) for n in ("mass", "length", "friction", "gravity"))

    def rate(t, x):
        value = 2.0 * (x[0] - desired(t)) + x[1] - desired(t, nu=1)
        u = -math.tan(0.5 * math.pi * value / (4.0 * math.exp(-t) + 0.3))
        drift = -gravity / length * math.sin(x[0]) - friction / mass * x[1] + math.sin(x[1])
        return [x[1], drift + u / (mass * length**2) + 2.0 * d(t)]

    x = np.array([0.3, 0.5])
    for i, (a, b) in enumerate(zip(times, times[1:], strict=False)):
        x = scipy.integrate.solve_ivp(rate, (a, b), x, "LSODA", rtol=1e-11, atol=1e-12).y[:, -1]
        np.testing.assert_allclose(np.asarray(run.x)[i + 1], x, rtol=1e-6, atol=1e-7)


def steps(times, others, t1):
    """Of a loop that is pushed by a record, and by steps at other times."""
    values = np.where(np.arange(len(times)) % 2, 0.5, -0.5)
    disturbance = qj.disturbances.Recorded(qj.Recording(times, values, "hold", "hold"))
    disturbance = disturbance + qj.disturbances.Telegraph(others, np.r_[0.0, 0.25 * values])
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL)
    loop = qj.ClosedLoop(chain(1)(), qj.references.Constant(0.0), disturbance, control)
    run = qj.simulate(loop, [0.5], t1, ts=np.array([0.0, 1.0]))
    assert run.verdict.name == "HELD"
    return int(run.metrics.steps), np.asarray(run.x)


@pytest.mark.slow
@pytest.mark.parametrize("samples", [41, 101], ids=["one by one", "in a table"])
def test_times_that_are_the_same_but_for_rounding_cost_no_steps(samples):
    times = np.linspace(0.0, 2.0, samples)
    count, x = steps(times, times, 2.0)
    for others in (np.nextafter(times, np.inf), np.nextafter(times, -np.inf), times * (1.0 + 3e-14)):
        for t1 in (2.0, np.nextafter(2.0, 3.0), np.nextafter(2.0, 1.0)):
            found, y = steps(times, others, t1)
            assert found < count + samples // 4
            np.testing.assert_allclose(y, x, rtol=1e-9)


def short(where="disturbance", beyond="refuse", implementation=None):
    recording = qj.Recording([0.0, 1.0, 2.0], [0.1, 0.3, 0.2], "linear", beyond)
    reference, disturbance = qj.references.Constant(0.0), qj.disturbances.Zero()
    if where == "reference":
        reference = qj.references.Recorded(recording)
    else:
        disturbance = 0.5 * qj.disturbances.Recorded(recording)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL)
    return qj.ClosedLoop(chain(1)(), reference, disturbance, control, implementation)


@pytest.mark.parametrize("where", ["disturbance", "reference"])
def test_a_horizon_beyond_the_record_is_refused(where):
    for ask in (lambda: qj.simulate(short(where), [0.1], 2.5), lambda: qj.Scenario(short(where), [0.1], 2.5)):
        with pytest.raises(
            qj.InputError, match=r"`t1` must not lie beyond a recording that ends at 2 s, but is 2\.5\."
        ):
            ask()
    assert qj.Scenario(short(where), [0.1], 2.0).t1 == 2.0
    assert qj.Scenario(short(where, "hold"), [0.1], 2.5).t1 == 2.5


def test_a_record_that_begins_too_late_is_refused():
    late = dataclasses.replace(short(), disturbance=qj.disturbances.Recorded(qj.Recording([0.5, 3.0], [1.0, 2.0])))
    with pytest.raises(qj.InputError, match=r"must begin at 0 s or before, as runs do, but begins at 0\.5 s"):
        qj.Scenario(late, [0.1], 2.0)


@pytest.mark.slow
def test_runs_whose_drawn_horizon_lies_beyond_the_record_are_inadmissible():
    def scenario(draw):
        return qj.Scenario(short(), [0.1], draw.uniform("t1", 1.0, 2.8))

    runs = qj.monte_carlo(qj.Study(scenario, bandwidth=0.1, metrics="claims"), runs=64, block=64)
    verdicts = np.where(runs["t1"] > 2.0, int(qj.Verdict.INADMISSIBLE), int(qj.Verdict.HELD))
    assert np.array_equal(runs["verdict"], verdicts)
    assert 0 < np.sum(runs["t1"] > 2.0) < 64


def test_the_record_belongs_to_the_identity_of_a_study():
    def contents(values):
        recording = qj.Recording(10.0 * TIMES, values, "hold", "hold")
        loop = dataclasses.replace(short(), disturbance=qj.disturbances.Recorded(recording))
        return qj.Study(lambda draw: qj.Scenario(loop, [0.1], draw.uniform("t1", 1.0, 2.8)), bandwidth=0.1).contents

    values = np.zeros(SAMPLES)
    assert contents(values) == contents(values.copy())
    assert contents(values) != contents(np.where(np.arange(SAMPLES) == AT, 1e-12, 0.0))


STUDY = """
from pathlib import Path
import qsmc_jax as qj

wind = qj.disturbances.Recorded(qj.Recording.from_csv(Path(__file__).with_name("wind.csv"), time="t", value="speed"))

def scenario(draw):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(4.0, 3.0, 0.05))
    loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), qj.references.SumOfSines([1.0], [1.0]), wind, control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.5)

study = qj.Study(scenario, bandwidth=0.1)
"""


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("t,speed\n0,1\n2,1\n", "must not lie beyond a recording that ends at 2 s, but is 2.5"),
        ("t,speed\n0,1\n2,x\n", "Row 3 of column `speed` of"),
    ],
)
def test_the_command_line_calls_it_bad_input(tmp_path, text, said):
    (tmp_path / "wind.csv").write_text(text)
    (tmp_path / "study.py").write_text(STUDY)
    done = CliRunner().invoke(app, ["simulate", str(tmp_path / "study.py"), "--no-cache"])
    assert done.exit_code == 2
    assert said in " ".join(done.output.split())


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["hold", "linear"])
def test_a_plant_in_its_own_coordinates_meets_it_too(kind):
    control, rest = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL, -1.0), qj.references.Constant(0.0)
    recorded = 1.0 * (qj.disturbances.Recorded(spike(kind, 1e6)) + qj.disturbances.Zero())
    run = qj.simulate(qj.ClosedLoop(Scalar(1e-9), rest, recorded, control), [0.0], T1, ts=np.array([0.0, T1]))
    assert run.verdict is qj.Verdict.VIOLATED
    before = SPACING if kind == "linear" else 0.0
    width = 4.0 * math.exp(-TIMES[AT]) + 0.05
    # What a sample of 1e6 adds: a straight line, or a parabola from the sample before.
    after = width / 1e6 if kind == "hold" else math.sqrt(2.0 * width * SPACING / 1e6)
    assert float(run.metrics.violation_time) == pytest.approx(TIMES[AT] - before + after, rel=1e-5)

"""`qsmc tune` end to end: files, exit codes, and gains handed on to other commands."""

import json

import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

from qsmc_jax.cli.main import app

STUDY = """
import jax.numpy as jnp
import qsmc_jax as qj

class Integrator(qj.AbstractPlant):
    order = 1
    def drift(self, t, x):
        return 0.0 * x[0]
    def gain(self, t, x):
        return 1.0

def scenario(draw):
    mu = draw.parameter("mu", 1.0, bounds=(0.5, 2.0))
    funnel = qj.Funnel(draw.parameter("rho0", 5.0, bounds=(1.6, 20.0)), mu, 0.1)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel)
    loop = qj.ClosedLoop(Integrator(), qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=jnp.atleast_1d(draw.uniform("x0", 0.5, 1.0)), t1=6.0)

study = qj.Study(scenario, bandwidth=0.5)
"""
QUICK = ("--runs", "16", "--block", "64", "--no-cache", "--starts", "1")


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("tune") / "study.py"
    path.write_text(STUDY)
    return str(path)


def qsmc(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.mark.slow
def test_a_tuning_writes_its_folder_and_its_gains_can_be_verified(file, tmp_path):
    out = tmp_path / "out"
    options = (
        "--objective",
        "mean(energy_u)",
        "--subject-to",
        "worst(rms_error) <= 0.5",
        "--against",
        "mean(rms_error)",
    )
    rest = ("--certificate-runs", 1200, "--points", 3, "--out", out)
    done = qsmc("tune", file, "--for", "rho0,mu", *options, *QUICK, *rest)
    assert done.exit_code == 0, done.output
    assert "CERTIFIED" in done.output
    assert {path.name for path in out.iterdir()} == {
        "result.npz",
        "tuning.json",
        "tuning.parquet",
        "tuning.png",
        "before_after.png",
        "landscape.png",
        "pareto.png",
    }
    content = json.loads((out / "tuning.json").read_text())
    assert content["best"]["objective"] < content["before"]["objective"]
    table = pq.read_table(out / "tuning.parquet")
    assert table["n_simulations"].to_pylist()[-1] == content["simulations"]
    assert content["best"]["objective"] in table["objective"].to_pylist()
    checked = qsmc("verify", file, "-S", f"@{out}", "--runs", 64, "--block", 64, "--json", "--no-cache")
    assert json.loads(checked.stdout)["values"] == content["gains"]


@pytest.mark.slow
def test_what_is_not_certified_exits_with_3(file):
    options = ("--objective", "mean(energy_u)", "--certificate-runs", 20, "--designs", 1, "--json")
    done = qsmc("tune", file, "--for", "rho0", *options, *QUICK)
    assert done.exit_code == 3
    assert json.loads(done.stdout)["conclusion"].startswith("NOT CERTIFIED")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--for", "nu", "--objective", "mean(energy_u)"), "Did you mean `mu`"),
        (("--for", "mu", "--objective", "median(energy_u)"), "must be made of mean(m)"),
        (("--for", "mu", "--objective", "mean(energy_u)", "--subject-to", "mean(energy_u)"), "comparison"),
        (("--for", "mu", "--objective", "mean(energy_u)", "-S", "@nowhere"), "must name a result of `qsmc tune`"),
        (("--for", "mu", "--objective", "mean(energy_u)", "-S", "mu=9"), "must lie in [0.5, 2]"),
    ],
)
def test_bad_input_exits_with_2_and_is_named(file, arguments, message):
    done = qsmc("tune", file, *arguments, *QUICK)
    assert done.exit_code == 2
    assert message in " ".join(done.output.split())

"""Every setting of a solve acts in a batch as it does in a replay, and a printed command has all of them."""

import re
import shlex

import numpy as np
import pytest
from typer.testing import CliRunner

import places
import qsmc_jax as qj
from qsmc_jax.campaign.commands import solver_options
from qsmc_jax.cli.main import app

STUDY = str(places.STUDY)
USUAL = qj.SolverSettings(method="tsit5")


def scenario(draw):
    return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)


study = qj.Study(scenario, bandwidth=0.1)


@pytest.mark.parametrize("changed", [{"rtol": 1e-4}, {"atol": 1e-4}, {"atol": 1e-11}, {"max_steps": 30}])
@pytest.mark.slow
def test_a_setting_acts_in_batches_as_in_replays(changed):
    settings = USUAL.replace(**changed)
    usual, rows = (qj.monte_carlo(study, 64, block=64, settings=each) for each in (USUAL, settings))
    assert not np.array_equal(rows["steps"], usual["steps"])
    for i in (0, 5, 33):
        again = study.replay(i, settings=settings).metrics
        assert int(again.steps) == rows["steps"][i]
        assert int(again.verdict) == rows["verdict"][i]


@pytest.mark.parametrize(
    ("settings", "options"),
    [
        (qj.SolverSettings(), ""),
        (qj.SolverSettings(rtol=1e-7), "--rtol 1e-07"),
        (qj.SolverSettings(rtol=1.0 / 3.0 * 1e-6, max_steps=7), "--rtol 3.333333333333333e-07 --max-steps 7"),
        (qj.SolverSettings(atol=1.23456789012345e-9), "--atol 1.23456789012345e-09"),
        (qj.SolverSettings(1e-7, method="other"), "--rtol 1e-07 --method other"),
    ],
)
def test_a_command_has_every_digit_of_what_is_not_the_default(settings, options):
    assert shlex.join(solver_options(settings)) == options


@pytest.mark.slow
@pytest.mark.parametrize(
    "options", [["--max-steps", "25"], ["--rtol", "0.05"], ["-S", "gain_sign=-1"], ["-S", "mu=1.4142135623730951"]]
)
def test_a_printed_command_gives_the_printed_verdict(options):
    command = ["verify", STUDY, "--runs", "64", "--block", "64", "--method", "tsit5", "--no-cache", *options]
    done = CliRunner().invoke(app, command)
    found = re.search(r"^ +(?P<finding>.*?)   (?P<command>qsmc simulate .*)$", done.stdout, re.MULTILINE)
    assert found, done.output
    said = {"left": "VIOLATED", "sup": "HELD", "UNDE": "UNDECIDED", "INAD": "INADMISSIBLE"}
    expected = next(verdict for begin, verdict in said.items() if found["finding"].startswith(begin))
    again = CliRunner().invoke(app, [*shlex.split(found["command"])[1:], "--no-cache"])
    assert f"funnel {expected}" in again.stdout, (found["command"], again.output)

"""What a study asks for of the standard metrics: less is worked out, and what is said is the same."""

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import qsmc_jax as qj
from places import STUDY
from qsmc_jax.cli.main import app
from qsmc_jax.study.batches import BatchSolver
from studies_for_tests import Integrator, study

CLAIMS = {"verdict", "verdict_reaching", "verdict_tracking", "outcome", "end_time", "peak_ratio", "margin", "peak_u"}
CLAIMS |= {"reach_time", "violation_time", "settle_time", "least_gain", "largest_disturbance", "steps"}
FEWER = study.asking("claims")


def sampled(draw):
    """x' = d + u, sampled: slow enough to leave the bandwidth in some runs, and late."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
    made = qj.Implementation(sample_period=draw.uniform("period", 0.01, 0.3), delay=0.02)
    noise = qj.disturbances.Sine(draw.uniform("a", 0.1, 0.9), 2.0, 0.0)
    loop = qj.ClosedLoop(Integrator(1.0), qj.references.Constant(0.0), noise, control, made)
    return qj.Scenario(loop, x0=draw.uniform("x0", -0.5, 0.5, shape=(1,)), t1=4.0)


def solved(made, runs=64):
    return qj.monte_carlo(made, runs, seed=3, block=64)


def flops(made):
    solver = BatchSolver(made, qj.SolverSettings(), 64)
    program = solver.compile(solver.nominal_method)
    return program.cost_analysis()["flops"], program.as_text().count(" parameter(")


@pytest.mark.as_users
@pytest.mark.slow
@pytest.mark.parametrize("make", [lambda: study, lambda: qj.Study(sampled, bandwidth=0.2)], ids=["ideal", "sampled"])
def test_rows_of_a_study_that_asks_for_less_are_the_same_where_they_are(make):
    whole, drawn = solved(make()), {"index", *(column for spec in make().specs for column in spec.columns)}
    fewer = solved(make().asking("claims"))
    assert set(fewer) == drawn | CLAIMS
    assert len(set(whole["verdict"])) > 1
    for column in fewer:
        assert np.array_equal(fewer[column], whole[column], equal_nan=True), column
    assert {"energy_u", "rms_error", "peak_error[0]", "peak_u_bound"} <= set(whole)


def test_what_is_not_asked_for_is_neither_worked_out_nor_carried():
    (whole, carried), (fewer, carried_fewer) = flops(study), flops(FEWER)
    assert fewer < 0.9 * whole
    assert carried_fewer < carried


def test_single_metrics_can_be_asked_for_and_own_ones_come_with_the_standard_ones_or_without():
    own = qj.metrics.Peak("top", lambda s: jnp.abs(s.x[0]))
    made = [qj.Study(study.scenario, bandwidth=0.2, metrics=given) for given in ([own], ["claims", own], "standard")]
    assert [each.measured for each in made] == [("top",), ("top",), ()]
    assert set(made[0].standard) == set(made[2].standard) == set(qj.metrics.catalogue())
    # Of these only loops of plants in their own coordinates have the first, only those with several inputs the others.
    assert set(made[1].standard) == CLAIMS | {"coordinate_drift", "peak_barrier", "barrier_bound"}
    rows = solved(qj.Study(study.scenario, bandwidth=0.2, metrics=["energy_u", "peak_error", own]))
    assert set(rows) == {"index", "mu", "gain_sign", "t1", "d", "g", "x0[0]"} | CLAIMS | {
        *("energy_u", "peak_error[0]", "top")
    }


@pytest.mark.slow
def test_what_the_claims_need_holds_a_verification_and_a_map_up():
    whole, fewer = (qj.verify(each, runs=256, block=64) for each in (study, FEWER))
    assert [each.violated for each in fewer.claims] == [each.violated for each in whole.claims]
    assert list(fewer.worst["index"]) == list(whole.worst["index"])
    found = qj.robustness_map(FEWER, over={"t1": [1.0, 6.0]}, runs=64, block=64)
    assert set(found.medians) == {"peak_ratio"}


def test_what_was_substituted_stays_and_a_study_may_ask_again():
    made = study.substitute(mu=2.0).asking("claims").asking("standard")
    assert made.values["mu"] == 2.0
    assert set(solved(made)) == set(solved(study))
    assert study.asked == ("standard",)


BAD = {
    "misspelt": (lambda: study.asking("energy"), "Argument `metrics` names `energy`, which is no metric"),
    "suggested": (lambda: study.asking("claim"), "Did you mean `claims`?"),
    "a set": (lambda: qj.Study(study.scenario, bandwidth=0.2, metrics={"claims"}), "must be a list of metrics"),
    "a function": (lambda: qj.Study(study.scenario, bandwidth=0.2, metrics=[abs]), "Use those of `qj.metrics`"),
    "an objective": (
        lambda: qj.tune(FEWER, ["mu"], "mean(energy_u)", runs=64),
        "names `energy_u`, which `metrics` of the study leaves out",
    ),
    "a constraint": (
        lambda: qj.tune(FEWER, ["mu"], "mean(peak_ratio)", subject_to=["worst(total_variation_u) <= 3"], runs=64),
        "names `total_variation_u`, which `metrics` of the study leaves out",
    ),
    "a comparison": (
        lambda: qj.compare({"a": FEWER, "b": FEWER}, runs=64, metrics=["rms_error"], block=64),
        "There is no column `rms_error`",
    ),
}


@pytest.mark.parametrize(("attempt", "message"), BAD.values(), ids=BAD)
def test_metrics_that_there_are_not_or_that_nobody_asked_for_are_named(attempt, message):
    with pytest.raises(qj.InputError, match=message.replace("?", r"\?")):
        attempt()


def qsmc(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.mark.slow
def test_a_campaign_keeps_what_it_was_asked_for(tmp_path):
    verify = "verify", STUDY, "--runs", 128, "--block", 64, "--no-cache", "--out", tmp_path / "run"
    asked = "--metrics", "claims, energy_u"
    first = qsmc(*verify, *asked)
    assert first.exit_code == 0, first.output
    rows = qj.load(tmp_path / "run")
    assert "energy_u" in rows
    assert "rms_error" not in rows
    other = qsmc(*verify)
    assert other.exit_code == 2
    assert "`metrics`" in other.output
    assert qsmc("show", tmp_path / "run", "--run", 5, "--no-cache").exit_code in (0, 1)
    assert "--metrics claims,energy_u" in (tmp_path / "run" / "report.html").read_text()


def test_a_command_names_a_metric_that_there_is_not():
    done = qsmc("verify", STUDY, "--metrics", "claims,peak", "--no-cache")
    assert done.exit_code == 2
    assert "Argument `metrics` names `peak`, which is no metric" in done.output

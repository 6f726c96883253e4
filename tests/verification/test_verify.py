"""Verification: counts, intervals, refusals. Truth: the scalar loop's closed forms, and SciPy's intervals."""

import numpy as np
import pytest
import scipy.stats

import qsmc_jax as qj
from studies_for_tests import study

RUNS, BLOCK = 200, 64


@pytest.fixture(scope="module")
def result():
    """One verification that the tests share, with all its rows."""
    rows = []
    found = qj.verify(study, RUNS, seed=1, block=BLOCK, sink=rows.append)
    return found, rows


def test_a_loop_that_meets_the_premises_holds(result):
    found, _ = result
    assert found.verdict == qj.Verdict.HELD
    assert [claim.violated + claim.undecided for claim in found.claims] == [0, 0, 0]


def test_starts_outside_the_funnel_are_inadmissible_and_counted_apart(result):
    """x0 is uniform on [-1, 1.2] and rho(0) = 1.1: the fraction 0.1 / 2.2 starts outside."""
    found, rows = result
    claim = found.claims[0]
    outside = np.concatenate([np.abs(table["x0[0]"]) >= 1.1 for table in rows])
    assert 0 < claim.inadmissible == outside.sum()
    assert claim.held + claim.inadmissible == RUNS


def test_the_interval_is_clopper_pearsons_over_the_admissible_runs(result):
    claim = result[0].claims[0]
    expected = scipy.stats.binomtest(0, claim.held).proportion_ci(0.95, method="exact")
    assert (claim.low, claim.high) == pytest.approx((expected.low, expected.high), rel=1e-9)


def test_every_run_reaches_the_sink_once(result):
    indices = np.concatenate([table["index"] for table in result[1]])
    assert sorted(indices) == list(range(RUNS))


def test_the_peak_is_the_start_or_the_equilibrium(result):
    """sup|z| >= |z(0)| and >= (2/pi) atan(|d|/g), the equilibrium; the comparison lemma from above."""
    rows = result[1][0]
    rows = rows.take(rows["verdict"] == qj.Verdict.HELD)
    start, equilibrium = np.abs(rows["x0[0]"]) / 1.1, 2 / np.pi * np.arctan(np.abs(rows["d"]) / rows["g"])
    assert np.all(rows["peak_ratio"] >= np.maximum(start, equilibrium * (1 - 1e-3)) - 1e-5)
    allowed = np.maximum(np.tan(np.pi / 2 * start), (np.abs(rows["d"]) + 1.0) / rows["g"])
    assert np.all(rows["peak_u"] <= allowed * (1 + 1e-5))


def test_the_worst_runs_come_first_and_can_be_replayed(result):
    found, rows = result
    margins = np.concatenate([table["margin"] for table in rows])
    assert found.worst["margin"][0] == np.nanmin(margins)
    index = int(found.worst["index"][0])
    assert float(study.replay(index, 1).metrics.margin) == pytest.approx(np.nanmin(margins), rel=1e-6)


def test_the_numerical_error_is_small_and_measured(result):
    error = result[0].numerical_error
    assert error.checked >= BLOCK - 10
    assert 0 < error.peak_ratio < 20e-6
    assert error.changed == 0


def test_a_wrong_gain_sign_is_violated_and_confirmed():
    found = qj.verify(study.substitute(gain_sign=-1.0), BLOCK, block=BLOCK)
    claim = found.claims[0]
    assert found.verdict == qj.Verdict.VIOLATED
    assert claim.violated + claim.inadmissible == BLOCK
    assert found.escalated == (claim.violated, 0)
    # Both solves by one method, and then one by another.
    assert np.all(found.worst["tier"] == 1)
    assert (claim.confirmed, claim.changed, found.numerical_error.unchecked) == (claim.violated, 0, 0)
    assert np.all(found.worst["least_gain"] < 0)
    assert "gain_sign" in found.conclusion()


@pytest.mark.slow
def test_a_solve_that_fails_is_undecided_and_widens_the_interval():
    """Three steps are too few for anything, on every tier: nothing held, nothing dropped, nothing known."""
    found = qj.verify(study, BLOCK, block=BLOCK, settings=qj.SolverSettings(max_steps=1))
    claim = found.claims[0]
    assert found.verdict == qj.Verdict.UNDECIDED
    assert claim.held == claim.violated == 0
    assert claim.undecided + claim.inadmissible == BLOCK
    assert (claim.low, claim.high) == (0.0, 1.0)
    assert "max_steps" in found.conclusion()


@pytest.mark.slow
def test_a_later_tier_decides_what_the_first_tier_could_not():
    """Too few steps for some runs with Tsit5, at either tolerance; the implicit tier has ten times as many."""
    found = qj.verify(study, BLOCK, block=BLOCK, settings=qj.SolverSettings(max_steps=100))
    assert found.escalated[1] > found.claims[0].undecided
    assert found.verdict == qj.Verdict.HELD
    # A third method checks what the second decided: the first could not.
    error = found.numerical_error
    assert (error.checked, error.unchecked, error.changed) == (found.claims[0].held, 0, 0)


def test_a_horizon_shorter_than_the_reaching_time_leaves_reaching_undecided():
    found = qj.verify(study.substitute(t1=1.0), BLOCK, block=BLOCK)
    funnel, reaching, _ = found.claims
    assert funnel.undecided == 0
    assert reaching.undecided == funnel.held
    assert found.verdict == qj.Verdict.UNDECIDED


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"runs": 0}, "`runs` must be at least 1, but is 0"),
        ({"runs": 64, "confidence": 1.0}, "`confidence` must lie strictly between 0 and 1, but is 1.0"),
        ({"runs": 64, "confidence": 0.0}, "`confidence`"),
        ({"runs": 64, "worst": 0}, "`worst` must be at least 1"),
        ({"runs": 64, "block": 100}, "`block` must be a positive multiple of 64, but is 100"),
        ({"runs": 64, "sampling": qj.Sobol()}, "Sobol points are not independent"),
        ({"runs": 64, "sampling": qj.LatinHypercube(64)}, "Latin hypercube are not independent"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        qj.verify(study, **arguments)

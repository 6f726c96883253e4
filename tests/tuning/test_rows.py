"""Runs without metrics: which those are, what they lost, and its derivative, against rows written by hand."""

import numpy as np
import pytest

from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.tuning.objectives import mean, parse_constraint, violation
from qsmc_jax.tuning.rows import LOSS, counted, is_unknown, mean_loss, slopes

NAN, INF = np.nan, np.inf
# verdict, outcome, end_time, violation_time, peak_ratio, energy_u; what it lost of 4 s, and whether it counts.
ROWS = [
    (Verdict.HELD, Outcome.COMPLETED, 4.0, INF, 0.7, 5.0, 0.0, True),
    (Verdict.VIOLATED, Outcome.LEFT_FUNNEL, 1.0, 1.0, 1.0, NAN, 0.01 + 0.75, True),
    (Verdict.VIOLATED, Outcome.LEFT_FUNNEL, 4.0, 4.0, 1.0, NAN, 0.01, True),
    (Verdict.VIOLATED, Outcome.COMPLETED, 4.0, 1.0, 1.0 - 1e-12, 6.0, 0.0, True),
    (Verdict.VIOLATED, Outcome.LOST, 3.0, 2.0, 1e3, NAN, 0.01 + 999.0, True),
    (Verdict.VIOLATED, Outcome.MAX_STEPS, 3.0, 2.0, NAN, NAN, 0.01 + 0.5, True),
    (Verdict.UNDECIDED, Outcome.MAX_STEPS, 3.0, NAN, NAN, NAN, 0.01 + 0.25, True),
    (Verdict.UNDECIDED, Outcome.COMPLETED, 4.0, INF, 0.7, 5.0, 0.01, True),
    (Verdict.INADMISSIBLE, Outcome.STARTED_OUTSIDE, 0.0, NAN, NAN, NAN, 0.0, False),
]
NAMES = ("verdict", "outcome", "end_time", "violation_time", "peak_ratio", "energy_u")
TABLE = {name: np.array([row[i] for row in ROWS]) for i, name in enumerate(NAMES)}
COUNTS = [row for row in ROWS if row[-1]]


@pytest.fixture(scope="module")
def found():
    return counted(TABLE, ("energy_u", "peak_ratio"), 4.0)


def test_a_metric_is_known_where_its_run_was_decided_and_solved_to_its_end(found):
    expected = [5.0, NAN, NAN, 6.0, NAN, NAN, NAN, NAN]
    np.testing.assert_array_equal(found["energy_u"], expected)
    # The verdict decides whether the funnel was left, not the last digit of the peak.
    np.testing.assert_array_equal(found["peak_ratio"], [0.7, NAN, NAN, 1.0, NAN, NAN, NAN, NAN])


def test_a_lost_run_lost_the_rest_of_its_horizon_or_how_far_outside_it_was(found):
    np.testing.assert_allclose(found[LOSS], [row[-2] for row in COUNTS], rtol=1e-12)


def test_no_lost_run_is_left_out_of_the_mean(found):
    loss, weights = mean_loss(found, ("energy_u",))
    assert loss == pytest.approx(sum(row[-2] for row in COUNTS) / len(COUNTS), rel=1e-12)
    assert weights[LOSS].tolist() == [0.0, *[1 / 8] * 2, 0.0, *[1 / 8] * 4]
    assert is_unknown(found, ("energy_u",)).sum() == 6


def test_a_run_that_held_without_a_metric_lost_the_least():
    loss, _ = mean_loss({"peak_error[0]": np.array([1.0, NAN]), LOSS: np.zeros(2)}, ("peak_error[0]",))
    assert loss == pytest.approx(0.005)


def test_no_run_at_all_is_as_bad_as_all_lost():
    empty = counted({name: column[-1:] for name, column in TABLE.items()}, ("energy_u",), 4.0)
    assert mean_loss(empty, ("energy_u",))[0] == 1.0
    assert mean("energy_u").evaluate(empty)[0] == INF
    assert (mean("energy_u") >= 1.0).excess(empty)[0] == INF


def test_a_longer_horizon_among_the_runs_counts():
    table = {name: np.array([ROWS[0][i], ROWS[1][i]]) for i, name in enumerate(NAMES)}
    table["end_time"] = np.array([8.0, 1.0])
    assert counted(table, ("energy_u",), 4.0)[LOSS][1] == pytest.approx(0.01 + 7.0 / 8.0)


def test_losing_later_or_going_less_far_is_the_derivative():
    by_name = {"violation_time": np.full((len(ROWS), 1), 3.0), "peak_ratio": np.full((len(ROWS), 1), 5.0)}
    # Left at a time: -3 / 4. Far outside: that of the peak. Undecided, or solved to the end: none.
    assert slopes(TABLE, by_name, 4.0)[:, 0].tolist() == [0.0, -0.75, -0.75, 0.0, 5.0, -0.75, 0.0, 0.0]


@pytest.mark.parametrize("text", ["worst(energy_u) <= 100", "mean(energy_u) <= 100", "least(energy_u) >= 0.1"])
def test_a_constraint_over_lost_runs_is_passed_and_leads_back(found, text):
    constraint = parse_constraint(text)
    assert constraint.excess(found)[0] == INF
    value, weights = constraint.lead(found)
    # Kept by the two runs that are known, so that only the loss is left.
    assert value == pytest.approx(mean_loss(found, ("energy_u",))[0])
    assert set(weights) == {LOSS}


def test_a_constraint_that_known_runs_pass_too_leads_by_both(found):
    constraint = parse_constraint("worst(energy_u) <= 3")
    value, weights = constraint.lead(found)
    assert value == pytest.approx(1.0 + mean_loss(found, ("energy_u",))[0])
    assert weights["energy_u"].tolist() == [0.0, 0.0, 0.0, pytest.approx(1 / 3), 0.0, 0.0, 0.0, 0.0]


def test_violation_counts_every_row_beyond_one_that_did_not_hold(found):
    # Of 8 rows 7 did not hold: in the order of the table 1.76, 1.01, 1.01, 1000.01, 1.51, 1.26, 1.01.
    excess, weights = violation(0.999).excess(found)
    rows = [0.7, 1.76, 1.01, 1.01, 1000.01, 1.51, 1.26, 1.01]
    assert excess == pytest.approx((sum(rows) - 0.008 * 0.7) / (8 * 0.999) - 1.0, rel=1e-9)
    assert weights[LOSS][[0, 3]].tolist() == [0.0, 0.0]
    assert np.all(weights[LOSS][[1, 2, 4, 5, 6, 7]] > 0.0)

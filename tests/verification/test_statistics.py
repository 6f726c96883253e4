"""Exact statistics against SciPy, mpmath, published numbers and enumeration of the binomial."""

import math

import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import qsmc_jax as qj
from qsmc_jax.statistics.intervals import (
    cdf_band,
    clopper_pearson,
    runs_needed,
    worst_case_coverage,
    zero_failure_bound,
)
from qsmc_jax.verification.counts import Counts


@pytest.mark.parametrize("confidence", [0.5, 0.95, 0.999999])
@pytest.mark.parametrize(("violated", "total"), [(0, 1), (1, 1), (0, 40), (3, 40), (40, 40), (17, 100_000)])
def test_interval_agrees_with_scipy(violated, total, confidence):
    expected = stats.binomtest(violated, total).proportion_ci(confidence, "exact")
    # SciPy finds its ends by a bracketing root finder with xtol = 2e-12
    assert clopper_pearson(violated, 0, total, confidence) == pytest.approx(tuple(expected), rel=1e-9, abs=4e-12)


@pytest.mark.parametrize("violated", [1, 3, 30])
@pytest.mark.parametrize("total", [10**6, 10**9, 10**12])
def test_ends_solve_the_binomial_equations_at_any_number_of_runs(violated, total):
    low, high = clopper_pearson(violated, 0, total, 0.95)
    # 1e-7: at 1e9 runs SciPy's inverse is 4e-8 off in the probability of the tail
    assert float(1 - _binomial_cdf(violated - 1, total, low)) == pytest.approx(0.025, rel=1e-7)
    assert float(_binomial_cdf(violated, total, high)) == pytest.approx(0.025, rel=1e-7)


def _binomial_cdf(k, n, p):
    """P(X <= k) summed with 40 digits."""
    with mpmath.workdps(40):
        p = mpmath.mpf(p)
        return mpmath.fsum(mpmath.binomial(n, j) * p**j * (1 - p) ** (n - j) for j in range(k + 1))


def test_counts_may_be_numpy_integers():
    counts = (np.int32(3), np.int64(2), np.uint64(50))
    assert clopper_pearson(*counts, np.float64(0.95)) == clopper_pearson(3, 2, 50, 0.95)


def test_interval_without_runs_says_nothing():
    assert clopper_pearson(0, 0, 0, 0.95) == (0.0, 1.0)


def test_undecided_runs_count_as_held_below_and_as_violated_above():
    low, _ = clopper_pearson(3, 0, 50, 0.95)
    _, high = clopper_pearson(7, 0, 50, 0.95)
    assert clopper_pearson(3, 4, 50, 0.95) == (low, high)


def test_only_undecided_runs_leave_everything_possible():
    assert clopper_pearson(0, 5, 5, 0.95) == (0.0, 1.0)


@st.composite
def counts(draw):
    total = draw(st.integers(1, 10_000))
    violated = draw(st.integers(0, total))
    return violated, draw(st.integers(0, total - violated)), total


@given(counts(), st.floats(0.01, 0.999))
def test_interval_is_ordered_and_inside_the_unit_interval(case, confidence):
    low, high = clopper_pearson(*case, confidence)
    assert 0.0 <= low < high <= 1.0


@given(counts(), st.data(), st.floats(0.01, 0.999))
def test_deciding_an_undecided_run_never_widens_the_interval(case, data, confidence):
    violated, undecided, total = case
    decided = data.draw(st.integers(0, undecided))
    turned_violated = data.draw(st.integers(0, decided))
    low, high = clopper_pearson(violated, undecided, total, confidence)
    new_low, new_high = clopper_pearson(violated + turned_violated, undecided - decided, total, confidence)
    assert low <= new_low
    assert new_high <= high


@pytest.mark.parametrize("confidence", [0.5, 0.9, 0.99])
@pytest.mark.parametrize("total", [1, 2, 5, 11, 20])
def test_coverage_is_at_least_the_confidence_at_every_probability(total, confidence):
    intervals = np.array([clopper_pearson(k, 0, total, confidence) for k in range(total + 1)])
    for p in np.linspace(0.0, 1.0, 301):
        covered = (intervals[:, 0] <= p) & (p <= intervals[:, 1])
        assert stats.binom.pmf(np.arange(total + 1), total, p)[covered].sum() >= confidence - 1e-12


@pytest.mark.parametrize(
    ("probability", "confidence", "runs"),
    [(1e-3, 0.95, 2995), (1e-6, 0.95, 2_995_731), (1e-9, 0.95, 2_995_732_273), (1e-3, 1 - 1e-6, 13_809)],
    ids=["1e-3", "1e-6", "1e-9", "1e-3 at alpha 1e-6"],
)
def test_planner_gives_the_published_one_sided_numbers_at_twice_the_tail(probability, confidence, runs):
    # ceil(ln(alpha) / ln(1 - p)), tabulated e.g. by Tempo, Bai and Dabbene (1997)
    assert runs_needed(probability, 2 * confidence - 1) == runs


def test_planner_agrees_with_the_closed_form_for_two_sides():
    assert runs_needed(1e-3, 0.95) == math.ceil(math.log(0.025) / math.log1p(-1e-3)) == 3688


@given(st.floats(1e-6, 0.99), st.floats(0.01, 0.999), st.integers(0, 30))
def test_planner_is_minimal_for_the_printed_interval(probability, confidence, violations):
    runs = runs_needed(probability, confidence, violations)
    assert clopper_pearson(violations, 0, runs, confidence)[1] <= probability
    assert clopper_pearson(violations, 0, runs - 1, confidence)[1] > probability


def test_planner_with_violations_agrees_with_the_binomial_tail():
    runs = runs_needed(0.01, 0.95, violations=2)
    assert stats.binom.cdf(2, runs, 0.01) <= 0.025 < stats.binom.cdf(2, runs - 1, 0.01)


def test_planner_refuses_what_no_count_can_show():
    with pytest.raises(ValueError, match=r"`probability` must be showable by 2\*\*53 runs, but is 1e-17"):
        runs_needed(1e-17, 0.95)


@pytest.mark.parametrize("total", [1, 10, 3688, 10**9])
def test_zero_failure_bound_is_the_upper_end_of_the_interval(total):
    assert zero_failure_bound(total, 0.95) == pytest.approx(clopper_pearson(0, 0, total, 0.95)[1], rel=1e-9)


def test_zero_failure_bound_is_3_69_over_n():
    assert 1e6 * zero_failure_bound(10**6, 0.95) == pytest.approx(math.log(40), rel=1e-5)


@pytest.mark.parametrize(("total", "is_enough"), [(2994, False), (2995, True)])
def test_worst_of_2995_runs_is_exceeded_with_at_most_one_in_a_thousand(total, is_enough):
    assert (worst_case_coverage(total, 0.95) <= 1e-3) == is_enough


def test_worst_case_coverage_gives_the_published_wilks_sizes():
    # Wilks: 59 runs for one-sided 95 %/95 % by the worst, 93 by the second worst, 124 by the third
    for rank, runs in {1: 59, 2: 93, 3: 124}.items():
        assert worst_case_coverage(runs, 0.95, rank) <= 0.05 < worst_case_coverage(runs - 1, 0.95, rank)


def test_worst_case_coverage_holds_in_repeated_experiments():
    experiments, total, confidence = 20_000, 30, 0.9
    worst = np.random.default_rng(3).uniform(size=(experiments, total)).max(axis=1)
    failed = (1 - worst > worst_case_coverage(total, confidence)).mean()
    # exact for a continuous number; 4 sigma of a binomial with n = 20 000, p = 0.1
    assert abs(failed - 0.1) < 4 * math.sqrt(0.1 * 0.9 / experiments)


def test_cdf_band_agrees_with_the_published_sample_size():
    # 0.05 at 95 %: N = ln(2 / 0.05) / (2 * 0.05**2) = 737.8
    assert cdf_band(738, 0.95) <= 0.05 < cdf_band(737, 0.95)


def test_cdf_band_is_wider_than_the_exact_kolmogorov_quantile():
    for total in (5, 50, 500):
        assert stats.kstwo.ppf(0.95, total) <= cdf_band(total, 0.95) <= 1.1 * stats.kstwo.ppf(0.95, total)


@pytest.mark.parametrize("confidence", [0.0, 1.0, -0.1, 95.0, float("nan")])
@pytest.mark.parametrize(
    "function",
    [
        lambda c: clopper_pearson(0, 0, 10, c),
        lambda c: runs_needed(0.1, c),
        lambda c: zero_failure_bound(10, c),
        lambda c: worst_case_coverage(10, c),
        lambda c: cdf_band(10, c),
    ],
    ids=["clopper_pearson", "runs_needed", "zero_failure_bound", "worst_case_coverage", "cdf_band"],
)
def test_confidence_must_be_strictly_inside(function, confidence):
    with pytest.raises(ValueError, match=f"`confidence` must lie strictly between 0 and 1, but is {confidence}"):
        function(confidence)


@pytest.mark.parametrize("probability", [0.0, 1.0])
def test_planned_probability_must_be_strictly_inside(probability):
    with pytest.raises(ValueError, match=f"`probability` must lie strictly between 0 and 1, but is {probability}"):
        runs_needed(probability, 0.95)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ((-1, 0, 5), "`violated` must not be negative, but is -1"),
        ((0, -2, 5), "`undecided` must not be negative, but is -2"),
        ((0, 0, -5), "`total` must not be negative, but is -5"),
        ((3, 3, 5), r"`total` must be at least `violated` \+ `undecided` = 6, but is 5"),
    ],
)
def test_counts_must_be_consistent(arguments, message):
    with pytest.raises(ValueError, match=message):
        clopper_pearson(*arguments, 0.95)


def test_planned_violations_must_not_be_negative():
    with pytest.raises(ValueError, match="`violations` must not be negative, but is -1"):
        runs_needed(0.1, 0.95, violations=-1)


@pytest.mark.parametrize("function", [zero_failure_bound, worst_case_coverage, cdf_band])
def test_bounds_need_a_run(function):
    with pytest.raises(ValueError, match="`total` must be at least 1, but is 0"):
        function(0, 0.95)


@pytest.mark.parametrize("rank", [0, 11])
def test_rank_must_be_one_of_the_runs(rank):
    with pytest.raises(ValueError, match=rf"`rank` must be in \[1, 10\], but is {rank}"):
        worst_case_coverage(10, 0.95, rank)


def test_counts_take_the_undecided_both_ways_and_leave_out_the_inadmissible():
    counts = {qj.Verdict.HELD: 90, qj.Verdict.VIOLATED: 3, qj.Verdict.UNDECIDED: 7, qj.Verdict.INADMISSIBLE: 50}
    found = Counts.of(counts, 0.9)
    low, high = (stats.binomtest(k, 100).proportion_ci(0.9, method="exact") for k in (3, 10))
    assert (found.low, found.high) == pytest.approx((low.low, high.high), rel=1e-6)
    assert (found.total, found.estimate) == (100, 0.03)
    assert found.row().split()[:4] == ["90", "3", "7", "50"]
    nobody = Counts.of(dict.fromkeys(qj.Verdict, 0), 0.9)
    assert (nobody.low, nobody.high, math.isnan(nobody.estimate)) == (0.0, 1.0, True)

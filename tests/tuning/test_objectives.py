"""Objectives and constraints against NumPy, SciPy, a minimisation formula and central differences; the box of gains."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import logsumexp

from qsmc_jax.tuning.objectives import (
    Constraint,
    cvar,
    least,
    mean,
    violation,
    worst,
)

SAMPLE = np.array([0.3, -1.2, 4.5, 2.25, 0.0, 7.5, 7.0, -3.0, 1.5, 2.0, 5.5])
STATISTICS = [mean, worst, least, *(lambda m, level=level: cvar(m, level) for level in (0.0, 0.3, 0.5, 0.77, 0.99))]
STATISTIC_IDS = ["mean", "worst", "least", "cvar 0", "cvar 0.3", "cvar 0.5", "cvar 0.77", "cvar 0.99"]

numbers = st.floats(-100.0, 100.0)
samples = st.lists(numbers, min_size=1, max_size=30).map(np.array)
# Multiples of 0.01, so that a step of 1e-4 changes no order
distinct_samples = st.lists(st.integers(-1000, 1000), min_size=1, max_size=15, unique=True).map(
    lambda whole: 0.01 * np.array(whole)
)
levels = st.floats(0.0, 0.99)


def value(objective, sample, smoothing=0.0):
    return objective.evaluate({"peak_u": sample}, smoothing)[0]


def weights(objective, sample, smoothing=0.0):
    return objective.evaluate({"peak_u": sample}, smoothing)[1]["peak_u"]


def rockafellar_uryasev(sample, level):
    """min_t t + E(v - t)+ / (1 - level): piecewise linear in t with its kinks, and so its minimum, at the sample."""
    return min(t + np.maximum(sample - t, 0.0).mean() / (1.0 - level) for t in sample)


def central_differences(function, at, step):
    return np.array([(function(at + d) - function(at - d)) / (2.0 * step) for d in step * np.eye(len(at))])


@given(samples)
def test_mean_is_that_of_numpy(sample):
    assert value(mean("peak_u"), sample) == pytest.approx(np.mean(sample), rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("level", "expected"),
    [(0.0, 5.5), (0.5, 8.0), (0.75, (10 + 9 + 0.5 * 8) / 2.5), (0.8, 9.5), (0.9, 10.0), (0.95, 10.0)],
)
def test_cvar_of_one_to_ten_is_that_by_hand(level, expected):
    sample = np.array([3.0, 10.0, 1.0, 7.0, 5.0, 9.0, 2.0, 8.0, 6.0, 4.0])
    assert value(cvar("peak_u", level), sample) == pytest.approx(expected, rel=1e-12)


@given(samples, levels)
def test_cvar_is_the_minimum_of_rockafellar_and_uryasev(sample, level):
    expected = rockafellar_uryasev(sample, level)
    assert value(cvar("peak_u", level), sample) == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("level", [0.05, 0.5, 0.6, 0.77, 0.9, 0.95])
def test_cvar_splits_the_last_run_when_the_tail_is_no_whole_number(level):
    tail = (1.0 - level) * len(SAMPLE)
    assert tail != round(tail)
    assert value(cvar("peak_u", level), SAMPLE) == pytest.approx(rockafellar_uryasev(SAMPLE, level), rel=1e-12)


@given(samples)
def test_cvar_at_level_zero_is_the_mean(sample):
    assert value(cvar("peak_u", 0.0), sample) == pytest.approx(np.mean(sample), rel=1e-12, abs=1e-12)


@given(samples, levels, levels)
def test_cvar_grows_with_its_level_from_the_mean_to_the_worst(sample, one, other):
    low, high = (value(cvar("peak_u", level), sample) for level in sorted((one, other)))
    assert np.mean(sample) - 1e-9 <= low <= high + 1e-9
    assert high <= np.max(sample) + 1e-9


@given(samples)
def test_worst_and_least_are_the_extremes(sample):
    assert value(worst("peak_u"), sample) == np.max(sample)
    assert value(least("peak_u"), sample) == np.min(sample)


@given(samples, st.floats(0.01, 2.0))
def test_smooth_extremes_are_logarithms_of_sums_of_exponentials(sample, smoothing):
    width = smoothing * np.std(sample)
    top, bottom = (np.max(sample), np.min(sample)) if width == 0.0 else _smooth_extremes(sample, width)
    assert value(worst("peak_u"), sample, smoothing) == pytest.approx(top, rel=1e-9, abs=1e-9)
    assert value(least("peak_u"), sample, smoothing) == pytest.approx(bottom, rel=1e-9, abs=1e-9)


def _smooth_extremes(sample, width):
    return width * logsumexp(sample / width), -width * logsumexp(-sample / width)


@pytest.mark.parametrize("smoothing", [1.0, 0.3, 0.1])
def test_smooth_extremes_lie_outside_the_sample_by_at_most_the_logarithm_of_its_size(smoothing):
    room = smoothing * np.std(SAMPLE) * math.log(len(SAMPLE))
    assert SAMPLE.max() < value(worst("peak_u"), SAMPLE, smoothing) < SAMPLE.max() + room
    assert SAMPLE.min() - room < value(least("peak_u"), SAMPLE, smoothing) < SAMPLE.min()


def test_smooth_extremes_tend_to_the_extremes():
    above = [value(worst("peak_u"), SAMPLE, smoothing) - SAMPLE.max() for smoothing in (1.0, 0.5, 0.25, 0.125, 1e-3)]
    below = [SAMPLE.min() - value(least("peak_u"), SAMPLE, smoothing) for smoothing in (1.0, 0.5, 0.25, 0.125, 1e-3)]
    for gap in (above, below):
        assert gap == sorted(gap, reverse=True)
        assert gap[0] > 0.1
        assert gap[-1] == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize("statistic", [mean, cvar])
def test_smoothing_is_for_the_extremes_only(statistic):
    assert value(statistic("peak_u"), SAMPLE, 0.5) == value(statistic("peak_u"), SAMPLE)


@pytest.mark.parametrize("statistic", STATISTICS, ids=STATISTIC_IDS)
@settings(max_examples=15)
@given(sample=distinct_samples)
def test_weights_are_central_differences(statistic, sample):
    objective = statistic("peak_u")
    expected = central_differences(lambda at: value(objective, at), sample, 1e-4)
    assert weights(objective, sample) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("smoothing", [1.0, 0.3])
@pytest.mark.parametrize("statistic", [worst, least])
def test_weights_of_smooth_extremes_are_central_differences(statistic, smoothing):
    """Of the width too, which is made of the values."""
    objective = statistic("peak_u")
    expected = central_differences(lambda at: value(objective, at, smoothing), SAMPLE, 1e-5)
    assert weights(objective, SAMPLE, smoothing) == pytest.approx(expected, abs=1e-7)


@given(distinct_samples, st.floats(-3.0, 3.0), st.floats(-3.0, 3.0))
def test_weights_of_a_sum_over_one_column_are_central_differences(sample, a, b):
    objective = a * cvar("peak_u", 0.6) + b * least("peak_u") - mean("peak_u")
    expected = central_differences(lambda at: value(objective, at), sample, 1e-4)
    assert weights(objective, sample) == pytest.approx(expected, abs=1e-8)


@pytest.mark.parametrize("smoothing", [0.0, 0.4])
@pytest.mark.parametrize("statistic", STATISTICS, ids=STATISTIC_IDS)
@settings(max_examples=15)
@given(sample=samples)
def test_weights_sum_to_one_since_a_shift_of_all_runs_shifts_the_statistic(statistic, smoothing, sample):
    assert weights(statistic("peak_u"), sample, smoothing).sum() == pytest.approx(1.0, rel=1e-9)


@pytest.mark.parametrize("smoothing", [0.0, 0.4])
@pytest.mark.parametrize("statistic", STATISTICS, ids=STATISTIC_IDS)
@settings(max_examples=15)
@given(data=st.data(), sample=samples)
def test_one_unknown_run_makes_it_infinite_and_a_descent_goes_by_the_known(statistic, smoothing, data, sample):
    count = data.draw(st.integers(1, 4))
    places = data.draw(st.lists(st.integers(0, len(sample)), min_size=count, max_size=count))
    fillers = data.draw(st.lists(st.sampled_from([np.nan, np.inf, -np.inf]), min_size=count, max_size=count))
    holed = np.insert(sample, places, fillers)
    known = np.isfinite(holed)
    objective = statistic("peak_u")
    assert value(objective, holed, smoothing) == math.inf
    for factor in (1.0, -3.0):
        assert value(factor * objective, holed, smoothing) == math.inf
    assert ((objective <= 1e9).excess({"peak_u": holed})[0], (objective >= -1e9).excess({"peak_u": holed})[0]) == (
        math.inf,
        math.inf,
    )
    among_known, slopes = objective.among_known({"peak_u": holed}, smoothing)
    assert among_known == value(objective, sample, smoothing)
    assert slopes["peak_u"][known].tolist() == weights(objective, sample, smoothing).tolist()
    assert slopes["peak_u"][~known].tolist() == [0.0] * count


@pytest.mark.parametrize("statistic", STATISTICS, ids=STATISTIC_IDS)
def test_runs_that_are_all_unknown_leave_nothing_to_go_by(statistic):
    objective = mean("energy_u") + statistic("peak_u")
    columns = {"peak_u": np.full(3, np.nan), "energy_u": np.ones(3)}
    total, slopes = objective.evaluate(columns)
    assert total == math.inf
    assert objective.among_known(columns)[0] == 1.0
    assert slopes["peak_u"].tolist() == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("statistic", [worst, least])
@pytest.mark.parametrize("sample", [np.full(3, 0.67628034), np.full(7, 1.01), np.array([0.1 + 0.2, 0.3, 0.3])], ids=str)
def test_smooth_extremes_of_numbers_that_rounding_tells_apart_are_the_extremes(statistic, sample):
    """Their standard deviation need not come out as 0: that of three times 0.67628034 is 1e-16."""
    assert value(statistic("peak_u"), sample, 0.4) == pytest.approx(sample[0], rel=1e-12)
    assert weights(statistic("peak_u"), sample, 0.4).sum() == pytest.approx(1.0, rel=1e-9)


@settings(max_examples=25)
@given(samples, numbers)
def test_scaling_scales_value_and_weights_from_either_side(sample, factor):
    for scaled in (factor * cvar("peak_u", 0.7), cvar("peak_u", 0.7) * factor):
        assert value(scaled, sample) == pytest.approx(factor * value(cvar("peak_u", 0.7), sample), rel=1e-12)
        assert weights(scaled, sample) == pytest.approx(factor * weights(cvar("peak_u", 0.7), sample), rel=1e-12)


@settings(max_examples=25)
@given(samples, samples, numbers)
def test_sums_and_differences_are_those_of_the_parts(u, energy, factor):
    columns = {"peak_u": u, "energy_u": energy}
    summed, sum_slopes = (mean("peak_u") + factor * mean("energy_u")).evaluate(columns)
    less, less_slopes = (mean("peak_u") - factor * mean("energy_u")).evaluate(columns)
    assert summed == pytest.approx(u.mean() + factor * energy.mean(), rel=1e-9, abs=1e-9)
    assert less == pytest.approx(u.mean() - factor * energy.mean(), rel=1e-9, abs=1e-9)
    assert sum_slopes["peak_u"] == pytest.approx(np.full(len(u), 1 / len(u)))
    assert sum_slopes["energy_u"] == pytest.approx(np.full(len(energy), factor / len(energy)))
    assert less_slopes["energy_u"] == pytest.approx(np.full(len(energy), -factor / len(energy)))


def test_an_objective_names_each_column_once_in_order():
    objective = mean("peak_u") + worst("energy_u") + least("peak_u") + mean("peak_error[1]")
    assert objective.metrics == ("peak_u", "energy_u", "peak_error[1]")


@pytest.mark.parametrize(
    ("constraint", "expected"),
    [
        (mean("peak_u") <= 4.0, (6.0 - 4.0) / 4.0),
        (mean("peak_u") <= 8.0, (6.0 - 8.0) / 8.0),
        (mean("peak_u") >= 4.0, (4.0 - 6.0) / 4.0),
        (mean("peak_u") >= 8.0, (8.0 - 6.0) / 8.0),
        (mean("peak_u") <= -4.0, (6.0 + 4.0) / 4.0),
        (mean("peak_u") >= -4.0, (-4.0 - 6.0) / 4.0),
        (mean("peak_u") <= 0.0, 6.0),
        (mean("peak_u") >= 0.0, -6.0),
        (mean("peak_u") <= 6.0, 0.0),
    ],
    ids=str,
)
def test_excess_is_the_distance_past_the_bound_in_units_of_it(constraint, expected):
    excess, _ = constraint.excess({"peak_u": np.array([5.0, 7.0])})
    assert excess == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("side", [1, -1])
@settings(max_examples=15)
@given(sample=distinct_samples, bound=st.sampled_from([-20.0, -0.5, 0.0, 0.5, 20.0]))
def test_weights_of_an_excess_are_central_differences(side, sample, bound):
    constraint = Constraint(cvar("peak_u", 0.6), bound, side)
    expected = central_differences(lambda at: constraint.excess({"peak_u": at})[0], sample, 1e-4)
    assert constraint.excess({"peak_u": sample})[1]["peak_u"] == pytest.approx(expected, abs=1e-8)


def test_excess_of_an_extreme_may_be_smooth():
    expected = (_smooth_extremes(SAMPLE, 0.5 * np.std(SAMPLE))[0] - 20.0) / 20.0
    assert (worst("peak_u") <= 20.0).excess({"peak_u": SAMPLE}, 0.5)[0] == pytest.approx(expected, rel=1e-12)


# Some just outside the funnel, and probabilities about their share: where a weaker bound would let too many pass
ratios = st.lists(st.one_of(st.floats(0.0, 0.9), st.floats(0.0, 1.0), st.floats(1.001, 1.05)), min_size=1, max_size=40)


@given(ratios.map(np.array), st.floats(0.7, 1.1))
def test_violation_bounds_the_share_of_runs_that_leave_the_funnel(ratio, factor):
    share = float(np.mean(ratio > 1.0))
    probability = min(0.999, factor * max(share, 0.01))
    excess, _ = violation(probability).excess({"peak_ratio": ratio})
    assert excess > 0.0 or share <= probability


@pytest.mark.parametrize(("probability", "holds"), [(0.3, True), (0.25, True), (0.2, False), (0.1, False)])
def test_violation_turns_where_the_tail_has_mean_one(probability, holds):
    # The tail of 0.25 is of 5 runs, of mean 4.9 / 5; that of 0.2 is of 4, of mean 4.1 / 4
    ratio = np.array([1.3, 1.2] + [0.8] * 18)
    assert (violation(probability).excess({"peak_ratio": ratio})[0] <= 0.0) == holds


@given(st.lists(st.floats(0.0, 0.999), min_size=1, max_size=30), st.floats(0.01, 0.99), st.data())
def test_a_run_that_left_is_worse_than_any_that_held(held, probability, data):
    """As an ideal loop writes it, peak_ratio 1, or unknown; whatever share may leave."""
    place = data.draw(st.integers(0, len(held) - 1))
    for left in (1.0, math.nan):
        rows = np.array(held)
        rows[place] = 0.999
        before = violation(probability).excess({"peak_ratio": rows})[0]
        rows[place] = left
        assert violation(probability).excess({"peak_ratio": rows})[0] > before


@pytest.mark.parametrize("left", [1.0, math.nan])
@pytest.mark.parametrize("count", [2, 3, 256])
def test_violation_is_passed_if_more_than_its_share_left(count, left):
    """Also if all have left, and where each has at the very end of its horizon."""
    rows = np.full(256, 0.9999)
    rows[:count] = left
    for columns in ({"peak_ratio": rows}, {"peak_ratio": rows, "loss": np.where(rows < 1.0, 0.0, 0.01)}):
        assert violation(0.9 * count / 256).excess(columns)[0] > 1e-3


def test_violation_is_kept_if_fewer_than_its_share_left():
    # The tail is of 25.6 runs, of mean (2 * 1.76 + 23.6 * 0.5) / 25.6.
    rows, loss = np.full(256, 0.5), np.zeros(256)
    rows[7:9], loss[7:9] = math.nan, 0.76
    excess, _ = violation(0.1).excess({"peak_ratio": rows, "loss": loss})
    assert excess == pytest.approx((2 * 1.76 + 23.6 * 0.5) / 25.6 - 1.0)


def test_weights_of_violation_by_what_was_lost_are_central_differences():
    rows, loss = np.array([0.5, 0.9, math.nan, 0.7, math.nan]), np.array([0.0, 0.0, 0.4, 0.0, 0.8])
    expected = central_differences(lambda at: violation(0.5).excess({"peak_ratio": rows, "loss": at})[0], loss, 1e-5)
    assert violation(0.5).excess({"peak_ratio": rows, "loss": loss})[1]["loss"] == pytest.approx(expected, abs=1e-9)
    assert expected[[2, 4]].min() > 0.1


@pytest.mark.parametrize("probability", [-0.1, 0.0, 1.5])
def test_violation_refuses_what_is_no_probability(probability):
    with pytest.raises(ValueError, match=r"`level` must lie in \[0, 1\)"):
        violation(probability)


@pytest.mark.parametrize(
    ("constraint", "column"),
    [
        (worst("peak_u") <= 20.0, "peak_u"),
        (least("margin") >= 0.1, "margin"),
        (cvar("peak_error[0]", 0.9) <= 1.0, "peak_error[0]"),
        (violation(0.01), "peak_ratio"),
        (mean("peak_u") <= 20.0, None),
        (2.0 * worst("peak_u") <= 20.0, None),
        (worst("peak_u") + worst("energy_u") <= 20.0, None),
    ],
    ids=str,
)
def test_only_a_constraint_on_one_extreme_is_about_each_run(constraint, column):
    assert constraint.per_run == column


@pytest.mark.parametrize("weight", [math.inf, math.nan])
def test_a_weight_that_is_not_finite_is_refused(weight):
    with pytest.raises(ValueError, match="A weight must be finite"):
        weight * mean("peak_u")

"""Robustness maps: common random numbers, exact simultaneous intervals, one compilation, pictures that are complete.

Truth: the coin study, which leaves its funnel exactly where `coin` < `p`; SciPy's intervals; binomial sampling.
"""

import dataclasses

import numpy as np
import pytest
import scipy.stats

import qsmc_jax as qj
from coin_study import scenario, study
from drawing import draws_in_given_axes
from qsmc_jax.robustness.map import _median
from qsmc_jax.statistics.simultaneous import median_interval, simultaneous_intervals
from studies_for_tests import study as integrator

RUNS, BLOCK = 128, 128
PS = np.geomspace(0.01, 0.64, 4)


@pytest.fixture(scope="module")
def over_p():
    """One name."""
    return qj.robustness_map(study, {"p": PS}, RUNS, seed=3, block=BLOCK)


@pytest.fixture(scope="module")
def over_both():
    """Two names."""
    return qj.robustness_map(study, {"p": PS, "flip": [0.0, 1.0]}, RUNS, seed=3, block=BLOCK)


@pytest.fixture(scope="module")
def coins():
    """What decides each run."""
    return qj.monte_carlo(study, RUNS, seed=3, block=BLOCK)["coin"]


def test_every_cell_has_the_same_runs_as_monte_carlo(over_p, coins):
    """So many coins lie below each p, and no other number of runs can be violated."""
    assert over_p.funnel.violated.tolist() == [int(np.sum(coins < p)) for p in PS]
    assert np.all(over_p.funnel.held == RUNS - over_p.funnel.violated)


def test_two_names_span_a_grid_in_their_order(over_both, over_p):
    assert over_both.low.shape == (4, 2)
    assert np.all(over_both.funnel.violated[:, 0] == over_p.funnel.violated)
    assert np.all(over_both.funnel.violated.sum(axis=1) == RUNS)


def test_a_swept_distribution_leaves_the_other_names_where_they_were(coins):
    starts = qj.robustness_map(study, {"start": [0.1, 0.9]}, RUNS, seed=3, block=BLOCK)
    assert np.all(starts.funnel.violated == np.sum(coins < 0.1))
    # Without a violation the peak is that of the start, (0.5 + 0.2 start) / 1.1.
    assert starts.medians["peak_ratio"] == pytest.approx((0.5 + 0.2 * np.array([0.1, 0.9])) / 1.1, rel=1e-5)


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        ([("HELD", 0.5), ("HELD", 0.6), ("HELD", 0.9)], 0.6),
        ([("HELD", 0.5), ("UNDECIDED", np.nan), ("HELD", 0.9)], 0.9),
        ([("VIOLATED", np.nan), ("UNDECIDED", np.nan), ("HELD", 0.9)], np.inf),
        ([("HELD", 0.5), ("VIOLATED", np.nan)], np.inf),
        ([("HELD", 0.5), ("VIOLATED", 1.0), ("VIOLATED", 1.2)], 1.0),
        ([("HELD", 0.5), ("INADMISSIBLE", np.nan), ("INADMISSIBLE", np.nan)], 0.5),
        ([("UNDECIDED", np.nan)], np.nan),
    ],
    ids=str,
)
def test_a_median_counts_a_lost_run_above_every_other(rows, expected):
    verdict = np.array([int(qj.Verdict[name]) for name, _ in rows])
    table = qj.Runs({"verdict": verdict, "peak_ratio": np.array([value for _, value in rows])}, ())
    np.testing.assert_equal(_median(table, "peak_ratio"), expected)


def test_each_interval_is_clopper_pearsons_at_its_share_of_the_risk(over_p):
    for i, violated in enumerate(over_p.funnel.violated.tolist()):
        expected = scipy.stats.binomtest(violated, RUNS).proportion_ci(1 - 0.05 / len(PS), method="exact")
        assert (over_p.low[i], over_p.high[i]) == pytest.approx((expected.low, expected.high), rel=1e-7)


def test_intervals_from_common_random_numbers_hold_together():
    """500 maps of 20 cells: all 20 true probabilities inside in at least 95 %, less three sigma of the count."""
    rng, maps, runs, ps = np.random.default_rng(0), 500, 60, np.linspace(0.02, 0.98, 20)

    def is_covered(violated):
        low, high = simultaneous_intervals(violated, np.zeros(20, int), np.full(20, runs), 0.95)
        return np.all((low <= ps) & (ps <= high))

    covered = np.mean([is_covered((rng.random((runs, 1)) < ps).sum(axis=0)) for _ in range(maps)])
    assert covered >= 0.95 - 3 * np.sqrt(0.05 * 0.95 / maps)


def test_undecided_runs_are_counted_both_ways():
    low, high = simultaneous_intervals(np.array([2]), np.array([3]), np.array([50]), 0.9)
    assert low[0] == pytest.approx(scipy.stats.binomtest(2, 50).proportion_ci(0.9).low, rel=1e-7)
    assert high[0] == pytest.approx(scipy.stats.binomtest(5, 50).proportion_ci(0.9).high, rel=1e-7)


def test_intervals_of_a_grid_share_the_risk_over_all_its_cells():
    violated, undecided, total = np.array([[2, 0, 5], [1, 3, 9]]), np.array([[0, 1, 0], [2, 0, 0]]), np.full((2, 3), 60)
    low, high = simultaneous_intervals(violated, undecided, total, 0.9)
    for i in np.ndindex(2, 3):
        exact = [
            scipy.stats.binomtest(int(k), 60).proportion_ci(1.0 - 0.1 / 6.0, method="exact")
            for k in (violated[i], violated[i] + undecided[i])
        ]
        assert (low[i], high[i]) == pytest.approx((exact[0].low, exact[1].high), rel=1e-7)


@pytest.mark.parametrize(("runs", "confidence"), [(10, 0.9), (101, 0.95), (500, 0.999)])
def test_the_interval_of_a_median_is_that_of_its_order_statistics(runs, confidence):
    values = np.random.default_rng(runs).normal(size=runs)
    expected = scipy.stats.quantile_test(values, q=0, p=0.5).confidence_interval(confidence)
    assert median_interval(values, confidence) == pytest.approx((expected.low, expected.high))


def test_too_few_values_say_nothing_of_a_median():
    assert median_interval(np.array([1.0, 2.0, 3.0, 4.0, 5.0]), 0.95) == (-np.inf, np.inf)
    assert median_interval(np.array([]), 0.95) == (-np.inf, np.inf)


def test_one_trace_serves_all_cells():
    """What it calls are those that make each cell's study, and those that ask once whether anything has changed."""
    calls = []

    def counted(draw):
        calls.append(draw)
        return scenario(draw)

    fresh = qj.Study(counted, bandwidth=0.2)
    calls.clear()
    fresh.substitute(p=0.5)
    a_study = len(calls)
    fresh.require_unchanged()
    asked = len(calls) - a_study
    qj.robustness_map(fresh, {"p": [0.1, 0.2]}, 64, block=64)
    calls.clear()
    qj.robustness_map(fresh, {"p": [0.3, 0.4, 0.5]}, 64, block=64)
    assert len(calls) == 3 * a_study + asked


def test_a_cell_without_an_admissible_run_says_nothing():
    """The start is 1.15, outside rho(0) = 1.1."""
    found = qj.robustness_map(integrator.substitute(x0=[1.15]), {"mu": [1.0]}, 64, block=64)
    assert found.funnel.inadmissible == 64
    assert (found.low[0], found.high[0]) == (0.0, 1.0)
    assert np.isnan(found.funnel.estimate[0])
    assert np.isnan(found.medians["peak_ratio"][0])
    found.plot()


@pytest.mark.slow
def test_runs_that_cannot_be_decided_widen_the_interval():
    found = qj.robustness_map(study, {"p": [0.5]}, 64, block=64, settings=qj.SolverSettings(max_steps=1))
    assert found.funnel.undecided == 64
    assert (found.low[0], found.high[0]) == (0.0, 1.0)


def test_progress_is_that_of_the_whole():
    told = []
    qj.robustness_map(study, {"p": [0.0, 0.01]}, RUNS, block=BLOCK, progress=lambda *at: told.append(at))
    assert told == [(RUNS, 2 * RUNS), (2 * RUNS, 2 * RUNS)]


def test_the_summary_and_the_table_hold_every_cell(over_both):
    table, summary = over_both.table(), over_both.summary()
    row = np.flatnonzero((table["p"] == PS[2]) & (table["flip"] == 1.0))
    assert table["funnel.violated"][row] == over_both.funnel.violated[2, 1]
    assert summary["claims"]["funnel"]["violated"] == over_both.funnel.violated.tolist()
    assert set(summary["claims"]) == {"funnel", "reaching", "tracking"}


def test_printed_a_map_says_how_sure_it_is(over_p, over_both):
    assert "All 4 intervals hold together with 95 % confidence" in str(over_p)
    assert len(str(over_p).splitlines()) == 7
    upper, lower = str(over_both).splitlines()[3:5]
    assert upper.split()[1] == "###+"  # flip 1: 1 - p, and 1 - 0.64 is less than a half
    assert set(lower.split()[1]) <= {".", "+", "#"}


def with_lines(found):
    lines = (
        qj.Threshold("first", "p", 0.1, "local"),
        qj.Threshold("second", "flip", 0.5, "sufficient"),
        qj.Threshold("outside", "p", 100.0, "necessary"),
    )
    return dataclasses.replace(found, thresholds=lines, scales={"p": (3.0, "3 p [-]")})


def legend(ax):
    return [text.get_text() for text in ax.get_legend().get_texts()]


def test_a_curve_has_its_band_its_scale_and_its_thresholds(over_p):
    ax = with_lines(over_p).plot(dimensionless=True)[0]
    assert ax.get_xscale() == "log"
    assert ax.get_xlabel() == "3 p [-]"
    assert "first (local)" in legend(ax)
    assert not any("outside" in text or "second" in text for text in legend(ax))
    band = ax.collections[0].get_paths()[0].vertices
    assert band[:, 0].max() == pytest.approx(3.0 * PS[-1])
    assert band[:, 1].max() == pytest.approx(over_p.high.max())


def test_a_mesh_has_borders_and_thresholds_on_both_axes(over_both):
    ax = draws_in_given_axes(with_lines(over_both).plot, 1 + len(over_both.medians))[0]
    assert (ax.get_xscale(), ax.get_yscale()) == ("log", "linear")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("p", "flip")
    assert {"first (local)", "second (sufficient)"} <= set(legend(ax))
    assert ax.collections[0].get_array().shape == (2, 4)


def test_a_map_without_scales_cannot_be_drawn_dimensionless(over_p):
    with pytest.raises(ValueError, match="`dimensionless` must be False for a map without `scales`"):
        over_p.plot(dimensionless=True)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"over": {}}, "`over` must have one or two names, but has 0"),
        ({"over": {"p": [0.1], "flip": [0.0], "scale": [1.0]}}, "one or two names, but has 3"),
        ({"over": {"pp": [0.1]}}, "There is no name `pp`.*Did you mean `p`"),
        ({"over": {"p": [0.1, 1.5]}}, "`p` must lie in .0, 1., but is 1.5"),
        ({"over": {"p": [0.2, 0.1]}}, "the values of `p` in increasing order"),
        ({"over": {"p": [0.1, 0.1]}}, "increasing order"),
        ({"over": {"p": []}}, "a list of at least one value"),
        ({"over": {"p": [[0.1]]}}, "at least one value, but has shape"),
        ({"over": {"p": [np.nan]}}, "`over` for `p` must be finite"),
        ({"over": {"p": [0.1]}, "runs": 0}, "`runs` must be at least 1"),
        ({"over": {"p": [0.1]}, "confidence": 1.0}, "`confidence` must lie strictly between 0 and 1"),
        ({"over": {"p": [0.1]}, "block": 100}, "`block` must be a positive multiple of 64"),
        ({"over": {"p": [0.1]}, "seed": -1}, "`seed` must be in"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        qj.robustness_map(study, **arguments)


def test_a_threshold_is_a_number():
    with pytest.raises(ValueError, match="`value` of `limit` must be a number"):
        qj.Threshold("limit", "p", float("nan"), "local")

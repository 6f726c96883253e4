"""Comparisons: the same random numbers in every study, exact intervals that hold together, ratios run by run.

Truth: the coin study, of which `fast` has four times the gain and `bad` five times the violations; SciPy's intervals.
"""

import numpy as np
import pytest
import scipy.stats

import qsmc_jax as qj
from coin_study import scenario, studies, study
from drawing import draws_in_given_axes
from qsmc_jax.robustness.comparison import METRICS
from studies_for_tests import study as other

RUNS, BLOCK = 128, 128
IDEAL = METRICS[:5]


@pytest.fixture(scope="module")
def found():
    """Three studies."""
    return qj.compare(studies, RUNS, seed=3, block=BLOCK)


@pytest.fixture(scope="module")
def tables():
    """The runs of each."""
    return {name: qj.monte_carlo(each, RUNS, seed=3, block=BLOCK) for name, each in studies.items()}


def test_every_study_has_the_same_runs_as_monte_carlo(found, tables):
    coins = tables["slow"]["coin"]
    assert [s.violated for s in found.studies] == [np.sum(coins < p) for p in (0.1, 0.1, 0.5)]
    assert all(np.array_equal(table["coin"], coins) for table in tables.values())


def test_an_ideal_loop_has_no_chattering_metrics(found):
    assert found.metrics == IDEAL
    assert set(found["slow"].medians) == set(IDEAL)


def test_all_intervals_share_the_risk(found):
    """Three probabilities, 3 * 5 medians, 2 * 5 ratios."""
    assert found.intervals == 28 == len(found.table()["low"])
    for s in found.studies:
        expected = scipy.stats.binomtest(s.violated, RUNS).proportion_ci(1 - 0.05 / 28, method="exact")
        assert (s.low, s.high) == pytest.approx((expected.low, expected.high), rel=1e-7)


def test_a_median_is_that_of_the_runs_in_which_it_is_known(found, tables):
    values = tables["bad"]["energy_u"]
    known = values[~np.isnan(values)]
    expected = scipy.stats.quantile_test(known, q=0, p=0.5).confidence_interval(1 - 0.05 / 28)
    estimate = found["bad"].medians["energy_u"]
    assert 0 < estimate.runs == known.size < RUNS
    assert estimate.median == pytest.approx(np.median(known))
    assert (estimate.low, estimate.high) == pytest.approx((expected.low, expected.high))


def test_a_ratio_is_that_of_the_same_run(found, tables):
    slow, fast = tables["slow"]["rms_error"], tables["fast"]["rms_error"]
    ratios = (fast / slow)[np.isfinite(slow) & np.isfinite(fast)]
    expected = scipy.stats.quantile_test(ratios, q=0, p=0.5).confidence_interval(1 - 0.05 / 28)
    estimate = found["fast"].ratios["rms_error"]
    assert (estimate.median, estimate.runs) == (pytest.approx(np.median(ratios)), ratios.size)
    assert (estimate.low, estimate.high) == pytest.approx((expected.low, expected.high))


def test_ratios_are_sharper_than_medians(found):
    """Both loops start alike, so the peak of each run that holds is the same: the ratio is 1 in all of them."""
    ratio, median = found["fast"].ratios["peak_u"], found["fast"].medians["peak_u"]
    assert (ratio.low, ratio.high) == pytest.approx((1.0, 1.0), rel=1e-6)
    assert median.high > 1.05 * median.low
    assert ratio.runs == found["slow"].held


def test_the_first_study_has_no_ratios(found):
    assert found["slow"].ratios == {}


def test_violated_runs_widen_a_median_up_to_infinity(found):
    """Half of the runs of the bad study leave the funnel, with an infinite peak."""
    assert found["bad"].medians["peak_u"].high == np.inf


def test_one_study_is_enough_and_one_metric_can_be_chosen():
    found = qj.compare({"alone": study}, 64, metrics=["steps"], block=64)
    assert found.metrics == ("steps",)
    assert found.intervals == 2


def test_printed_it_shows_every_study_and_metric(found):
    text = str(found)
    assert all(text.count(f"\n{metric} ") == 3 for metric in IDEAL)
    assert "All 28 intervals hold together with 95 % confidence." in text


def test_the_summary_holds_every_study(found):
    summary = found.summary()
    assert [s["name"] for s in summary["studies"]] == list(studies)
    assert summary["studies"][1]["ratios"]["rms_error"]["median"] == found["fast"].ratios["rms_error"].median


def test_the_picture_has_a_panel_a_metric_and_a_line_a_study(found):
    panels = draws_in_given_axes(found.plot, 1 + len(IDEAL))
    assert panels[1].get_yticklabels()[0].get_text() == next(iter(studies))  # which in a new figure it shares
    panels = found.plot()
    assert len(panels) == 1 + len(IDEAL)
    assert [text.get_text() for text in panels[0].get_yticklabels()] == list(studies)
    assert all(len(ax.containers) == 3 for ax in panels if not ax.texts)
    assert [len(ax.containers) + len(ax.texts) for ax in panels if ax.texts] == [3]
    assert "infinite; at least" in panels[2].texts[0].get_text()


@pytest.mark.slow
def test_a_study_without_a_decided_run_is_drawn_too():
    found = qj.compare({"a": study, "b": study}, 64, block=64, settings=qj.SolverSettings(max_steps=1))
    assert [(s.undecided, s.low, s.high) for s in found.studies] == [(64, 0.0, 1.0)] * 2
    assert np.isnan(found["a"].medians["energy_u"].median)
    found.plot()


def test_progress_is_that_of_the_whole():
    told = []
    qj.compare({"a": study, "b": study}, 64, block=BLOCK, progress=lambda *at: told.append(at))
    assert told[0] == (64, 128)
    assert told[-1] == (128, 128)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"studies": {}}, "`studies` must have at least one study"),
        ({"studies": {"a": study, "b": other}}, r"`a` draws coin, start and `b` draws d, g, x0\[1\]"),
        ({"runs": 0}, "`runs` must be at least 1"),
        ({"confidence": 0.0}, "`confidence` must lie strictly between 0 and 1"),
        ({"metrics": ["speed"]}, "There is no column `speed`"),
        ({"block": 100}, "`block` must be a positive multiple of 64"),
    ],
)
def test_bad_arguments_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        qj.compare(**{"studies": {"a": study}, "runs": 64, "block": BLOCK, **arguments})


class _Without:
    """A draw that answers for one name itself."""

    def __init__(self, draw, name, value):
        self._draw, self._name, self._value = draw, name, value
        self.parameter = draw.parameter

    def uniform(self, name, low, high):
        return self._value if name == self._name else self._draw.uniform(name, low, high)


def test_the_order_of_the_names_matters():
    """Coordinates are taken in order: the same names in another order would get each other's random numbers."""

    def turned(draw):
        start = draw.uniform("start", 0.0, 1.0)
        return scenario(_Without(draw, "start", start))

    with pytest.raises(ValueError, match="in the same order"):
        qj.compare({"a": study, "b": qj.Study(turned, bandwidth=0.2)}, 64, block=BLOCK)


def test_an_unknown_study_is_named(found):
    with pytest.raises(ValueError, match="There is no study `slowest`. There are: slow, fast, bad."):
        _ = found["slowest"]

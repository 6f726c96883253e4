"""Bands of a column's distribution: what they cover, by simulation, and what they are, by closed forms."""

import math

import numpy as np
import pytest
from scipy import stats

import qsmc_jax as qj
from drawing import draws_in_given_axes
from qsmc_jax.statistics.bands import next_run

REPEATS, RUNS, RISK = 500, 100, 0.1
# Three standard deviations of a share of so many repeats.
GATE = 3.0 * math.sqrt(RISK * (1.0 - RISK) / REPEATS)


def band(values, unknown=0, **about):
    return qj.Band("peak", "N", np.asarray(values, float), unknown, **{"confidence": 1.0 - RISK, **about})


def samples():
    return np.random.default_rng(3).uniform(size=(REPEATS, RUNS))


def covers(made):
    """Whether the uniform CDF lies in a band: it is enough to look at the steps, from both sides."""
    at = made.values
    highs = [made.cdf(value)[1] for value in np.nextafter(at, -1.0)]
    lows = [made.cdf(value)[0] for value in at]
    return bool(np.all(np.array(lows) <= at) and np.all(at <= np.array(highs)))


@pytest.mark.parametrize("hidden", ["none", "largest", "smallest", "middle"])
def test_the_band_covers_as_often_as_it_says_whatever_is_not_known(hidden):
    """A tenth of the runs is not known, chosen by an enemy who sees them all."""
    parts = {"none": slice(0), "largest": slice(90, None), "smallest": slice(10), "middle": slice(45, 55)}
    missed = 0
    repeats = 120
    for each in np.sort(samples()[:repeats], axis=1):
        known = np.delete(each, np.arange(RUNS)[parts[hidden]])
        missed += not covers(band(known, RUNS - len(known)))
    assert missed / repeats <= RISK + 3.0 * math.sqrt(RISK * (1.0 - RISK) / repeats)


def test_the_band_of_all_known_runs_is_hardly_wider_than_it_must_be():
    """Kolmogorov's exact quantile for 100 runs is 0.1 below the width at 90 %, relatively, or less."""
    made = band(samples()[0])
    exact = stats.kstwo.ppf(1.0 - RISK, RUNS)
    assert exact <= made.width <= 1.1 * exact


def test_quantiles_and_mean_tails_are_covered_together():
    """Of uniform numbers the quantiles are the levels, and the mean of the part above a is (1 + a)/2."""
    levels, missed = (0.1, 0.5, 0.9), 0
    for each in samples():
        made = band(each, least=0.0, most=1.0)
        ends = [(made.quantile(level), level) for level in levels]
        ends += [(made.cvar(level), (1.0 + level) / 2.0) for level in levels]
        ends += [(made.cvar(level, "low"), (1.0 - level) / 2.0) for level in levels]
        missed += not all(low <= truth <= high for (low, high), truth in ends)
    assert missed / REPEATS <= RISK + GATE


def test_quantiles_are_order_statistics():
    """From the definition: the first value at which the lower function is at the level, and the upper."""
    made = band(np.arange(1.0, 201.0), 7)
    for level in (0.2, 0.5, 0.8):
        reaches = [[made.cdf(value)[side] >= level for value in made.values] for side in (1, 0)]
        assert made.quantile(level) == tuple(made.values[each.index(True)] for each in reaches)


def test_what_the_runs_do_not_tell_is_an_end_of_the_support():
    made = band(np.arange(1.0, 201.0), most=500.0)
    assert made.quantile(0.999)[1] == 500.0
    assert made.quantile(0.001)[0] == -math.inf
    assert made.cdf(500.0)[0] == 1.0
    assert made.cdf(-math.inf)[1] == pytest.approx(made.width)
    assert band(np.arange(1.0, 201.0), least=0.0).cdf(-1.0)[1] == 0.0


def test_a_mean_tail_is_the_integral_of_its_quantiles():
    made = band(np.random.default_rng(5).normal(size=150), 3, least=-9.0, most=9.0)
    levels = (np.arange(200_000) + 0.5) / 200_000
    for level, tail in ((0.0, "high"), (0.8, "high"), (0.8, "low")):
        inside = levels > level if tail == "high" else levels < 1.0 - level
        lows, highs = made._quantiles(levels[inside])
        assert made.cvar(level, tail) == pytest.approx((lows.mean(), highs.mean()), abs=2e-4)


def test_a_mean_tail_without_a_known_end_may_be_infinite():
    low, high = band(np.arange(1.0, 201.0)).cvar(0.9)
    assert high == math.inf
    assert math.isfinite(low)


def test_a_support_that_a_run_left_is_refused():
    with pytest.raises(ValueError, match=r"must hold all values of `peak`.*what you take as proved is not so"):
        band([0.5, 2.0], most=1.0)


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"values": [np.nan]}, "must hold no NaN"),
        ({"values": []}, "must have a run at least"),
        ({"values": [0.5], "unknown": -1}, "`unknown` must be at least 0"),
        ({"values": [0.5], "confidence": 1.0}, "`confidence` must lie strictly between 0 and 1"),
        ({"values": [0.5], "least": 1.0, "most": 1.0}, "`least` must be below `most`"),
    ],
)
def test_bad_bands_are_named(arguments, message):
    with pytest.raises(ValueError, match=message):
        band(**arguments)


@pytest.mark.parametrize(("call", "message"), [("quantile", "`level`"), ("cvar", "`level`")])
def test_bad_levels_are_named(call, message):
    with pytest.raises(ValueError, match=message):
        getattr(band([0.5]), call)(1.0)


@pytest.mark.parametrize("probability", [0.5, 0.9, 0.99])
def test_the_next_run_stays_as_often_as_it_says(probability):
    """With n = 99 runs the k-th smallest is passed with probability 1 - k/100 exactly: three standard deviations."""
    rng = np.random.default_rng(11)
    values, after = rng.normal(size=(20_000, 99)), rng.normal(size=20_000)
    stayed = np.mean([new <= next_run(each, 0, probability) for each, new in zip(values, after, strict=True)])
    assert stayed == pytest.approx(probability, abs=3.0 * math.sqrt(probability * (1.0 - probability) / 20_000))


def test_the_next_run_has_a_rank_and_unknown_ones_are_as_bad_as_any():
    values = np.arange(1.0, 20.0)
    assert next_run(values, 0, 0.95) == 19.0
    assert next_run(values, 0, 0.951) == math.inf
    assert next_run(values[:-1], 1, 0.95) == math.inf
    assert next_run(values, 0, 0.95, "low") == 1.0
    assert next_run(values, 1, 0.9) == 19.0


def test_runs_tell_it_by_column_with_units():
    rows = 40
    columns = {
        "index": np.arange(rows),
        "verdict": np.where(np.arange(rows) < 5, int(qj.Verdict.INADMISSIBLE), int(qj.Verdict.HELD)),
        "reach_time": np.where(np.arange(rows) < 8, np.nan, np.linspace(0.0, 1.0, rows)),
        "margin": np.linspace(0.2, 0.9, rows),
    }
    runs = qj.Runs(columns, names=())
    made = runs.band("reach_time", most=2.0)
    assert (made.unit, made.runs, made.unknown, made.most) == ("s", 35, 3, 2.0)
    assert str(made).startswith("reach_time [s] in 35 runs, not known in 3: CDF to 0.23 everywhere")
    assert runs.next_run("margin", 0.5) == np.sort(columns["margin"][5:])[-18]


def test_a_band_shows_itself():
    made = band(np.linspace(0.0, 1.0, 50), 2, most=1.5)
    ax = draws_in_given_axes(made.plot)
    assert ax.get_xlabel() == "peak [N]"
    assert made.summary()["quantiles"]["high"] == made.table()["high"].tolist()

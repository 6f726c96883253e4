"""Confidence sequences and the sequential test: against the definition by mpmath, closed forms, and by simulation."""

import math

import hypothesis.strategies as st
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings

from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.statistics.anytime import confidence_sequence, sequential_test
from qsmc_jax.verification.stopping import AbstractRule, SequentialTest, UntilBelow, UntilWidth, decision_of

COUNTS = st.integers(0, 60).flatmap(lambda k: st.tuples(st.just(k), st.integers(0, 5), st.integers(k + 5, 10_000)))


def martingale(k, n, p):
    """M_n(p) by the integral that defines the mixture: an atom at 0, and the density of Beta(1/2, 1/2)."""
    with mpmath.workdps(30):
        p = mpmath.mpf(p)
        rest = mpmath.beta(k + 0.5, n - k + 0.5) / mpmath.beta(0.5, 0.5)
        return ((0.5 if k == 0 else 0) + rest / 2) / (p**k * (1 - p) ** (n - k))


@pytest.mark.parametrize(("k", "n"), [(0, 1), (0, 3000), (1, 1), (1, 7), (5, 1000), (30, 60), (999, 1000), (3, 10**9)])
def test_the_ends_are_where_the_martingale_reaches_its_level(k, n):
    low, high = confidence_sequence(k, 0, n, 0.95)
    for end in (low, high):
        if 0.0 < end < 1.0:
            assert float(martingale(k, n, end)) == pytest.approx(20.0, rel=1e-6)
    assert low <= k / n <= high
    assert (low == 0.0) == (k == 0)
    assert (high == 1.0) == (k == n)


def test_without_a_violation_it_is_near_to_the_logarithm():
    assert confidence_sequence(0, 0, 10**6, 0.95)[1] * 1e6 == pytest.approx(math.log(40.0), rel=2e-3)


@settings(max_examples=200)
@given(counts=COUNTS)
def test_both_ends_grow_with_the_violations_so_that_undecided_runs_count_both_ways(counts):
    k, m, n = counts
    low, high = confidence_sequence(k, 0, n, 0.95)
    more_low, more_high = confidence_sequence(k + 1, 0, n, 0.95)
    assert low <= more_low
    assert high <= more_high
    assert confidence_sequence(k, m, n, 0.95) == (low, confidence_sequence(k + m, 0, n, 0.95)[1])


@pytest.mark.parametrize("p", [0.0, 1e-3, 0.02, 0.3])
def test_it_ever_misses_no_more_often_than_it_may(p):
    # 2000 campaigns, looked at after each of 40 blocks of 50 runs; the mean may be off by three standard deviations.
    rng, looks, size, confidence = np.random.default_rng(7), 40, 50, 0.9
    counts = rng.binomial(size, p, (2000, looks)).cumsum(axis=1)
    bounds = {}
    missed = np.zeros(len(counts), bool)
    for look in range(looks):
        n = size * (look + 1)
        for k in np.unique(counts[:, look]):
            low, high = bounds.setdefault((k, n), confidence_sequence(int(k), 0, n, confidence))
            if not low <= p <= high:
                missed |= counts[:, look] == k
    assert missed.mean() <= 0.1 + 3.0 * math.sqrt(0.1 * 0.9 / len(counts))


@pytest.mark.parametrize(("p", "wrong"), [(4e-3, "below"), (1e-3, "above")])
def test_the_sequential_test_errs_no_more_often_than_it_may(p, wrong):
    rng, rule = np.random.default_rng(3), SequentialTest(4e-3, 1e-3)
    answers = []
    for _ in range(400):
        violated = total = 0
        said = None
        while said is None:
            violated, total = violated + rng.binomial(200, p), total + 200
            said = rule.decision(int(violated), 0, total, 0.9)
        answers.append(wrong in said)
    assert np.mean(answers) <= 0.1 + 3.0 * math.sqrt(0.1 * 0.9 / 400)


def test_the_sequential_statistic_is_walds():
    expected = 3 * math.log(1e-3 / 4e-3) + 97 * math.log((1 - 1e-3) / (1 - 4e-3))
    assert sequential_test(3, 100, 4e-3, 1e-3, 0.05) == pytest.approx(expected / math.log(19.0), rel=1e-12)


def test_rules_say_what_they_found():
    assert UntilBelow(1e-3).decision(0, 0, 3600, 0.95) is None
    assert "at most 0.001" in str(UntilBelow(1e-3).decision(0, 0, 3800, 0.95))
    assert "above 0.001" in str(UntilBelow(1e-3).decision(30, 0, 3800, 0.95))
    # An undecided run counts against either answer.
    assert UntilBelow(1e-3).decision(0, 30, 3800, 0.95) is None
    assert UntilWidth(1e-3).decision(0, 0, 3600, 0.95) is None
    assert UntilWidth(1e-3).decision(0, 0, 3800, 0.95) is not None
    assert SequentialTest(4e-3, 1e-3).decision(0, 100, 5000, 0.95) is None


def test_a_rule_is_told_all_counts_of_the_funnel_claim():
    told = []

    class Told(AbstractRule):
        def decision(self, violated, undecided, total, confidence):
            told.append((violated, undecided, total, confidence))

    counts = {Verdict.HELD: 90, Verdict.VIOLATED: 3, Verdict.UNDECIDED: 7, Verdict.INADMISSIBLE: 20}
    assert decision_of(Told(), counts, 0.9) is None
    assert told == [(3, 7, 100, 0.9)]


def test_the_sequential_test_decides_at_walds_bounds():
    """Without a violation after the first N with N ln((1 - p1) / (1 - p0)) >= ln((1 - a) / a); with only violations
    after the first k with k ln(p0 / p1) at least as much; undecided runs count against either answer."""
    rule, p0, p1, risk = SequentialTest(0.02, 0.01), 0.02, 0.01, 0.05
    bound = math.log((1.0 - risk) / risk)
    enough = math.ceil(bound / math.log((1.0 - p1) / (1.0 - p0)))
    assert rule.decision(0, 0, enough - 1, 1.0 - risk) is None
    assert "below 0.02" in rule.decision(0, 0, enough, 1.0 - risk)
    assert rule.decision(0, 1, enough, 1.0 - risk) is None
    many = math.ceil(bound / math.log(p0 / p1))
    assert rule.decision(many - 1, 0, many - 1, 1.0 - risk) is None
    assert "above 0.01" in rule.decision(many, 0, many, 1.0 - risk)
    assert rule.decision(many - 1, 1, many, 1.0 - risk) is None


BAD = {
    "no confidence": (lambda: confidence_sequence(0, 0, 1, 1.0), "`confidence` must lie strictly between 0 and 1"),
    "too many": (lambda: confidence_sequence(2, 0, 1, 0.9), "`total` = 1"),
    "width": (lambda: UntilWidth(0.0), "`width` of a stopping rule"),
    "probability": (lambda: UntilBelow(1.0), "`probability` of a stopping rule"),
    "alternative": (lambda: SequentialTest(1e-3, 2e-3), "`alternative` must lie strictly between 0 and 0.001"),
}


@pytest.mark.parametrize(("call", "message"), BAD.values(), ids=BAD)
def test_bad_arguments_are_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()

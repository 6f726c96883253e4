"""How much a probability may grow under another distribution: against brute force, and closed forms."""

import math

import mpmath
import numpy as np
import pytest
from scipy import optimize

import qsmc_jax as qj
from qsmc_jax.statistics.shift import survived, under_divergence, under_ratio, under_variation
from studies_for_tests import study

# A distribution over eight scenarios, of which the last two are violated: 0.06.
P = np.array([0.2, 0.15, 0.25, 0.1, 0.14, 0.1, 0.05, 0.01])
BAD = slice(6, None)
ROOM = 1e-6


def worst_by_brute_force(constraint):
    """The largest probability of the bad scenarios over all distributions that obey a constraint, by SLSQP."""
    simplex = {"type": "eq", "fun": lambda q: q.sum() - 1.0}
    kept = {"type": "ineq", "fun": constraint}
    options = {"ftol": 1e-14, "maxiter": 1000}
    found = optimize.minimize(
        lambda q: -q[BAD].sum(), P, bounds=[(1e-12, 1.0)] * len(P), constraints=[simplex, kept], options=options
    )
    assert found.success
    return -found.fun


@pytest.mark.parametrize("divergence", [1e-3, 0.01, 0.1, 1.0])
def test_no_distribution_within_a_divergence_is_worse_and_one_is_as_bad(divergence):
    worst = worst_by_brute_force(lambda q: divergence - np.sum(q * np.log(q / P)))
    assert under_divergence(P[BAD].sum(), divergence) == pytest.approx(worst, abs=ROOM)


@pytest.mark.parametrize("ratio", [1.0, 1.5, 10.0])
def test_no_distribution_within_a_ratio_is_worse_and_one_is_as_bad(ratio):
    worst = worst_by_brute_force(lambda q: ratio * P - q)
    assert under_ratio(P[BAD].sum(), ratio) == pytest.approx(worst, abs=ROOM)


@pytest.mark.parametrize("variation", [0.0, 0.02, 0.5])
def test_no_distribution_within_a_variation_is_worse_and_one_is_as_bad(variation):
    # A linear programme: q = p + up - down.
    n = len(P)
    gain = -np.concatenate([np.eye(n)[BAD].sum(axis=0), -np.eye(n)[BAD].sum(axis=0)])
    equal = np.concatenate([np.ones(n), -np.ones(n)])[None]
    spent = np.concatenate([np.ones(n), np.zeros(n)])[None]
    bounds = [(0.0, None)] * n + [(0.0, p) for p in P]
    found = optimize.linprog(gain, A_ub=spent, b_ub=[variation], A_eq=equal, b_eq=[0.0], bounds=bounds)
    assert under_variation(P[BAD].sum(), variation) == pytest.approx(P[BAD].sum() - found.fun, abs=ROOM)


@pytest.mark.parametrize("probability", [3.69e-6, 3.69e-4, 0.3, 0.999])
@pytest.mark.parametrize("divergence", [1e-12, 1e-3, 0.1])
def test_a_coin_that_far_off_has_just_that_divergence(probability, divergence):
    q = under_divergence(probability, divergence)
    if q == 1.0:
        assert -math.log(probability) <= divergence
        return
    with mpmath.workdps(30):
        p, q = mpmath.mpf(probability), mpmath.mpf(q)
        found = q * mpmath.log(q / p) + (1 - q) * mpmath.log((1 - q) / (1 - p))
    # A rounding of q moves a divergence as small as 1e-12 by some 1e-10 of it.
    assert float(found) == pytest.approx(divergence, rel=1e-8)
    assert q > p


def test_known_figures():
    """10 000 and 1 000 000 clean runs at 95 %."""
    for probability, figures in ((3.69e-4, (0.0015, 0.0056, 0.029)), (3.69e-6, (2.9e-4, 1.9e-3, 0.014))):
        found = [under_divergence(probability, each) for each in (1e-3, 1e-2, 1e-1)]
        assert found == pytest.approx(figures, rel=0.03)


def test_ends():
    assert under_divergence(0.0, 5.0) == 0.0
    assert under_divergence(0.2, 0.0) == 0.2
    assert under_divergence(0.5, math.log(2.0)) == 1.0
    assert under_variation(0.9, 0.2) == 1.0
    assert under_ratio(0.6, 2.0) == 1.0


def test_what_is_survived_is_the_inverse():
    shift = survived(3.69e-4, 1e-2)
    assert under_divergence(3.69e-4, shift.divergence) == pytest.approx(1e-2, rel=1e-9)
    assert under_variation(3.69e-4, shift.variation) == pytest.approx(1e-2)
    assert under_ratio(3.69e-4, shift.ratio) == pytest.approx(1e-2)
    assert all(map(math.isnan, survived(0.02, 1e-2)))
    assert survived(0.0, 1e-2).ratio == math.inf


@pytest.fixture(scope="module")
def found():
    return qj.verify(study.substitute(d=0.0, g=1.0, x0=[0.1]), 64, block=64)


def test_a_verification_tells_it_of_its_upper_end(found):
    high = found.headline.high
    assert found.shifted(divergence=0.01) == under_divergence(high, 0.01)
    assert found.shifted(ratio=2.0) == 2.0 * high
    assert found.shifted(variation=0.1) == pytest.approx(high + 0.1)
    assert found.survives(0.1).ratio == pytest.approx(0.1 / high)
    assert found.summary()["shifted"][1] == {"divergence": 0.01, "high": under_divergence(high, 0.01)}


@pytest.mark.parametrize(
    ("distances", "message"),
    [
        ({}, "Give one of `divergence`, `variation` and `ratio`, not 0"),
        ({"divergence": 0.1, "ratio": 2.0}, "not 2 of them"),
        ({"divergence": -0.1}, "`divergence` must not be negative"),
        ({"variation": -0.1}, "`variation` must not be negative"),
        ({"ratio": 0.5}, "`ratio` must be at least 1"),
    ],
)
def test_bad_distances_are_named(found, distances, message):
    with pytest.raises(ValueError, match=message):
        found.shifted(**distances)


@pytest.mark.parametrize("below", [0.0, 1.0])
def test_bad_probabilities_are_named(found, below):
    with pytest.raises(ValueError, match="`below` must lie strictly between 0 and 1"):
        found.survives(below)

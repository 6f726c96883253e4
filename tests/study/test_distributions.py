"""Distributions far out in both tails, against SciPy and mpmath; weights; and what is refused."""

import warnings

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats

import qsmc_jax as qj
from qsmc_jax.study.draw import discover

# From the least coordinate of any design to the largest: 2**-53, 1 - 2**-53.
TAILS = np.concatenate([np.logspace(-15.9, -2, 15), np.linspace(0.02, 0.98, 25), 1 - np.logspace(-2, -15.9, 15)])
HISTOGRAM = stats.rv_histogram(np.histogram([0.1, 0.2, 0.25, 0.3, 0.5, 0.55, 0.7, 0.9], bins=4)).freeze()
FROZEN = {
    "normal": stats.norm(3.0, 0.1),
    "Student": stats.t(3.0),
    "Cauchy": stats.cauchy(1.0, 2.0),
    "Pareto": stats.pareto(3.0),
    "GEV": stats.genextreme(-0.1),
    "Johnson": stats.johnsonsu(1.0, 2.0),
    "with a kink": stats.triang(0.3),
    "histogram": HISTOGRAM,
}


def require_quantiles(value, truth, u):
    """The relative error is at most 1e-12 in the value, or in the odds; or an ulp of a coordinate near 1 is missed."""
    with warnings.catch_warnings():  # SciPy warns where a density is infinite, or a value underflows
        warnings.simplefilter("ignore")
        exact = truth.ppf(u)
        in_value, probability = abs(value - exact) / abs(exact), abs(value - exact) * truth.pdf(exact)
    is_exact = (in_value < 1e-12) | (probability < 1e-12 * u * (1 - u)) | ((u > 0.5) & (probability < 2.3e-16))
    assert is_exact.all(), (u[~is_exact], value[~is_exact], exact[~is_exact])


@pytest.mark.parametrize("truth", FROZEN.values(), ids=FROZEN)
def test_a_table_is_scipys_quantile_in_both_tails(truth):
    draw = qj.Draw(TAILS).from_scipy("a", truth, shape=TAILS.shape)
    require_quantiles(draw, truth, TAILS)


@pytest.mark.parametrize("k", [0.06, 0.5, 2.0, 300.0, 1e5])
def test_gamma_is_scipys_quantile_in_both_tails(k):
    require_quantiles(qj.Draw(TAILS).gamma("a", k, 2.0, shape=TAILS.shape), stats.gamma(k, scale=2.0), TAILS)


@pytest.mark.parametrize(("a", "b"), [(0.06, 0.06), (0.5, 0.7), (2.0, 5.0), (1e4, 20.0)])
def test_beta_is_scipys_quantile_in_both_tails(a, b):
    require_quantiles(qj.Draw(TAILS).beta("a", a, b, shape=TAILS.shape), stats.beta(a, b), TAILS)


@pytest.mark.parametrize("u", [1e-12, 1e-9, 0.3, 1 - 1e-12])
def test_the_probability_of_a_quantile_is_the_coordinate_in_many_digits(u):
    """By mpmath with 40 digits: of beta(0.5, 3), `scipy.stats` is wrong by orders of magnitude below 1e-6."""
    x, y, z = (float(q) for q in (DRAWN[name](qj.Draw([u])) for name in DRAWN))
    with mpmath.workdps(40):
        exact, found = mpmath.mpf(u), [mpmath.gammainc(2.5, 0, x, regularized=True)]
        found += [mpmath.betainc(a, b, 0, value, regularized=True) for a, b, value in ((2, 5, y), (0.5, 3, z))]
        room = 1e-12 * exact * (1 - exact) + (2.3e-16 if u > 0.5 else 0)
        assert max(abs(each - exact) for each in found) < room


DRAWN = {
    "gamma": lambda d: d.gamma("a", 2.5, 1.0),
    "beta": lambda d: d.beta("a", 2.0, 5.0),
    "steep beta": lambda d: d.beta("a", 0.5, 3.0),
}


def test_a_quantile_that_scipy_has_roughly_is_as_good_as_scipys():
    """Of a skew normal distribution SciPy's own probabilities in the lower tail are absolute, not relative."""
    truth, u = stats.skewnorm(4.0), np.linspace(1e-6, 1 - 1e-6, 41)
    value = qj.Draw(u).from_scipy("a", truth, shape=u.shape)
    assert abs(truth.cdf(value) - u).max() < 2e-14


def test_tables_are_differentiated_by_the_arguments_that_may_depend_on_draws():
    """x = scale q, x = low + (high - low) q."""
    q, p = stats.gamma(2.5).ppf(0.3), stats.beta(2.0, 5.0).ppf(0.3)
    scale = jax.jit(jax.grad(lambda scale: qj.Draw([0.3]).gamma("a", 2.5, scale)))(2.0)
    low, high = jax.jit(jax.grad(lambda low, high: qj.Draw([0.3]).beta("a", 2, 5, low, high), (0, 1)))(1.0, 2.0)
    np.testing.assert_allclose([scale, low, high], [q, 1 - p, p], rtol=1e-12)


def test_closed_forms_are_differentiated_by_their_shape():
    """The derivative of (-ln(1 - u))^(1/k) by k, and of exp(s z) by s."""
    by_k = jax.jit(jax.grad(lambda k: qj.Draw([0.3]).weibull("a", k, 2.0)))(1.5)
    hazard = -np.log1p(-0.3)
    assert float(by_k) == pytest.approx(-2.0 * hazard ** (1 / 1.5) * np.log(hazard) / 1.5**2, rel=1e-13)
    by_s, z = jax.jit(jax.grad(lambda s: qj.Draw([0.3]).lognormal("a", 2.0, s)))(0.5), stats.norm.ppf(0.3)
    assert float(by_s) == pytest.approx(2.0 * z * np.exp(0.5 * z), rel=1e-13)


def test_weights_are_the_widths_of_cells_and_each_has_its_lower_end():
    weights = [1, 0, 2, 5, 0]
    ends = np.array([0.125, 0.375])
    u = np.array([0.0, np.nextafter(ends[0], 0), ends[0], np.nextafter(ends[1], 0), ends[1], 1 - 2.0**-53, 1.0])
    chosen = [10.0, 10.0, 30.0, 30.0, 40.0, 40.0, 40.0]
    pick = jax.jit(lambda u: qj.Draw(u).choice("a", [10, 20, 30, 40, 50], weights, shape=(7,)))
    np.testing.assert_array_equal(qj.Draw(u).choice("a", [10, 20, 30, 40, 50], weights, shape=(7,)), chosen)
    np.testing.assert_array_equal(pick(u), chosen)


@given(st.lists(st.floats(0, 1e6), min_size=1, max_size=9).filter(any), st.floats(0, 1))
def test_a_value_without_weight_is_never_chosen(weights, u):
    assert weights[int(qj.Draw([u]).choice("a", np.arange(len(weights)), weights))] > 0.0


def test_a_value_without_weight_can_not_be_substituted():
    (spec,), _ = discover(lambda d: d.choice("a", [1.0, 2.0, 3.0], [1, 0, 1]))
    assert spec.levels == (1.0, 3.0)


def in_scenario(use):
    """Uses a number that is traced in a run."""
    return lambda d: use(d, d.uniform("b", 1.0, 2.0))


class Local(stats.rv_continuous):
    """x^2 on [0, 1]."""

    def _cdf(self, x):
        return x**2

    def _ppf(self, q):
        return np.sqrt(q)


class Rough(stats.rv_continuous):
    """Of which quantiles are off by up to 5e-14."""

    def _cdf(self, x):
        return x

    def _ppf(self, q):
        return q + 5e-14 * np.sin(1e6 * q)


def test_a_distribution_of_ones_own_is_tabulated():
    truth = Local(a=0.0, b=1.0)(loc=2.0)
    assert float(qj.Draw([0.49]).from_scipy("a", truth)) == pytest.approx(2.7, rel=1e-14)


REFUSED = {
    "lognormal median": (
        lambda d: d.lognormal("a", -1.0, 0.1),
        "`median` of `a` must be positive and finite, but is -1",
    ),
    "lognormal spread": (
        lambda d: d.lognormal("a", 1.0, 0.0),
        "`log_std` of `a` must be positive and finite, but is 0",
    ),
    "weibull shape": (lambda d: d.weibull("a", 0.0, 1.0), "`k` of `a` must be positive"),
    "weibull scale": (lambda d: d.weibull("a", 1.0, float("nan")), "`scale` of `a` must be positive and finite"),
    "gamma shape": (lambda d: d.gamma("a", -2.0, 1.0), "`k` of `a` must be positive and finite, but is -2"),
    "gamma scale": (lambda d: d.gamma("a", 2.0, 0.0), "`scale` of `a` must be positive and finite, but is 0"),
    "gamma steep": (lambda d: d.gamma("a", 0.01, 1.0), "with `k` 0.01 it is too steep or SciPy's too rough"),
    "gamma traced": (in_scenario(lambda d, b: d.gamma("a", b, 1.0)), "`k` of `a` must be fixed, but depends on other"),
    "beta exponent": (lambda d: d.beta("a", 1.0, float("inf")), "`b` of `a` must be positive and finite, but is inf"),
    "beta reversed": (lambda d: d.beta("a", 1.0, 1.0, 2.0, 1.0), "`low` of `a` must be below `high`"),
    "beta steep": (lambda d: d.beta("a", 3.0, 1e5), "with `a` 3 and `b` 100000 it is too steep"),
    "beta traced": (in_scenario(lambda d, b: d.beta("a", 1.0, b)), "`b` of `a` must be fixed, but depends on other"),
    "not frozen": (lambda d: d.from_scipy("a", stats.norm), "`frozen` of `a` must be a frozen continuous distribution"),
    "discrete": (lambda d: d.from_scipy("a", stats.poisson(2.0)), "must be a frozen continuous distribution"),
    "scipy range": (
        lambda d: d.from_scipy("a", stats.gamma(-1.0)),
        "`gamma_gen` are not finite: are its arguments in range",
    ),
    "scipy rough": (
        lambda d: d.from_scipy("a", Rough(a=0.0, b=1.0)()),
        "must have quantiles that SciPy works out to 1e-14, but those of `Rough` are rough",
    ),
    "scipy wrong": (
        lambda d: d.from_scipy("a", stats.beta(0.5, 3.0)),
        "those of `beta_gen` are not the inverse of its probabilities, at 3.16e-13",
    ),
    "scipy traced": (in_scenario(lambda d, b: d.from_scipy("a", stats.norm(b))), "must have fixed arguments"),
    "weights short": (lambda d: d.choice("a", [1, 2], [1.0]), r"`weights` of `a` must have shape \(2,\)"),
    "weights negative": (lambda d: d.choice("a", [1, 2], [2, -1]), "`weights` of `a` must be finite and not negative"),
    "weights nan": (lambda d: d.choice("a", [1, 2], [2, np.nan]), "`weights` of `a` must be finite and not negative"),
    "weights zero": (lambda d: d.choice("a", [1, 2], [0, 0]), "`weights` of `a` must not be 0 throughout"),
    "weights traced": (
        in_scenario(lambda d, b: d.choice("a", [1, 2], jnp.stack([b, 2.0 - b]))),
        "`weights` of `a` must be fixed",
    ),
}


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_what_has_no_meaning_is_refused_by_name(call, message):
    with pytest.raises(qj.InputError, match=message):
        discover(call)

"""Interval arithmetic: what it encloses, against mpmath and against dense sampling; and what it must not lose."""

import jax
import jax.numpy as jnp
import mpmath
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.special import ive

from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.enclosures.enclosure import enclose
from qsmc_jax.enclosures.intervals import Interval
from qsmc_jax.enclosures.rounding import Rounding

KNOTS, VALUES = np.linspace(0.0, 1.0, 6), np.array([0.0, 1.0, -1.0, 2.0, 0.5, 0.5])
TABLE = jnp.asarray(VALUES)

# Functions of one number in (-2, 2), among them every primitive that has a rule of its own.
FUNCTIONS = {
    "polynomial": lambda t: t**3 - 2.0 * t**2 + t - 0.5,
    "polynomial by coefficients": lambda t: jnp.polyval(jnp.array([2.0, -1.0, 0.5, 3.0]), t),
    "coefficients that vary": lambda t: jnp.polyval(jnp.stack([t, -t, 1.0 + t]), 0.7),
    "negative power": lambda t: (t + 3.0) ** -2,
    "real power": lambda t: (t + 2.5) ** 1.7,
    "quotient": lambda t: (t - 1.0) / (t + 2.5),
    "integer quotient": lambda t: jnp.asarray(jnp.floor(4.0 * t), int) // 2,
    "exponentials": lambda t: jnp.exp(t) - jnp.expm1(0.5 * t) + jnp.exp2(t),
    "logarithms": lambda t: jnp.log(t + 2.5) + jnp.log1p(0.4 * t),
    "roots": lambda t: jnp.sqrt(t + 2.0) + jnp.cbrt(t) + 1.0 / jnp.sqrt(t + 3.0),
    "reciprocal root": lambda t: jax.lax.rsqrt(t + 2.5),
    "sine": lambda t: jnp.sin(7.0 * t),
    "cosine": lambda t: jnp.cos(7.0 * t + 1.0),
    "tangent": lambda t: jnp.tan(0.7 * t),
    "inverse waves": lambda t: jnp.arcsin(0.4 * t) + jnp.arccos(0.4 * t) + jnp.arctan(3.0 * t),
    "angle": lambda t: jnp.arctan2(jnp.sin(5.0 * t), jnp.cos(5.0 * t)),
    "hyperbolic": lambda t: jnp.sinh(t) + jnp.cosh(2.0 * t) - jnp.tanh(3.0 * t),
    "slopes": jax.grad(lambda t: jnp.tanh(3.0 * t) + jnp.arctanh(0.4 * t) - jnp.arcsin(0.4 * t)),
    "inverse hyperbolic": lambda t: jnp.arcsinh(t) + jnp.arccosh(t + 3.5) + jnp.arctanh(0.4 * t),
    "sigmoid": lambda t: jax.nn.sigmoid(9.0 * t) + jax.nn.softplus(5.0 * t),
    "error functions": lambda t: jax.scipy.special.erf(t) + jax.scipy.special.erfc(2.0 * t),
    "inverse error function": lambda t: jax.scipy.special.erfinv(0.45 * t),
    "absolute": lambda t: jnp.abs(t - 0.3) * jnp.abs(t),
    "sign": lambda t: jnp.sign(t - 0.1),
    "steps": lambda t: jnp.floor(3.0 * t) + jnp.ceil(2.0 * t) - jnp.round(5.0 * t),
    "remainder": lambda t: jnp.mod(t, 0.3) + jnp.fmod(t, 0.7),
    "extremes": lambda t: jnp.maximum(t, 1.0 - t) + jnp.minimum(t, 0.2),
    "clip": lambda t: jnp.clip(t, -0.4, 0.7),
    "where": lambda t: jnp.where((t > 0.2) & (t <= 0.9), 3.0 - t, t**2),
    "where not": lambda t: jnp.where(~((t < -0.5) | (t >= 0.9)), 3.0 - t, t**2),
    "exclusive": lambda t: jnp.where(jnp.logical_xor(t < -0.5, t < 0.9), 1.0, 0.0),
    "equal": lambda t: jnp.where(t == 0.5, 7.0, t),
    "unequal": lambda t: jnp.where(t != 0.5, t, 7.0),
    "truth as a number": lambda t: t * jnp.asarray(t > 0.25, float) + jnp.asarray(t < 0.0, float),
    "number as a truth": lambda t: jnp.where(jnp.asarray(jnp.maximum(t, 0.0), bool), 2.0, 3.0),
    "finite": lambda t: jnp.where(jnp.isfinite(t), t, 0.0),
    "elu": jax.nn.elu,
    "selu": jax.nn.selu,
    "leaky": jax.nn.leaky_relu,
    "log of sum": lambda t: jax.nn.logsumexp(jnp.stack([t, 1.0 - t])),
    "heaviside": lambda t: jnp.heaviside(t - 0.4, 0.5),
    "select": lambda t: jnp.select([t < -0.2, t < 0.6], [t, 2.0 * t], 3.0),
    "piecewise": lambda t: jnp.piecewise(t, [t < 0.3, t >= 0.9], [lambda t: t, 2.0, lambda t: -t]),
    "cond": lambda t: jax.lax.cond(t > 0.5, jnp.sin, jnp.cos, t),
    "switch": lambda t: jax.lax.switch(jnp.asarray(jnp.floor(2.0 * t), int), [jnp.sin, jnp.cos, jnp.exp], t),
    "loop": lambda t: jax.lax.fori_loop(0, 4, lambda i, c: c * t + i, 1.0),
    "scan": lambda t: jax.lax.scan(lambda c, x: (c * t + x, c), 0.5, TABLE)[1].sum(),
    "scan backwards": lambda t: jax.lax.scan(lambda c, x: (c - x, c * x), 0.5, TABLE * t, reverse=True)[1][1],
    "interpolation": lambda t: jnp.interp(t, KNOTS, VALUES),
    "search": lambda t: TABLE[jnp.minimum(jnp.searchsorted(KNOTS, t), 5)],
    "table": lambda t: TABLE[jnp.sum(t >= KNOTS[1:])],
    "table of many": lambda t: jnp.sum(TABLE[jnp.stack([0, 1]) + jnp.asarray(jnp.floor(jnp.abs(t)), int)]),
    "inner product": lambda t: jnp.dot(jnp.array([1.0, -2.0, 3.0]), jnp.stack([t, t * t, jnp.sin(t)])),
    "norm": lambda t: jnp.linalg.norm(jnp.stack([t, 1.0 - t])),
    "cumulated": lambda t: jnp.cumsum(jnp.stack([t, -0.5 * t, t]))[1],
    "sorted": lambda t: jnp.sort(jnp.stack([t, -t, 0.3]))[1],
    "highest": lambda t: jnp.max(jnp.stack([t, -t, 0.3])) - jnp.min(jnp.stack([t, 0.1])),
    "place of the highest": lambda t: TABLE[jnp.argmax(jnp.stack([t, -t, 0.3]))],
    "reshaped": lambda t: jnp.concatenate([jnp.stack([t, 2.0 * t])[::-1], jnp.ones(2)]).reshape(2, 2).T[0].sum(),
    "all and any": lambda t: jnp.where(jnp.all(t > KNOTS[:3]), 1.0, jnp.where(jnp.any(t > KNOTS[3:]), 2.0, 3.0)),
    "inside jit": jax.jit(lambda t: jnp.sin(t) * t),
    "checkpoint": jax.checkpoint(lambda t: jnp.sin(t) * t),
    "custom derivative": jax.nn.relu,
}


def boxes(seed, count):
    """Intervals of many widths within (-2, 2)."""
    generator = np.random.default_rng(seed)
    middle, width = generator.uniform(-1.9, 1.9, count), 10.0 ** generator.uniform(-4.0, 0.5, count)
    return np.clip(middle - width, -1.99, 1.99), np.clip(middle + width, -1.99, 1.99)


@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_enclosure_holds_every_value(name):
    fn = lambda t: jnp.asarray(FUNCTIONS[name](t), float)  # noqa: E731
    low, high = boxes(0, 64)

    def ends(a, b):
        found = enclose(fn, Interval(a, b))
        assert not found.unknown
        return found.values[0]

    lower, upper = jax.jit(jax.vmap(ends))(low, high)
    within = np.linspace(low, high, 257, axis=1)
    values = np.asarray(jax.jit(jax.vmap(jax.vmap(fn)))(within))
    slack = 1e-13 * np.maximum(1.0, np.abs(values))
    assert np.all(lower[:, None] <= values + slack)
    assert np.all(upper[:, None] >= values - slack)


SHARP = ["sine", "cosine", "sign", "clip", "interpolation", "search", "table", "negative power"]


@pytest.mark.parametrize("name", SHARP)
def test_what_has_the_number_once_is_enclosed_without_excess(name):
    fn = lambda t: jnp.asarray(FUNCTIONS[name](t), float)  # noqa: E731
    low, high = boxes(1, 32)
    lower, upper = jax.jit(jax.vmap(lambda a, b: enclose(fn, Interval(a, b)).values[0]))(low, high)
    values = np.asarray(jax.vmap(jax.vmap(fn))(np.linspace(low, high, 20_001, axis=1)))
    np.testing.assert_allclose(lower, values.min(axis=1), rtol=1e-3, atol=2e-3)
    np.testing.assert_allclose(upper, values.max(axis=1), rtol=1e-3, atol=2e-3)


EXACT = {
    "exp": (jnp.exp, mpmath.exp),
    "sin": (jnp.sin, mpmath.sin),
    "cos": (jnp.cos, mpmath.cos),
    "tanh": (jnp.tanh, mpmath.tanh),
    "atan": (jnp.arctan, mpmath.atan),
    "sqrt": (lambda t: jnp.sqrt(t + 3.0), lambda t: mpmath.sqrt(t + 3)),
    "quotient": (lambda t: (t + 0.1) / (t + 3.0), lambda t: (t + mpmath.mpf(0.1)) / (t + 3)),
    "product": (lambda t: (t + 0.1) * (t - 0.7), lambda t: (t + mpmath.mpf(0.1)) * (t - mpmath.mpf(0.7))),
    "sum": (
        lambda t: jnp.sum(jnp.stack([t, 0.1 * t, 0.3, -1.1 * t])),
        lambda t: t + mpmath.mpf(0.1) * t + mpmath.mpf(0.3) - mpmath.mpf(1.1) * t,
    ),
    "power": (lambda t: (t + 3.0) ** 7, lambda t: (t + 3) ** 7),
    "inner product": (
        lambda t: jnp.dot(jnp.stack([t, t * t]), jnp.array([0.1, 0.7])),
        lambda t: t * mpmath.mpf(0.1) + t * t * mpmath.mpf(0.7),
    ),
}


@pytest.mark.parametrize("name", EXACT)
def test_rounded_outward_a_point_holds_the_exact_value_and_little_more(name):
    ours, exact = EXACT[name]
    points = np.random.default_rng(2).uniform(-2.0, 2.0, 100)
    enclosed = jax.jit(jax.vmap(lambda t: enclose(ours, Interval(t, t), rounding=Rounding.OUTWARD).values[0]))
    lower, upper = map(np.asarray, enclosed(points))
    with mpmath.workdps(40):
        for t, low, high in zip(points, lower, upper, strict=True):
            value = exact(mpmath.mpf(float(t)))
            assert mpmath.mpf(float(low)) <= value <= mpmath.mpf(float(high))
    assert np.all(upper - lower < 1e-13 * np.maximum(1.0, np.abs(upper)))
    assert np.all(lower < upper)


@settings(max_examples=50, deadline=None)
@given(
    st.floats(-1e3, 1e3),
    st.floats(0.0, 1e2),
    st.floats(-1e3, 1e3),
    st.floats(0.0, 1e2),
    st.floats(0, 1),
    st.floats(0, 1),
)
def test_products_and_quotients_of_intervals_hold_those_of_their_points(a, da, b, db, p, q):
    left, right = Interval(jnp.asarray(a), jnp.asarray(a + da)), Interval(jnp.asarray(b), jnp.asarray(b + db))
    x, y = min(a + p * da, a + da), min(b + q * db, b + db)
    product, quotient = enclose(lambda u, v: (u * v, u / v), left, right, rounding=Rounding.OUTWARD).values
    assert float(product.lo) <= x * y <= float(product.hi)
    if y != 0.0:
        assert float(quotient.lo) <= x / y <= float(quotient.hi)


def one(fn, low, high):
    return enclose(fn, Interval(jnp.asarray(low), jnp.asarray(high)))


def test_what_does_not_depend_on_the_interval_stays_a_point():
    found = enclose(lambda t, x: (jnp.sin(x), x * t), Interval(jnp.asarray(0.0), jnp.asarray(1.0)), 2.0)
    assert not isinstance(found.values[0], Interval)
    assert isinstance(found.values[1], Interval)


@pytest.mark.parametrize(
    "fn",
    [
        jnp.sign,
        jnp.floor,
        lambda t: jnp.where(t > 0.1, 1.0, 0.0),
        lambda t: jnp.asarray(t > 0.1, float),
        lambda t: jnp.arctan(jnp.tan(t + jnp.pi / 2)),
        lambda t: jnp.arctan2(jnp.sin(t + jnp.pi), jnp.cos(t + jnp.pi)),
        lambda t: jnp.sin(t) / jnp.abs(jnp.sin(t)),
        lambda t: jnp.mod(t, 0.3),
        lambda t: TABLE[jnp.sum(t >= KNOTS[1:])],
        lambda t: jax.lax.cond(t > 0.1, lambda: 1.0, lambda: 0.0),
    ],
    ids=["sign", "floor", "where", "truth", "tangent", "angle", "quotient", "remainder", "table", "cond"],
)
def test_what_may_jump_says_so_where_it_does_and_only_there(fn):
    assert bool(one(fn, -0.25, 0.25).jumps)
    assert not bool(one(fn, 0.11, 0.12).jumps)


def test_an_operation_without_a_rule_is_tried_within_the_box_and_named():
    found = one(lambda t: jax.scipy.special.i0e(t) + 1.0, 0.1, 0.2)
    assert found.unknown == ("bessel_i0e",)
    ends = 1.0 + ive(0, 0.2), 1.0 + ive(0, 0.1)  # it falls
    np.testing.assert_allclose([float(end) for end in found.values[0]], ends, rtol=1e-12)
    assert bool(found.jumps)


@pytest.mark.parametrize("fn", [lambda t: 1.0 / t, lambda t: jnp.tan(t + jnp.pi / 2), lambda t: t**-2])
def test_a_pole_has_no_bound(fn):
    found = one(fn, -0.1, 0.1).values[0]
    assert np.isinf(float(found.hi))
    assert np.all(np.isfinite(np.asarray(one(fn, 0.1, 0.2).values[0])))


def test_a_comparison_with_an_end_that_is_not_known_may_be_either():
    """NaN stands for an end of which nothing is known; a choice by such a comparison may be any of its cases."""
    unknown = Interval(jnp.asarray(jnp.nan), jnp.asarray(jnp.nan))
    for fn in (jnp.less, jnp.less_equal, jnp.greater, jnp.greater_equal, jnp.equal, jnp.not_equal):
        for box in ((unknown, jnp.asarray(0.5)), (jnp.asarray(0.5), unknown)):
            (found,) = enclose(fn, *box).values
            assert bool(found.may)
            assert bool(found.may_not)
    (chosen,) = enclose(lambda x: jnp.where(x < 0.5, 1.0, -2.0), unknown).values
    assert tuple(map(float, chosen)) == (-2.0, 1.0)
    (place,) = enclose(lambda x: jnp.floor(x).astype(int), unknown).values
    assert int(place.lo) < -(2**60)
    assert int(place.hi) > 2**60


@pytest.mark.parametrize(("low", "high"), [(-1.0, 0.0), (0.0, 1.0), (-1.0, 1.0)])
def test_a_quotient_by_what_reaches_zero_has_no_bound_on_its_side(low, high):
    (found,) = enclose(lambda t: 1.0 / t, Interval(jnp.asarray(low), jnp.asarray(high))).values
    for t in (low, high, 1e-200 * low, 1e-200 * high):
        if t != 0.0:
            assert float(found.lo) <= 1.0 / t <= float(found.hi)


@pytest.mark.parametrize("turns", [-0.75, -0.25, 0.25, 0.75, 1.25, 1.75])
def test_a_tangent_has_a_pole_in_every_half_turn(turns):
    pole = 2.0 * np.pi * turns
    (found,) = enclose(jnp.tan, Interval(jnp.asarray(pole - 0.2), jnp.asarray(pole + 0.3))).values
    assert tuple(map(float, found)) == (-np.inf, np.inf)
    (found,) = enclose(jnp.tan, Interval(jnp.asarray(pole + 0.1), jnp.asarray(pole + 0.3))).values
    assert tuple(map(float, found)) == pytest.approx((np.tan(pole + 0.1), np.tan(pole + 0.3)), rel=1e-9)


def test_a_tangent_is_known_as_near_to_its_pole_as_laws_go():
    """A law held at a billionth of the funnel from its edge is one number there, and next to it no pole."""
    edge = 0.5 * np.pi * (1.0 - 1e-9)
    (found,) = enclose(jnp.tan, Interval(jnp.asarray(edge), jnp.asarray(edge))).values
    assert tuple(map(float, found)) == pytest.approx((2e9 / np.pi,) * 2, rel=1e-6)
    pole = 0.5 * np.pi
    around = Interval(jnp.asarray(np.nextafter(pole, 0.0)), jnp.asarray(np.nextafter(pole, 2.0)))
    assert tuple(map(float, enclose(jnp.tan, around).values[0])) == (-np.inf, np.inf)


VECTORS = {
    "interval first": lambda t: jnp.dot(jnp.stack([t, 2.0 * t]), jnp.array([1.0, -3.0])),
    "interval last": lambda t: jnp.dot(jnp.array([1.0, -3.0]), jnp.stack([t, 2.0 * t])),
    "both": lambda t: jnp.dot(jnp.stack([t, 1.0 - t]), jnp.stack([t, 2.0 * t])),
}


@pytest.mark.parametrize("name", VECTORS)
def test_a_product_of_vectors_holds_all_its_values(name):
    ts = np.linspace(-0.5, 2.0, 301)
    values = np.asarray(jax.vmap(VECTORS[name])(ts))
    (found,) = enclose(VECTORS[name], Interval(jnp.asarray(-0.5), jnp.asarray(2.0))).values
    assert float(found.lo) <= values.min() + 1e-12
    assert float(found.hi) >= values.max() - 1e-12


@pytest.mark.parametrize("units", [1, 2, 3, 4])
def test_outward_is_by_so_many_numbers_at_least_and_twice_as_many_at_most(units):
    """Powers of two and their neighbours, where a unit in the last place changes, and numbers of every size."""
    powers = 2.0 ** np.arange(-900, 1000, 37)
    x = np.concatenate([powers, np.nextafter(powers, 0.0), np.nextafter(powers, np.inf), 1.7 * powers, [0.0, 5e-308]])
    x = np.concatenate([x, -x])
    with in_64_bits():
        low, high = map(np.asarray, jax.jit(lambda x: Rounding.OUTWARD(Interval(x, x), units))(x))
    expected = x, x
    for _ in range(units):
        expected = np.nextafter(expected[0], -np.inf), np.nextafter(expected[1], np.inf)
    assert (low <= expected[0]).all()
    assert (high >= expected[1]).all()
    is_normal = abs(x) > 1e-250
    off = np.maximum(x - low, high - x)[is_normal]
    assert (off <= (units + 0.5) * np.finfo(float).eps * abs(x[is_normal])).all()
    assert (low < 0.0)[x == 0.0].all()

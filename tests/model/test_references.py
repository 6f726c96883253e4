"""References: derivatives against multi-precision ones, and the refusal of what is not smooth."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from qsmc_jax.base.precision import enable_x64
from qsmc_jax.model import references as qr

ORDER = 6
TIMES = (0.0, 0.31, 1.0, 2.7)
number = st.floats(-3.0, 3.0)


def truth(fn, t, order=ORDER):
    """The function and its derivatives in 60 digits, by mpmath."""
    with mp.workdps(60):
        return [
            float(mp.diff(fn, mp.mpf(t), k, h=mp.mpf(10) ** -6)) if k else float(fn(mp.mpf(t)))
            for k in range(order + 1)
        ]


@eqx.filter_jit
def all_derivatives(reference, ts):
    return jnp.stack(jax.vmap(lambda t: reference.derivatives(t, ORDER))(ts), axis=-1)


def assert_derivatives(reference, fn, ts, rtol=1e-10):
    expected = np.array([truth(fn, t) for t in ts])
    atol = rtol * max(1.0, np.max(np.abs(expected)))
    np.testing.assert_allclose(all_derivatives(reference, np.array(ts)), expected, rtol=rtol, atol=atol)


# Closed forms


def test_constant_has_no_derivatives():
    assert [float(v) for v in qr.Constant(2.5).derivatives(1.0, 3)] == [2.5, 0.0, 0.0, 0.0]


@settings(max_examples=10, deadline=None)
@given(
    amplitudes=st.tuples(number, number),
    frequencies=st.tuples(number, number),
    phases=st.tuples(number, number),
    t=number,
)
def test_sum_of_sines_matches_multi_precision_derivatives(amplitudes, frequencies, phases, t):
    reference = qr.SumOfSines(amplitudes, frequencies, phases, offset=0.7)
    parameters = list(zip(amplitudes, frequencies, phases, strict=True))
    assert_derivatives(reference, lambda t: 0.7 + sum(a * mp.sin(w * t + p) for a, w, p in parameters), [t])


def test_reference_of_example_1():
    found = qr.SumOfSines([1.0], [1.0]).derivatives(0.4, 2)
    np.testing.assert_allclose(found, [math.sin(0.4), math.cos(0.4), -math.sin(0.4)], rtol=1e-15)


def test_reference_of_example_2():
    t = 0.4
    found = qr.SumOfSines([1.0, 1.0], [1.0, 0.5], [0.0, math.pi / 2]).derivatives(t, 4)
    s, c, s2, c2 = math.sin(t), math.cos(t), math.sin(t / 2), math.cos(t / 2)
    np.testing.assert_allclose(found, [s + c2, c - s2 / 2, -s - c2 / 4, -c + s2 / 8, s + c2 / 16], rtol=1e-14)


def test_sum_of_sines_evaluates_one_sine_and_one_cosine():
    program = str(jax.make_jaxpr(lambda t: qr.SumOfSines([1.0, 2.0], [1.0, 3.0]).derivatives(t, 6))(0.0))
    assert program.count(" sin ") == program.count(" cos ") == 1


def test_calling_a_reference_gives_its_value():
    assert float(qr.SumOfSines([2.0], [3.0], offset=1.0)(0.5)) == pytest.approx(1.0 + 2.0 * math.sin(1.5))


# Smooth functions: the first group by Taylor mode, the second by repeated forward mode

TAYLOR = {
    "constant": (lambda t: 1.5, lambda t: mp.mpf(1.5)),
    "whole_number": (lambda t: 3, lambda t: mp.mpf(3)),
    "line": (lambda t: 2.0 * t - 1.0, lambda t: 2 * t - 1),
    "cube": (lambda t: t**3, lambda t: t**3),
    "rational": (lambda t: (1 + t) / (2 + t**2), lambda t: (1 + t) / (2 + t**2)),
    "damped_sine": (
        lambda t: jnp.exp(-t / 3) * jnp.sin(2 * t + 0.3),
        lambda t: mp.exp(-t / 3) * mp.sin(2 * t + mp.mpf(0.3)),
    ),
    "chirp": (lambda t: jnp.cos(0.5 * t * t), lambda t: mp.cos(t * t / 2)),
    "tanh": (lambda t: jnp.tanh(t - 1), lambda t: mp.tanh(t - 1)),
    "sigmoid": (lambda t: jax.nn.sigmoid(2 * t - 1), lambda t: 1 / (1 + mp.exp(1 - 2 * t))),
    "log": (lambda t: jnp.log(2 + jnp.sin(t)), lambda t: mp.log(2 + mp.sin(t))),
    "hyperbolic": (lambda t: jnp.sinh(t / 2) / jnp.cosh(t), lambda t: mp.sinh(t / 2) / mp.cosh(t)),
    "stacked": (
        lambda t: jnp.sum(jnp.asarray([1.0, 2.0]) * jnp.sin(jnp.stack([t, 2 * t]))),
        lambda t: mp.sin(t) + 2 * mp.sin(2 * t),
    ),
    "dot": (lambda t: jnp.dot(jnp.asarray([1.0, 2.0]), jnp.stack([t, t**2])), lambda t: t + 2 * t**2),
    "jitted": (jax.jit(lambda t: jnp.sin(t) ** 2), lambda t: mp.sin(t) ** 2),
}
FORWARD = {
    "softplus": (lambda t: jax.nn.softplus(t - 1), lambda t: mp.log1p(mp.exp(t - 1))),
    "logaddexp": (lambda t: jnp.logaddexp(2 * t, 1.0), lambda t: mp.log(mp.exp(2 * t) + mp.e)),
    "sinc": (lambda t: jnp.sinc(t / 2), lambda t: mp.sincpi(t / 2)),
    "arctan": (lambda t: jnp.arctan(t), mp.atan),
    "tan": (lambda t: jnp.tan(t / 3), lambda t: mp.tan(t / 3)),
    "power": (lambda t: (1 + t) ** 2.5, lambda t: (1 + t) ** mp.mpf(2.5)),
    "sqrt": (lambda t: jnp.sqrt(1 + t**2), lambda t: mp.sqrt(1 + t**2)),
    "erf": (lambda t: jax.scipy.special.erf(t - 1), lambda t: mp.erf(t - 1)),
    "polynomial_loop": (lambda t: jnp.polyval(jnp.asarray([1.0, -2.0, 3.0]), t), lambda t: t**2 - 2 * t + 3),
    "log1p": (lambda t: jnp.log1p(t), mp.log1p),
}
SMOOTH = TAYLOR | FORWARD
each_smooth = pytest.mark.parametrize(("fn", "exact"), SMOOTH.values(), ids=SMOOTH)


@each_smooth
@pytest.mark.slow
def test_smooth_matches_multi_precision_derivatives(fn, exact):
    assert_derivatives(qr.Smooth(fn), exact, TIMES)


@each_smooth
def test_value_of_a_smooth_reference_is_that_of_its_function(fn, exact):
    assert float(qr.Smooth(fn)(0.7)) == pytest.approx(float(exact(mp.mpf("0.7"))), rel=1e-14)


@pytest.mark.parametrize("order", [0, 1, 2, 5])
@pytest.mark.parametrize("fn", [jnp.cos, jnp.arctan], ids=["taylor", "forward"])
def test_a_lower_order_gives_the_beginning_of_a_higher_one(fn, order):
    reference = qr.Smooth(fn)
    np.testing.assert_allclose(
        reference.derivatives(0.7, order), reference.derivatives(0.7, ORDER)[: order + 1], rtol=1e-12
    )


def test_a_power_is_differentiated_at_its_zero():
    # d^k/dt^k t^2.5 at 0 is 0 for k <= 2; a route through the logarithm would give NaN.
    reference = qr.Smooth(lambda t: jnp.power(t, jnp.asarray(2.5)))
    assert [float(v) for v in reference.derivatives(0.0, 2)] == [0.0, 0.0, 0.0]


@pytest.mark.parametrize("fn", [jnp.sin, jax.nn.softplus], ids=["taylor", "forward"])
def test_vmap_equals_a_loop(fn):
    reference, ts = qr.Smooth(fn), jnp.asarray(TIMES)
    batch = jnp.stack(jax.vmap(lambda t: reference.derivatives(t, 4))(ts))
    loop = np.array([[float(v) for v in reference.derivatives(t, 4)] for t in TIMES]).T
    np.testing.assert_allclose(batch, loop, rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize("transform", [jax.jit, jax.grad], ids=["jit", "grad"])
def test_a_smooth_reference_may_be_built_inside_a_trace(transform):
    found = transform(lambda t: qr.Smooth(jnp.exp).derivatives(t, 3)[3])(0.3)
    assert float(found) == pytest.approx(math.exp(0.3), rel=1e-14)


def test_a_smooth_reference_built_in_single_precision_computes_in_double():
    with enable_x64(False):
        reference = qr.Smooth(eqx.Partial(lambda a, t: jnp.sin(a * t), np.asarray(0.05)))
    assert float(reference(1.0)) == math.sin(0.05)


@pytest.mark.parametrize("fn", [jnp.sin, jnp.arctan], ids=["taylor", "forward"])
def test_time_derivative_of_each_is_the_next(fn):
    reference = qr.Smooth(fn)
    _, slopes = jax.jvp(lambda t: reference.derivatives(t, 4), (jnp.asarray(0.6),), (jnp.asarray(1.0),))
    np.testing.assert_allclose(slopes, reference.derivatives(0.6, 5)[1:], rtol=1e-12, atol=1e-14)


# Numbers held by the function


class Ramp(eqx.Module):
    width: jax.Array

    def __call__(self, t):
        return jnp.tanh(t / self.width)


@pytest.mark.parametrize(
    "build", [Ramp, lambda width: eqx.Partial(lambda w, t: jnp.tanh(t / w), width)], ids=["module", "partial"]
)
def test_numbers_held_by_the_function_are_differentiated(build):
    def slope(width):
        return qr.Smooth(build(width)).derivatives(0.0, 2)[1]

    # The slope at 0 is 1 / width.
    assert float(jax.jit(jax.grad(slope))(jnp.asarray(2.0))) == pytest.approx(-0.25)


def test_numbers_held_by_the_function_are_batched():
    batch = eqx.filter_vmap(lambda width: qr.Smooth(Ramp(width)))(jnp.asarray([1.0, 2.0, 4.0]))
    slopes = eqx.filter_vmap(lambda reference: reference.derivatives(0.0, 3)[1])(batch)
    np.testing.assert_allclose(slopes, [1.0, 0.5, 0.25], rtol=1e-15)


def test_gradients_of_a_sum_of_sines_are_finite_and_right():
    def acceleration(frequency):
        return qr.SumOfSines([2.0], [frequency]).derivatives(1.0, 2)[2]

    # d/dw (-2 w^2 sin w) = -4 w sin w - 2 w^2 cos w
    w = 1.3
    assert float(jax.grad(acceleration)(w)) == pytest.approx(-4 * w * math.sin(w) - 2 * w**2 * math.cos(w))
    assert float(jax.grad(acceleration)(0.0)) == 0.0


def test_a_kink_in_a_number_that_is_not_time_is_allowed():
    fn = eqx.Partial(lambda a, t: jnp.abs(a) * jnp.sin(t), jnp.asarray(-2.0))
    assert float(qr.Smooth(fn)(1.0)) == pytest.approx(2.0 * math.sin(1.0))


def test_a_kink_in_another_argument_of_a_jitted_function_is_allowed():
    fn = eqx.Partial(jax.jit(lambda a, t: jnp.maximum(a, 0.0) * t), jnp.asarray(3.0))
    assert [float(v) for v in qr.Smooth(fn).derivatives(2.0, 2)] == [6.0, 3.0, 0.0]


# Refusals


def test_a_table_that_is_searched_jumps():
    """Newer versions of JAX search by an operation of their own, in which nobody sees a comparison."""
    with pytest.raises(ValueError, match="must be smooth"):
        qr.Smooth(lambda t: jnp.array([0.0, 1.0, 2.0, 2.0])[jnp.searchsorted(jnp.array([1.0, 2.0, 3.0]), t)])


@jax.custom_vjp
def reverse_only(t):
    return jnp.sin(t)


reverse_only.defvjp(lambda t: (jnp.sin(t), t), lambda t, g: (g * jnp.cos(t),))

KINKED = {
    "abs": (jnp.abs, "abs"),
    "sign": (jnp.sign, "sign"),
    "floor": (jnp.floor, "floor"),
    "ceil": (jnp.ceil, "ceil"),
    "round": (jnp.round, "round"),
    "remainder": (lambda t: t % 2.0, "rem"),
    "maximum": (lambda t: jnp.maximum(t, 1.0), "max"),
    "clip": (lambda t: jnp.clip(t, 0.0, 1.0), "min"),
    "where": (lambda t: jnp.where(t < 1.0, t, t**2), "lt"),
    "step": (lambda t: (t >= 1.0).astype(float), "ge"),
    "cond": (lambda t: jax.lax.cond(t > 1.0, jnp.sin, jnp.cos, t), "gt"),
    "integer": (lambda t: t.astype(int).astype(float), "convert_element_type"),
    "sort": (lambda t: jnp.sort(jnp.stack([t, jnp.sin(t)]))[0], "sort"),
    "largest": (lambda t: jnp.max(jnp.stack([jnp.cos(t), jnp.sin(t)])), "reduce_max"),
    "second derivative": (lambda t: jax.nn.elu(t - 1.0), "gt"),
    "third derivative": (lambda t: jnp.maximum(t - 2.0, 0.0) ** 3, "max"),
    "narrow": (lambda t: t + jnp.where((t > 5.0) & (t < 5.001), 1.0, 0.0), "lt"),
    "late": (lambda t: jnp.where(t > 12345.6, t, jnp.sin(t)), "gt"),
    "small": (lambda t: jnp.sin(t) + 1e-3 * jnp.abs(t - 7.5), "abs"),
    "tiny jump": (lambda t: jnp.sin(t) + jnp.where(t > 7.5, 1e-5, 0.0), "gt"),
    "hidden in the second": (lambda t: t + 1e-3 * (t - jax.lax.stop_gradient(t)) ** 2, "stop_gradient"),
    "interpolation": (lambda t: jnp.interp(t, jnp.arange(3.0), jnp.asarray([0.0, 1.0, 0.0])), "gt"),
    "hidden_derivative": (lambda t: t * jax.lax.stop_gradient(t), "stop_gradient"),
    "inside_jit": (jax.jit(lambda t: jnp.abs(jnp.sin(t))), "abs"),
    "inside_loop": (lambda t: jax.lax.fori_loop(0, 3, lambda i, a: jnp.abs(a - 0.1), t), "abs"),
    "derivative_rule": (lambda t: jax.nn.relu(t - 1.0), "gt"),
    "after_a_smooth_one": (lambda t: jnp.abs(jnp.tanh(t)), "abs"),
}


@pytest.mark.parametrize(("fn", "primitive"), KINKED.values(), ids=KINKED)
def test_a_function_that_is_not_smooth_is_refused(fn, primitive):
    with pytest.raises(ValueError, match=rf"`fn` of `Smooth` must be smooth, but uses .*`{primitive}`"):
        qr.Smooth(fn)


# Smooth, though they compare.
COMPARING = {
    "log of sum": (
        lambda t: jax.nn.logsumexp(jnp.stack([t, 1.0 - t, 0.0 * t])),
        lambda t: mp.log(mp.exp(t) + mp.exp(1 - t) + 1),
    ),
    "logaddexp": (lambda t: jnp.logaddexp(t, 1.0), lambda t: mp.log(mp.exp(t) + mp.e)),
    "softmax": (
        lambda t: jax.nn.softmax(jnp.stack([t, jnp.sin(t)]))[0],
        lambda t: mp.exp(t) / (mp.exp(t) + mp.exp(mp.sin(t))),
    ),
    "guard": (
        lambda t: jnp.where(
            t > 1e-2, jnp.sin(t) / jnp.where(t > 1e-2, t, 1.0), 1 - t**2 / 6 + t**4 / 120 - t**6 / 5040
        ),
        lambda t: mp.sin(t) / t if t else mp.mpf(1),
    ),
    "square of abs": (lambda t: jnp.abs(jnp.sin(t)) ** 2, lambda t: mp.sin(t) ** 2),
    "never switches": (lambda t: t * jnp.maximum(jnp.sin(t), 2.0), lambda t: 2 * t),
}


@pytest.mark.parametrize(("fn", "exact"), COMPARING.values(), ids=COMPARING)
@pytest.mark.slow
def test_a_smooth_function_may_compare(fn, exact):
    found = jnp.stack(qr.Smooth(fn).derivatives(0.7, 3))
    np.testing.assert_allclose(found, truth(exact, 0.7, 3), rtol=1e-9, atol=1e-9)


def test_a_bump_that_ends_is_smooth():
    def bump(t):
        is_inside = jnp.abs(t - 3.0) < 1.0
        return jnp.where(is_inside, jnp.exp(-1.0 / (1.0 - jnp.where(is_inside, t - 3.0, 0.0) ** 2)), 0.0)

    assert [float(v) for v in qr.Smooth(bump).derivatives(4.5, 2)] == [0.0, 0.0, 0.0]


def test_a_kink_is_told_with_its_place_and_height():
    with pytest.raises(ValueError, match=r"uses `abs`.*, and derivative 1 jumps from -3 to 3 at t = 2\.5\."):
        qr.Smooth(lambda t: 3.0 * jnp.abs(t - 2.5))


def test_numbers_decide_whether_a_function_that_compares_is_smooth_and_traced_ones_pass():
    def build(a):
        return qr.Smooth(eqx.Partial(lambda a, t: t + a * jnp.abs(t - 1.0), a))

    assert float(build(jnp.asarray(0.0))(2.0)) == 2.0
    assert float(jax.jit(lambda a: build(a)(3.0))(0.5)) == 4.0
    with pytest.raises(ValueError, match="must be smooth"):
        build(jnp.asarray(0.5))


REFUSED = {
    "python if": (
        lambda: qr.Smooth(lambda t: t if t > 1 else 0.0),
        "must be written with `jax.numpy`, .* in place of a Python `if`.* stand-ins for the time",
    ),
    "math module": (lambda: qr.Smooth(math.sin), "must be written with `jax.numpy`, not `numpy` or `math`"),
    "reverse only": (lambda: qr.Smooth(reverse_only), "must have a forward derivative"),
    "not callable": (lambda: qr.Smooth(eqx.Partial(3.0)), "must be a function of time"),
    "vector": (lambda: qr.Smooth(lambda t: jnp.stack([t, t])), r"must return a single number, but has shape \(2,\)"),
    "infinite slope": (lambda: qr.Smooth(jnp.sqrt), r"finite derivative at t = 0, but these are \[0.0, inf\]"),
    "infinite value": (lambda: qr.Smooth(jnp.log), "must be finite"),
    "hidden number": (
        lambda: jax.jit(lambda a: qr.Smooth(lambda t: a * jnp.sin(t))(1.0))(2.0),
        "must show the numbers it depends on",
    ),
    "unequal lengths": (lambda: qr.SumOfSines([1.0], [1.0, 2.0]), "`frequencies` must have shape"),
    "too many phases": (lambda: qr.SumOfSines([1.0], [1.0], [0.0, 1.0]), "`phases` must have shape"),
    "scalar amplitudes": (lambda: qr.SumOfSines(1.0, 1.0), "`amplitudes` .* must be a one-dimensional list"),
    "infinite offset": (lambda: qr.SumOfSines([1.0], [1.0], offset=math.inf), "`offset` must be finite"),
    "infinite amplitude": (lambda: qr.SumOfSines([math.inf], [1.0]), "`amplitudes` must be finite"),
    "infinite constant": (lambda: qr.Constant(math.nan), "`value` must be finite"),
}


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_a_wrong_argument_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()

"""Elementary functions against mpmath, in units in the last place."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st

from qsmc_jax.numerics import elementary
from qsmc_jax.tracing.programs import parts, programs_in

TRUTH = {"sin": mp.sin, "cos": mp.cos, "tan": mp.tan, "atan": mp.atan}
PLAIN = {"sin": jnp.sin, "cos": jnp.cos, "tan": jnp.tan, "atan": jnp.arctan}
TRIGONOMETRIC = ["sin", "cos", "tan"]
LIMIT = 2.0**30
TOO_LARGE = 2.0**51
REDUCIBLE = st.floats(-LIMIT, LIMIT) | st.floats(-10.0, 10.0) | st.floats(1e-300, 1e-3)
FAR_MULTIPLE = int(LIMIT * 2 / np.pi)
ARITHMETIC = {"add", "sub", "mul", "div", "neg", "abs", "round", "floor"}
CHOICE = {"eq", "ne", "lt", "le", "gt", "ge", "and", "select_n", "bitcast_convert_type"}
STRUCTURE = {"broadcast_in_dim", "convert_element_type", "jit", "custom_jvp_call"}


def ulps(value, truth):
    """The error in units of the last place of the true value."""
    return float(abs(mp.mpf(float(value)) - truth)) / np.spacing(abs(float(truth)))


def errors(name, *arguments, compiled=True):
    with jax.disable_jit(not compiled):
        values = jax.jit(getattr(elementary, name))(jnp.asarray(arguments))
    with mp.workdps(60):
        return [ulps(value, TRUTH[name](mp.mpf(x))) for value, x in zip(values, arguments, strict=True)]


def hardest_arguments():
    """The float64 numbers up to 2^30 next to a multiple of pi/2: convergents of pi/2 in units of 2^exponent."""
    with mp.workprec(300):
        for exponent in range(-52, -22):
            fraction, older, newer = mp.pi / 2 / mp.mpf(2) ** exponent, (0, 1), (1, 0)
            while newer[0] < 2**53:
                if newer[1] and newer[0] * 2.0**exponent <= LIMIT:
                    yield newer[0] * 2.0**exponent
                digit = int(mp.floor(fraction))
                fraction = 1 / (fraction - digit)
                older, newer = newer, (digit * newer[0] + older[0], digit * newer[1] + older[1])


def primitives(program):
    for equation in parts(program).equations:
        yield equation.name
        for inner in programs_in(equation.params):
            yield from primitives(inner)


@pytest.mark.parametrize("name", TRIGONOMETRIC)
@settings(deadline=None, max_examples=200)
@given(REDUCIBLE)
@example(LIMIT)
@example(0.7853981633974483)
@example(-0.6743400000000001)
def test_trigonometric_functions_are_within_two_ulps(name, x):
    assert max(errors(name, x)) < 2.0


@settings(deadline=None, max_examples=300)
@given(st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False) | st.floats(-5.0, 5.0))
def test_atan_is_within_two_ulps_on_all_reals(x):
    assert max(errors("atan", x)) < 2.0


@pytest.mark.parametrize("name", TRIGONOMETRIC)
@settings(deadline=None, max_examples=100)
@given(st.integers(-FAR_MULTIPLE, FAR_MULTIPLE), st.integers(-3, 3))
def test_next_to_multiples_of_half_pi_all_digits_hold(name, k, steps):
    x = k * np.pi / 2
    assert max(errors(name, x + steps * np.spacing(x))) < 2.0


# Run operation by operation, no product is contracted with a sum, as a compiler with such an instruction does.
@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "not contracted"])
@pytest.mark.parametrize("name", TRIGONOMETRIC)
def test_the_hardest_arguments_are_within_two_ulps(name, compiled):
    arguments = sorted(set(hardest_arguments()))
    assert len(arguments) > 100
    assert min(abs(np.asarray(jnp.cos(jnp.asarray(arguments))))) < 1e-16
    assert max(errors(name, *arguments, compiled=compiled)) < 2.0


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "not contracted"])
@pytest.mark.parametrize("name", TRIGONOMETRIC)
def test_where_rounding_errors_add_up_the_results_are_within_two_ulps(name, compiled):
    """Halfway between multiples of pi/2, where the rest is largest, and where sin(rest) is just below 1/2."""
    rng = np.random.default_rng(0)
    k = np.floor(2.0 ** rng.uniform(0.0, 29.0, 1000))
    rests = rng.choice([np.pi / 4, 0.52], 1000) + rng.uniform(-0.003, 0.003, 1000)
    assert max(errors(name, *(k * np.pi / 2 + rests), compiled=compiled)) < 2.0


@pytest.mark.parametrize("k", [1, 7, 1000, 12345, 10**8])
def test_sine_is_strictly_monotone_across_multiples_of_pi(k):
    x = k * np.pi
    slopes = np.diff(elementary.sin(x + np.arange(-50, 51) * np.spacing(x)))
    assert np.all((slopes if k % 2 == 0 else -slopes) > 0)


@pytest.mark.parametrize("name", ["sin", "cos"])
@settings(deadline=None, max_examples=100)
@given(st.floats(LIMIT, TOO_LARGE, exclude_max=True))
def test_beyond_the_limit_the_error_is_that_of_the_last_bit_of_the_argument(name, x):
    with mp.workdps(60):
        assert abs(float(getattr(elementary, name)(x)) - TRUTH[name](mp.mpf(x))) < 2.0**-52 * x


@pytest.mark.parametrize("compiled", [True, False], ids=["compiled", "not contracted"])
def test_sine_and_cosine_stay_bounded_beyond_the_limit(compiled):
    x = jnp.asarray(2.0 ** np.random.default_rng(0).uniform(30.0, 51.0, 100_000))
    with jax.disable_jit(not compiled):
        for f in (elementary.sin, elementary.cos):
            assert np.max(np.abs(jax.jit(f)(x))) <= 1.0


@pytest.mark.parametrize("name", TRIGONOMETRIC)
@pytest.mark.parametrize("x", [TOO_LARGE, -TOO_LARGE, 1e16, -1e22, 1e100, -1.7e308])
def test_arguments_too_large_to_reduce_give_zero(name, x):
    assert getattr(elementary, name)(np.nextafter(TOO_LARGE, 0.0)) != 0.0
    assert getattr(elementary, name)(x) == 0.0


@pytest.mark.parametrize("x", [np.inf, -np.inf, np.nan])
@pytest.mark.parametrize("name", TRIGONOMETRIC)
def test_infinity_and_nan_give_nan(name, x):
    assert np.isnan(getattr(elementary, name)(x))


def test_atan_at_the_ends_of_the_line():
    assert elementary.atan(np.inf) == np.pi / 2
    assert elementary.atan(-np.inf) == -np.pi / 2
    assert np.isnan(elementary.atan(np.nan))


@pytest.mark.parametrize("name", ["sin", "tan", "atan"])
@pytest.mark.parametrize("x", [0.0, -0.0, 5e-324, -1e-310, 2.3e-308])
def test_zeros_keep_their_sign_and_tiny_numbers_their_value(name, x):
    value = np.asarray(jax.jit(getattr(elementary, name))(x))
    assert value.tobytes() == np.float64(x).tobytes()


def on_points(derivative, f):
    return jax.jit(jax.vmap(derivative(f)))(jnp.array([-20.3, -1.0, -0.0, 0.4, 0.785, 2.5, 1e5]))


@pytest.mark.parametrize("derivative", [jax.grad, jax.jacfwd], ids=["reverse", "forward"])
@pytest.mark.parametrize("name", TRUTH)
def test_slopes_are_those_of_the_closed_forms(name, derivative):
    slopes = [on_points(derivative, f) for f in (getattr(elementary, name), PLAIN[name])]
    np.testing.assert_allclose(*slopes, rtol=1e-14)


@pytest.mark.parametrize("name", TRUTH)
def test_third_derivatives_are_those_of_the_closed_forms(name):
    third = [
        on_points(lambda f: jax.grad(jax.grad(jax.jacfwd(f))), f) for f in (getattr(elementary, name), PLAIN[name])
    ]
    np.testing.assert_allclose(*third, rtol=1e-12, atol=1e-14)


@pytest.mark.parametrize("x", [1e170, -1e300])
def test_the_slope_of_atan_vanishes_far_out(x):
    assert jax.grad(elementary.atan)(x) == 0.0


@pytest.mark.parametrize("name", TRUTH)
def test_shapes_are_kept(name):
    x = jnp.linspace(-1.0, 1.0, 6).reshape(2, 3)
    np.testing.assert_allclose(getattr(elementary, name)(x), PLAIN[name](x), rtol=1e-15)


@pytest.mark.parametrize("name", TRUTH)
def test_other_dtypes_go_to_jax(name):
    x = jnp.linspace(-1.0, 1.0, 6, dtype=np.float32)
    np.testing.assert_array_equal(getattr(elementary, name)(x), PLAIN[name](x), strict=True)


@pytest.mark.parametrize("name", TRUTH)
def test_only_operations_that_vectorise_are_used(name):
    program = jax.make_jaxpr(getattr(elementary, name))(jnp.ones(4))
    assert set(primitives(program)) <= ARITHMETIC | CHOICE | STRUCTURE

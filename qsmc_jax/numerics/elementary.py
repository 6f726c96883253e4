r"""Sine, cosine, tangent and arctangent in float64 that XLA turns into vector instructions on a CPU.

XLA calls the scalar C library for these, several times slower, and the loop around such a call isn't vectorised either.
Here they are plain arithmetic without branches or tables, on any backend, with exact derivatives of every order. Under
`jit`, sine and cosine of the same argument cost one of them. Other dtypes go to `jax.numpy`.

Accuracy: within 2 units in the last place (measured: sine and cosine 1.5, tangent 1.6, arctangent 0.9), the
trigonometric functions for $|x| \le 2^{30}$, whether or not the compiler contracts products and sums. Beyond that, the
result is that of an argument wrong by at most $2^{-52} |x|$: sine and cosine stay in [-1, 1] but lose their digits, and
from $2^{51}$ on, where arguments are half a radian apart, all three are 0. Infinity and NaN give NaN, zeros keep their
sign, and the arctangent is accurate on all of the real line.

Source: fdlibm (Sun Microsystems, 1993), k_sin.c, k_cos.c, k_tan.c, s_atan.c: coefficients, and the order of summation
but for sine and cosine. The reduction by pi/2 without branches is ours.
"""

import math
from collections.abc import Callable
from typing import TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, ArrayLike, Float

Pair: TypeAlias = tuple[Array, Array]  # a float64 and the part of the number below its last place

# pi/2 as a sum of four 23-bit parts and a rest: multiples up to 2^30 of a part are exact in float64.
_PARTS = tuple(
    float.fromhex(part)
    for part in ("0x1.921fb4p+0", "0x1.4442dp-24", "0x1.846988p-48", "0x1.8cc514p-72", "0x1.80dc1cd129025p-95")
)
_TOO_LARGE = 2.0**51  # smaller arguments leave a rest below 1.4, where the sine's polynomial is below 1
_TO_INTEGER = 1.5 * 2.0**52  # added to an integer below 2^51 in size, it leaves that integer in the last bits

_STEEP = 0.67434  # from here to pi/4 the tangent's polynomial would need more terms
_QUARTER_PI = (7.85398163397448278999e-01, 3.06161699786838301793e-17)

_SIN = (
    -1.66666666666666324348e-01,
    8.33333333332248946124e-03,
    -1.98412698298579493134e-04,
    2.75573137070700676789e-06,
    -2.50507602534068634195e-08,
    1.58969099521155010221e-10,
)
_COS = (
    -0.5,
    4.16666666666666019037e-02,
    -1.38888888888741095749e-03,
    2.48015872894767294178e-05,
    -2.75573143513906633035e-07,
    2.08757232129817482790e-09,
    -1.13596475577881948265e-11,
)
_TAN = (
    3.33333333333334091986e-01,
    1.33333333333201242699e-01,
    5.39682539762260521377e-02,
    2.18694882948595424599e-02,
    8.86323982359930005737e-03,
    3.59207910759131235356e-03,
    1.45620945432529025516e-03,
    5.88041240820264096874e-04,
    2.46463134818469906812e-04,
    7.81794442939557092300e-05,
    7.14072491382608190305e-05,
    -1.85586374855275456654e-05,
    2.59073051863633712884e-05,
)
_ATAN = (
    3.33333333333329318027e-01,
    -1.99999999998764832476e-01,
    1.42857142725034663711e-01,
    -1.11111104054623557880e-01,
    9.09088713343650656196e-02,
    -7.69187620504482999495e-02,
    6.66107313738753120669e-02,
    -5.83357013379057348645e-02,
    4.97687799461593236017e-02,
    -3.65315727442169155270e-02,
    1.62858201153657823623e-02,
)
# From each threshold on, arctan is expanded about `centre`; the arctangent there is `high + low`.
_ATAN_CENTRES = (
    (7 / 16, 0.5, 4.63647609000806093515e-01, 2.26987774529616870924e-17),
    (11 / 16, 1.0, 7.85398163397448278999e-01, 3.06161699786838301793e-17),
    (19 / 16, 1.5, 9.82793723247329054082e-01, 1.39033110312309984516e-17),
    (39 / 16, math.inf, 1.57079632679489655800e00, 6.12323399573676603587e-17),
)


# Each function is jitted inside, so that a program with hundreds of calls, a Runge-Kutta step say, traces it only once.
@jax.custom_jvp
def sin(x: Float[ArrayLike, " *shape"]) -> Float[Array, " *shape"]:
    """The sine of `x` [rad]."""
    return _in_float64(_sin, jnp.sin, x)


@jax.custom_jvp
def cos(x: Float[ArrayLike, " *shape"]) -> Float[Array, " *shape"]:
    """The cosine of `x` [rad]."""
    return _in_float64(_cos, jnp.cos, x)


@jax.custom_jvp
def tan(x: Float[ArrayLike, " *shape"]) -> Float[Array, " *shape"]:
    """The tangent of `x` [rad]."""
    return _in_float64(_tan, jnp.tan, x)


@jax.custom_jvp
def atan(x: Float[ArrayLike, " *shape"]) -> Float[Array, " *shape"]:
    """The arctangent of `x` [rad], in [-pi/2, pi/2]."""
    return _in_float64(_atan, jnp.arctan, x)


sin.defjvps(lambda x_dot, _, x: x_dot * cos(x))
cos.defjvps(lambda x_dot, _, x: -x_dot * sin(x))
tan.defjvps(lambda x_dot, y, _: x_dot * (1.0 + y * y))
atan.defjvps(lambda x_dot, _, x: x_dot / (1.0 + x * x))


def _in_float64(fast: Callable[[Array], Array], other: Callable[[Array], Array], x: ArrayLike) -> Array:
    x = jnp.asarray(x)
    return fast(x) if x.dtype == np.float64 else other(x)


@jax.jit
def _sin(x: Array) -> Array:
    return jnp.where(x == 0.0, x, _sine(x, 0))  # keeps the sign of zero, and numbers so small that XLA has them for 0


@jax.jit
def _cos(x: Array) -> Array:
    return _sine(x, 1)


@jax.jit
def _tan(x: Array) -> Array:
    n = jnp.round(x * (2.0 / math.pi))
    y = _tan_kernel(*_rest(x, n), _last_bits(n) & 1 != 0)
    return jnp.where(x == 0.0, x, _unless_too_large(x, y))


def _sine(x: Array, ahead: int) -> Array:
    """The sine of `x + ahead pi/2`."""
    n = jnp.round(x * (2.0 / math.pi))
    rest, low = _rest(x, n)
    quadrant = _last_bits(n + ahead)
    y = jnp.where(quadrant & 1 == 0, _sin_kernel(rest, low), _cos_kernel(rest))
    return _unless_too_large(x, jnp.where(quadrant & 2 == 0, y, -y))


def _last_bits(n: Array) -> Array:
    """An int64 that ends like the integer `n`, |n| <= 2^51. A conversion would check for overflow."""
    return jax.lax.bitcast_convert_type(n + _TO_INTEGER, np.int64)


def _unless_too_large(x: Array, y: Array) -> Array:
    """`y`, or 0 where `x` is too large, or NaN where it is no number. Done last, nothing has to wait for it."""
    return jnp.where(jnp.abs(x) < _TOO_LARGE, y, 0.0 * x)


def _rest(x: Array, n: Array) -> Pair:
    """`x - n pi/2` as a float64 and its rounding error, to its last bit even next to a multiple of pi/2.

    Up to 2^30, the first four products are exact. So is `coarse`, which is below 1 and a multiple of the last place of
    `x`, at least 2^-53, or of 2^-44. What the next two sums round off is kept. The low part is at most 2^-64 and half
    of the last place of the rest, and wrong by less than 2^-116, while no float64 leaves a rest below 2^-61.
    """
    first, second, third, fourth, fifth = (n * -part for part in _PARTS)
    coarse = (x + first) + second
    fine, fine_low = _fast_two_sum(third, fourth)
    rest, low = _fast_two_sum(coarse, fine)
    return rest, low + (fine_low + fifth)


def _fast_two_sum(a: Array, b: Array) -> Pair:
    """The sum and its rounding error; exact if |a| >= |b| or a is a multiple of the last place of b."""
    total = a + b
    return total, b - (total - a)


def _sin_kernel(x: Array, low: Array) -> Array:
    """The sine of `x + low`, to first order in the low part."""
    z = x * x
    return x + (low + x * z * _polynomial(z, _SIN))


def _cos_kernel(x: Array) -> Array:
    """The cosine of `x`. It is 0.7 at least: half of the last place of `x` makes a third of its own."""
    z = x * x
    return 1.0 + z * _polynomial(z, _COS)


def _tan_kernel(x: Array, low: Array, is_odd: Array) -> Array:
    """The tangent, or the negative cotangent where n is odd; near pi/4 by way of the tangent t of pi/4 - x."""
    sign, v = jnp.where(x < 0.0, -1.0, 1.0), jnp.where(is_odd, -1.0, 1.0)
    x, low = sign * x, sign * low
    is_steep = x > _STEEP
    x = jnp.where(is_steep, (_QUARTER_PI[0] - x) + (_QUARTER_PI[1] - low), x)
    low = jnp.where(is_steep, 0.0, low)
    z = x * x
    cube = z * x
    r = (low + z * (cube * _polynomial(z, _TAN[1:]) + low)) + _TAN[0] * cube
    t = x + r
    over = jnp.where(is_steep, t * t, jnp.where(is_odd, -1.0, t))
    under = jnp.where(is_steep, t + v, jnp.where(is_odd, t, 1.0))
    steep = jnp.where(is_steep, 1.0, 0.0)
    # Both cases in one expression: XLA cuts a loop in two after a quotient that is used twice.
    return sign * (steep * v - (1.0 + steep) * (steep * x - (over / under - steep * r)))


def _atan(x: Array) -> Array:
    size = jnp.abs(x)
    centre, high, low = (jnp.zeros_like(x) for _ in range(3))
    for threshold, *about in _ATAN_CENTRES:
        centre, high, low = (
            jnp.where(size < threshold, old, new) for old, new in zip((centre, high, low), about, strict=True)
        )
    is_large = size >= _ATAN_CENTRES[-1][0]
    tangent = jnp.where(is_large, -1.0, size - centre) / jnp.where(is_large, size, 1.0 + centre * size)
    z = tangent * tangent
    y = high - ((tangent * z * _polynomial(z, _ATAN) - low) - tangent)
    return jnp.where(x == 0.0, x, jnp.where(x < 0.0, -y, y))


def atan_of_small(t: Array) -> Array:
    """The arctangent of |t| <= 7/16, within 1 unit in the last place."""
    z = t * t
    return t - t * z * _polynomial(z, _ATAN)


def _polynomial(z: Array, coefficients: tuple[float, ...]) -> Array:
    """The polynomial in `z`, lowest coefficient first."""
    value = jnp.full_like(z, coefficients[-1])
    for coefficient in coefficients[-2::-1]:
        value = coefficient + z * value
    return value

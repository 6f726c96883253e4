r"""The funnel coordinate: hyperbolic functions that keep their digits at the edge of the funnel and at its centre.

With $z = \sigma / \rho$ in (-1, 1) and $s = \operatorname{arsinh}\tan(\pi z / 2)$, the whole open funnel becomes the
real line: $z = \frac{2}{\pi}\operatorname{gd}(s)$ and the control is $\mp\sinh s$. Every function is built on `expm1`,
which XLA vectorises on a CPU, and written without `abs` or `sign`, whose derivatives at 0 would be 0.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.numerics.elementary import atan_of_small

_LARGEST = 700.0  # exp overflows a float64 at 709; a coordinate beyond this stands for this


@jax.custom_jvp
def gd(s: RealScalarLike) -> Float[Array, ""]:
    r"""The Gudermannian $\operatorname{gd}(s) = \arctan\sinh s = 2\arctan\tanh(s/2)$ [rad], in (-pi/2, pi/2)."""
    sign, m = _sign_and_expm1(s)
    # Twice the arctangent of tanh(|s|/2) = m / (m + 2), or from sqrt(2) - 1 on pi/2 less that of exp(-|s|).
    is_large = m > math.sqrt(2.0)
    half = atan_of_small(jnp.where(is_large, 1.0, m) / jnp.where(is_large, m + 1.0, m + 2.0))
    return sign * jnp.where(is_large, 0.5 * math.pi - 2.0 * half, 2.0 * half)


@gd.defjvp
def _gd_jvp(primals: tuple[RealScalarLike], tangents: tuple[RealScalarLike]) -> tuple[Array, Array]:
    # The derivative is 1 / cosh s; differentiating the formula term by term cancels for large s.
    (s,), (s_dot,) = primals, tangents
    return gd(s), jnp.asarray(s_dot / sinh_cosh(s)[1])


def ratio(s: RealScalarLike) -> Float[Array, ""]:
    r"""The funnel ratio $z = \sigma / \rho = \frac{2}{\pi}\operatorname{gd}(s)$ [-] at the funnel coordinate `s`."""
    return (2.0 / math.pi) * gd(s)


def margin(s: RealScalarLike) -> Float[Array, ""]:
    r"""The distance to the funnel, $1 - |z| = \frac{4}{\pi}\arctan e^{-|s|}$ [-], without cancellation near 0."""
    return (4.0 / math.pi) * jnp.arctan(jnp.exp(-jnp.abs(s)))


def sinh_cosh(s: RealScalarLike) -> tuple[Float[Array, ""], Float[Array, ""]]:
    r"""$\sinh s$ and $\cosh s$ from one exponential, to a few units in the last place for $|s| \le 700$."""
    sign, m = _sign_and_expm1(s)
    decayed = m / (m + 1.0)  # 1 - exp(-|s|)
    return sign * 0.5 * (m + decayed), 1.0 + 0.5 * m * decayed


def funnel_coordinate(z: RealScalarLike) -> Float[Array, ""]:
    r"""The coordinate $s = \operatorname{arsinh}\tan(\pi z/2)$ [-] of the funnel ratio `z`; NaN unless |z| < 1."""
    return jnp.arcsinh(tan_half_pi(z, 1.0))


def tan_half_pi(sigma: RealScalarLike, rho: RealScalarLike) -> Float[Array, ""]:
    r"""$\tan\frac{\pi\sigma}{2\rho}$ on its middle branch: NaN unless $|\sigma| < \rho$.

    The tangent is periodic, so beyond the pole it returns a plausible number of the wrong sign; here it never does.
    Beyond $|\sigma| = \rho / 2$ it is the cotangent of the distance $\rho - |\sigma|$, which floating point knows
    exactly.
    """
    sigma, rho = jnp.asarray(sigma), jnp.asarray(rho)
    sign, size = _sign_and_size(sigma)
    inside = size < rho
    near_edge = inside & (size > 0.5 * rho)
    arc = jnp.where(near_edge, rho - size, size) / jnp.where(inside, rho, 1.0)
    tangent = jnp.tan(0.5 * math.pi * jnp.where(inside, arc, 0.5))
    cotangent = 1.0 / jnp.where(near_edge, tangent, 1.0)
    return jnp.where(inside, sign * jnp.where(near_edge, cotangent, tangent), jnp.nan)


def _sign_and_expm1(s: RealScalarLike) -> tuple[Float[Array, ""], Float[Array, ""]]:
    sign, size = _sign_and_size(jnp.asarray(s))
    return sign, jnp.expm1(jnp.minimum(size, _LARGEST))


def _sign_and_size(s: Float[Array, ""]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The sign, +1 at 0, and the absolute value, with derivative 1 at 0: so an odd function keeps its slope there."""
    negative = s < 0
    return jnp.where(negative, -jnp.ones_like(s), jnp.ones_like(s)), jnp.where(negative, -s, s)

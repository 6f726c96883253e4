r"""Continuous stand-ins for functions that jump, such as dry friction, each with a width over which it turns.

A solver can't go on where a loop sticks on a jump: the motion there is none of either side. Rounded over a width w the
loop creeps instead, at speeds of the order of w. Choose w well below the speeds (or distances) that matter; a smaller
one costs steps only where the loop sticks, for the implicit methods take its stiffness. An example: a unit mass with
unit Coulomb friction that follows a sine and sticks at each turn has a peak of $|\sigma| / \rho$ that is right to 3e-5
with w = 1e-4, in some 1600 steps.

All may be differentiated, also in their widths, and stay finite as long as $v / w^2$ does.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_finite, require_nonnegative, show
from qsmc_jax.base.types import RealScalarLike


def sign(v: RealScalarLike, width: RealScalarLike) -> Float[Array, ""]:
    r"""A sign that turns over a width, $\tanh(v / w)$.

    Within 5e-9 of the sign from ten widths on, within 1e-4 from five, and .76 at one. Its slope is $1/w$ at 0.

    Args:
        v: What has the sign, such as a velocity.
        width: Width w of the turn, positive, in units of `v`.

    Raises:
        InputError: The width is not positive.

    Examples:
        Coulomb friction of 2 m/s^2, rounded over 1e-4 m/s:

        >>> import qsmc_jax as qj
        >>> [round(float(-2.0 * qj.smoothed.sign(v, 1e-4)), 4) for v in (-1.0, 0.0, 1e-4, 1e-3)]
        [2.0, -0.0, -1.5232, -2.0]
    """
    return jnp.tanh(_in_widths(v, width))


def step(v: RealScalarLike, width: RealScalarLike) -> Float[Array, ""]:
    r"""A step from 0 to 1 that rises over a width, $(1 + \tanh(v / w)) / 2$; one half at 0.

    Within 5e-5 of the step from five widths on. For `jnp.where(v > 0, b, a)` write `a + (b - a) * step(v, width)`.

    Args:
        v: What the step is in.
        width: Width w of the rise, positive, in units of `v`.

    Raises:
        InputError: The width is not positive.

    Examples:
        A gain of 2 that falls to 1 above 0.5 rad:

        >>> import qsmc_jax as qj
        >>> [round(float(2.0 - qj.smoothed.step(angle - 0.5, 1e-3)), 4) for angle in (0.0, 0.5, 1.0)]
        [2.0, 1.5, 1.0]
    """
    return jax.nn.sigmoid(2.0 * _in_widths(v, width))


def dead_zone(v: RealScalarLike, half_gap: RealScalarLike, width: RealScalarLike) -> Float[Array, ""]:
    r"""A dead zone, or play, with rounded edges, $w\,[\ell((v - h)/w) - \ell((-v - h)/w)]$, $\ell(z) = \ln(1 + e^z)$.

    Zero inside $|v| < h$, $v \mp h$ outside, and at most $w \ln 2$ from it anywhere, that far at the edges; less than
    $0.007\,w$ from five widths off an edge on. Odd; its slope lies between 0 and 1.

    Args:
        v: What has the gap, such as an angle between gear and shaft.
        half_gap: Half the gap h, not negative, in units of `v`.
        width: Width w of the edges, positive, in units of `v`.

    Raises:
        InputError: The width is not positive, or the gap is negative.

    Examples:
        >>> import qsmc_jax as qj
        >>> [round(float(qj.smoothed.dead_zone(v, half_gap=0.1, width=1e-3)), 6) for v in (-1.0, 0.05, 0.1, 0.3)]
        [-0.9, 0.0, 0.000693, 0.2]
    """
    require_nonnegative("half_gap", half_gap)
    above, below = _in_widths(v - half_gap, width), _in_widths(-v - half_gap, width)
    return jnp.asarray(width) * (jax.nn.softplus(above) - jax.nn.softplus(below))


def stribeck(
    v: RealScalarLike,
    coulomb: RealScalarLike,
    static: RealScalarLike,
    stribeck_velocity: RealScalarLike,
    viscous: RealScalarLike = 0.0,
    *,
    width: RealScalarLike,
) -> Float[Array, ""]:
    r"""The friction that falls as sliding begins, $[F_c + (F_s - F_c)\, e^{-(v / v_s)^2}] \tanh(v / w) + b v$.

    It has the sign of the velocity: subtract it in a drift. Within 1e-4 of the same with a true sign from five widths
    on, relative to its first term. With w a hundredth of $v_s$ its peak is within 0.3 % of $F_s$.

    Args:
        v: Velocity, in m/s or rad/s.
        coulomb: Friction of sliding $F_c$, not negative, in the units of the result: of the drift, say m/s^2.
        static: Friction at rest $F_s$, not negative.
        stribeck_velocity: Velocity $v_s$ over which it falls from one to the other, positive.
        viscous: Viscous coefficient b, not negative, in units of the result per unit of `v`.
        width: Width w over which the sign turns, positive, in units of `v`, and well below $v_s$.

    Raises:
        InputError: A width or velocity is not positive, or a coefficient is negative.

    Examples:
        >>> import qsmc_jax as qj
        >>> friction = [qj.smoothed.stribeck(v, 1.0, 1.5, 0.1, viscous=0.2, width=1e-4) for v in (0.0, 1e-3, 1.0)]
        >>> [round(float(value), 4) for value in friction]
        [0.0, 1.5001, 1.2]

    Source: Armstrong-Hélouvry, Dupont et al., "A survey of models, analysis tools and compensation methods for
        the control of machines with friction", Automatica 30(7), 1994; the rounded sign is ours.
    """
    for name, value in (("coulomb", coulomb), ("static", static), ("viscous", viscous)):
        require_nonnegative(name, value)
    _require_width("stribeck_velocity", stribeck_velocity)
    peak = jnp.exp(-((jnp.asarray(v) / stribeck_velocity) ** 2))
    return jnp.asarray((coulomb + (static - coulomb) * peak) * sign(v, width) + viscous * v)


def _in_widths(v: RealScalarLike, width: RealScalarLike) -> Float[Array, ""]:
    """`v` in units of the width."""
    _require_width("width", width)
    return jnp.asarray(v) / width


def _require_width(name: str, width: Any) -> None:
    if is_traced(width):
        return
    require_finite(name, width)
    require(
        bool(width > 0),
        f"Argument `{name}` must be positive, but is {show(width)}. Take a small number in units of `v`, such as 1e-4 "
        "of what it reaches; for the function that jumps there is no solver.",
    )

"""What a comparison on equal terms takes from the quasi-sliding-mode law."""

import math

import jax.numpy as jnp

from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.control.law import QuasiSlidingControl


def slope(control: QuasiSlidingControl) -> RealScalarLike:
    r"""How steep the tangent is at $\sigma = 0$ when the funnel has shrunk, $\pi K / 2\rho_\infty$."""
    return 0.5 * math.pi * _gain(control) / control.funnel.narrowest


@entry_point
def error_at_rest(control: QuasiSlidingControl, needed: RealScalarLike) -> RealScalarLike:
    r"""The $|\sigma|$ at which the tangent gives the input `needed`, when the funnel has shrunk."""
    return (2.0 / math.pi) * control.funnel.narrowest * jnp.arctan(needed / _gain(control))


def _gain(control: QuasiSlidingControl) -> RealScalarLike:
    """What the tangent is multiplied by when the funnel has shrunk."""
    return control.gain / control.funnel.narrowest if control.is_scaled else control.gain

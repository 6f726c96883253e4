"""The quasi-sliding-mode control law."""

import math
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.surface import SlidingSurface
from qsmc_jax.numerics.gudermann import tan_half_pi


class QuasiSlidingControl(AbstractControl):
    r"""The law $u = -\operatorname{sgn}(g)\tan\frac{\pi\sigma}{2\rho}$.

    Of the plant it knows the order and the sign of the gain.

    Attributes:
        surface: Sliding surface, $\sigma$ as a function of the errors.
        funnel: AbstractFunnel $\rho(t)$.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        Half-way to the edge the input is 1:

        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(control(sigma=0.5, rho=1.0)), 3), float(control(sigma=1.5, rho=1.0))
        (-1.0, nan)

    Source: paper, eq. (4). The paper's law is given inside the funnel only; the next branches of the tangent, which
    point the wrong way, are never used: outside, u is NaN.
    """

    instead: ClassVar[str] = "A loop under a law of your own needs an `Implementation`: the ideal loop is this law's."

    surface: SlidingSurface
    funnel: AbstractFunnel
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ()

    def __call__(self, sigma: RealScalarLike, rho: RealScalarLike) -> Float[Array, ""]:
        r"""The control at `sigma`, from the funnel's centre, and half-width `rho`; NaN unless $|\sigma| < \rho$."""
        return -self.gain_sign * tan_half_pi(sigma, rho)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        if sample.beyond == "wrap":
            return -self.gain_sign * jnp.tan(0.5 * math.pi * sample.inside() / sample.rho), ()
        return self(sample.inside(), sample.rho), ()

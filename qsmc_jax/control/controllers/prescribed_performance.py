"""Prescribed performance control."""

import math
from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface


class PrescribedPerformance(AbstractControl):
    r"""Prescribed performance control, $u = -\operatorname{sgn}(g) k \ln\frac{1 + z}{1 - z}$ with $z = \sigma / \rho$.

    Outside the funnel it holds 21.4 k, its value just inside: the logarithm grows so slowly that a larger k may be
    needed where the tangent has enough. `beyond="wrap"` evaluates the formula as it stands, which has no value there:
    u is NaN.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel $\rho(t)$.
        gain: k, in units of the input, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(qj.controllers.PrescribedPerformance.with_equal_slope(control).gain), 4)
        0.7854

    Source: Bechlioulis and Rovithakis, IEEE Trans. Automatic Control 53 (2008), for the transformation, and Automatica
    50 (2014), for the law without adaptation; both have it on the errors one by one, here it acts on $\sigma$.
    """

    surface: SlidingSurface
    funnel: AbstractFunnel
    gain: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("gain",)

    @classmethod
    def with_equal_slope(cls, control: QuasiSlidingControl) -> "PrescribedPerformance":
        r"""The law with the slope of `control` at $\sigma = 0$, for every $\rho$: $k = \pi K / 4$.

        Args:
            control: What it is to be compared with.
        """
        return cls(control.surface, control.funnel, 0.25 * math.pi * control.gain, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        # ln((1 + z) / (1 - z)) = 2 artanh z, which keeps its digits at 0
        return -2.0 * self.gain_sign * self.gain * jnp.arctanh(sample.inside() / sample.rho), ()

"""Funnel control."""

import math
from typing import ClassVar

from jaxtyping import Array, Float

from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface


class FunnelControl(AbstractControl):
    r"""Funnel control, $u = -\operatorname{sgn}(g) k \frac{z}{1 - z^2}$ with $z = \sigma / \rho$.

    Outside the funnel it holds its value just inside, 5e8 k. `beyond="wrap"` evaluates the formula as it stands, which
    has the wrong sign there.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel $\rho(t)$.
        gain: k, in units of the input, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(qj.controllers.FunnelControl.with_equal_slope(control).gain), 4)
        1.5708

    Source: Ilchmann, Ryan and Sangwin, ESAIM: COCV 7 (2002), with the gain $1 / (1 - |z|)$ on the error; this smooth
    gain is that of Berger, Le and Reis, Automatica 87 (2018). Here it acts on $\sigma$, in units of $\rho$.
    """

    surface: SlidingSurface
    funnel: AbstractFunnel
    gain: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("gain",)

    @classmethod
    def with_equal_slope(cls, control: QuasiSlidingControl) -> "FunnelControl":
        r"""The law with the slope of `control` at $\sigma = 0$, for every $\rho$: $k = \pi K / 2$.

        Args:
            control: What it is to be compared with.
        """
        return cls(control.surface, control.funnel, 0.5 * math.pi * control.gain, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        # z / (1 - z^2) from the distances to the edges, which floating point knows exactly
        sigma, rho = sample.inside(), sample.rho
        return -self.gain_sign * self.gain * sigma * rho / ((rho - sigma) * (rho + sigma)), ()

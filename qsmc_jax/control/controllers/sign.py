"""Classical sliding mode."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_nonnegative, require_positive
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface


class Sign(AbstractControl):
    r"""Classical sliding mode, $u = -\operatorname{sgn}(g) K \operatorname{sgn}\sigma$ with $\operatorname{sgn} 0 = 0$.

    Sampled with period $\tau$ it leaves $|\sigma| = O(\tau)$.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel that the loop is judged by.
        amplitude: K, in units of the input, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> float(qj.controllers.Sign.for_bound(control, residual_bound=3.0, gain_min=2.0, reaching_rate=1.0).amplitude)
        2.0

    Source: Utkin, Sliding Modes in Control and Optimization (1992).
    """

    surface: SlidingSurface
    funnel: AbstractFunnel
    amplitude: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    is_smooth: ClassVar[bool] = False
    positive: ClassVar[tuple[str, ...]] = ("amplitude",)

    @classmethod
    def for_bound(
        cls,
        control: QuasiSlidingControl,
        residual_bound: RealScalarLike,
        gain_min: RealScalarLike,
        reaching_rate: RealScalarLike,
    ) -> "Sign":
        r"""The least amplitude with $\sigma\dot\sigma \le -\eta|\sigma|$, $K = (W + \eta) / g_{min}$.

        Args:
            control: What it is to be compared with.
            residual_bound: Bound W on $|w|$, in units of the sliding variable per second, not negative.
            gain_min: Least value $g_{min}$ of $|g|$, positive.
            reaching_rate: Rate $\eta$, in units of the sliding variable per second, positive.
        """
        require_nonnegative("residual_bound", residual_bound)
        require_positive("gain_min", gain_min)
        require_positive("reaching_rate", reaching_rate)
        amplitude = (residual_bound + reaching_rate) / gain_min
        return cls(control.surface, control.funnel, amplitude, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        return -self.gain_sign * self.amplitude * jnp.sign(sample.sigma), ()

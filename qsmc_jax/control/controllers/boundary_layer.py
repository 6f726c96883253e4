"""Sliding mode with a boundary layer."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_positive, show
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.controllers.equal_terms import error_at_rest, slope
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface


class BoundaryLayer(AbstractControl):
    r"""Sliding mode with a boundary layer, $u = -\operatorname{sgn}(g) K \operatorname{sat}(\sigma / \phi)$.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel that the loop is judged by.
        amplitude: K, in units of the input, positive.
        width: Half-width $\phi$ of the layer, in units of the sliding variable, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(qj.controllers.BoundaryLayer.with_equal_slope(control, amplitude=1.0).width), 4)
        0.0318

    Source: Slotine and Li, Applied Nonlinear Control (1991), section 7.2.
    """

    surface: SlidingSurface
    funnel: AbstractFunnel
    amplitude: Float[Array, ""] = float_field()
    width: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("amplitude", "width")

    @classmethod
    def with_equal_slope(cls, control: QuasiSlidingControl, amplitude: RealScalarLike) -> "BoundaryLayer":
        r"""The layer with the slope $\pi / 2\rho_\infty$ of `control` at $\sigma = 0$ and $\rho = \rho_\infty$.

        Args:
            control: What it is to be compared with.
            amplitude: K, in units of the input, positive.
        """
        return cls(control.surface, control.funnel, amplitude, amplitude / slope(control), control.gain_sign)

    @classmethod
    def with_equal_accuracy(
        cls,
        control: QuasiSlidingControl,
        amplitude: RealScalarLike,
        residual_bound: RealScalarLike,
        gain_min: RealScalarLike,
    ) -> "BoundaryLayer":
        r"""The layer that leaves at rest, under the worst w and g, the $|\sigma|$ that `control` leaves.

        With $r = W / g_{min}$ these are $\phi r / K$ and $\frac{2}{\pi}\rho_\infty\arctan r$.

        Args:
            control: What it is to be compared with.
            amplitude: K, above r: with less, there is no rest in the layer.
            residual_bound: Bound W on $|w|$, in units of the sliding variable per second, positive.
            gain_min: Least value $g_{min}$ of $|g|$, positive.
        """
        require_positive("residual_bound", residual_bound)
        require_positive("gain_min", gain_min)
        needed = residual_bound / gain_min
        if not is_traced(amplitude, needed):
            require(
                bool(amplitude > needed),
                f"Argument `amplitude` must be above `residual_bound / gain_min` = {show(needed)}, but is "
                f"{show(amplitude)}. With less, w pushes it out of the layer.",
            )
        width = amplitude * error_at_rest(control, needed) / needed
        return cls(control.surface, control.funnel, amplitude, width, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        return -self.gain_sign * self.amplitude * jnp.clip(sample.sigma / self.width, -1.0, 1.0), ()

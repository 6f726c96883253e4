"""A proportional-derivative law."""

from typing import ClassVar

from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_finite
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.controllers.equal_terms import slope
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface


class ProportionalDerivative(AbstractControl):
    r"""The naive reference, $u = \operatorname{sgn}(g) (k_f x_{des}^{(n)} - k \sigma)$.

    For n = 2 this is a PD controller with gains $k c_1$ and k and a feedforward of the desired acceleration; nothing
    compensates gravity or any other part of f.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel that the loop is judged by.
        gain: k, in units of the input per unit of the sliding variable, positive.
        feedforward: $k_f$, in units of the input per unit of $x_{des}^{(n)}$: an estimate of $1 / |g|$; 0 for none.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> round(float(qj.controllers.ProportionalDerivative.with_equal_slope(control).gain), 3)
        31.416
    """

    surface: SlidingSurface
    funnel: AbstractFunnel
    gain: Float[Array, ""] = float_field()
    feedforward: Float[Array, ""] = float_field(default=0.0)
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("gain",)

    def __check_init__(self):
        require_finite("feedforward", self.feedforward)

    @classmethod
    def with_equal_slope(
        cls, control: QuasiSlidingControl, feedforward: RealScalarLike = 0.0
    ) -> "ProportionalDerivative":
        r"""The law with the slope of `control` at $\sigma = 0$ and $\rho = \rho_\infty$, $k = \pi / 2\rho_\infty$.

        Args:
            control: What it is to be compared with.
            feedforward: $k_f$; 0 for none.
        """
        return cls(control.surface, control.funnel, slope(control), feedforward, control.gain_sign)

    def first_memory(self) -> Scalars:
        return ()

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        return self.gain_sign * (self.feedforward * sample.desired[-1] - self.gain * sample.sigma), ()

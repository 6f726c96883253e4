"""The super-twisting law."""

from typing import ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_positive
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.control.surface import SlidingSurface


class SuperTwisting(AbstractControl):
    r"""The super-twisting law $u = -\operatorname{sgn}(g) k_1 |\sigma|^{1/2} \operatorname{sgn}\sigma + v$.

    Its memory is the integral $\dot v = -\operatorname{sgn}(g) k_2 \operatorname{sgn}\sigma$, 0 at first, taken as it
    is implemented: by explicit Euler steps of the nominal period, $v_{k+1} = v_k - \operatorname{sgn}(g) k_2 \tau
    \operatorname{sgn}\sigma_k$. So it leaves $|\sigma| = O(\tau^2)$. Nothing stops the integral when the command
    saturates. At $\sigma = 0$ the slope is infinite; its derivative there is given as 0.

    Attributes:
        surface: Sliding surface.
        funnel: Funnel that the loop is judged by.
        k1: Gain on the root, in units of the input per root of the sliding variable's, positive.
        k2: Gain on the integral, in units of the input per second, positive.
        gain_sign: The sign of the control gain g, 1 or -1.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> law = qj.controllers.SuperTwisting.for_rate(control, residual_rate=4.0, gain_min=1.0)
        >>> float(law.k1), float(law.k2)
        (3.0, 4.4)

    Source: Levant, Sliding order and sliding accuracy in sliding mode control, Int. J. Control 58 (1993).
    """

    surface: SlidingSurface
    funnel: AbstractFunnel
    k1: Float[Array, ""] = float_field()
    k2: Float[Array, ""] = float_field()
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    is_smooth: ClassVar[bool] = False
    positive: ClassVar[tuple[str, ...]] = ("k1", "k2")

    @classmethod
    def for_rate(
        cls, control: QuasiSlidingControl, residual_rate: RealScalarLike, gain_min: RealScalarLike
    ) -> "SuperTwisting":
        r"""The usual gains for $|\dot w| \le L$, $k_1 = 1.5 \sqrt L / g_{min}$ and $k_2 = 1.1 L / g_{min}$.

        With $\xi = w + g v$ and constant g > 0 the loop is $\dot\sigma = -g k_1 |\sigma|^{1/2}
        \operatorname{sgn}\sigma + \xi$, $\dot\xi = \dot w - g k_2 \operatorname{sgn}\sigma$: both gains stand with g.
        It is stable if $g k_2 > L$ and $(g k_1)^2 > g k_2 + L$, which then hold for every constant $g \ge g_{min}$. If
        g varies, $\dot g v$ adds to $\dot w$, and L has to bound the sum.

        Args:
            control: What it is to be compared with.
            residual_rate: Bound L on $|\dot w|$, in units of the sliding variable per second squared, positive.
            gain_min: Least value $g_{min}$ of $|g|$, positive.

        Source: Levant, Robust exact differentiation via sliding mode technique, Automatica 34 (1998), for g = 1; Seeber
        and Horn, Automatica 84 (2017), for the conditions.
        """
        require_positive("residual_rate", residual_rate)
        require_positive("gain_min", gain_min)
        k1, k2 = 1.5 * residual_rate**0.5 / gain_min, 1.1 * residual_rate / gain_min
        return cls(control.surface, control.funnel, k1, k2, control.gain_sign)

    def first_memory(self) -> Scalars:
        return (jnp.zeros(()),)

    def command(self, sample: Sample, memory: Scalars) -> tuple[RealScalarLike, Scalars]:
        (v,), sign = memory, jnp.sign(sample.sigma)
        u = v - self.gain_sign * self.k1 * sign * _root(jnp.abs(sample.sigma))
        return u, (v - self.gain_sign * self.k2 * sample.period * sign,)


def _root(size: Float[Array, ""]) -> Float[Array, ""]:
    """The root of a size, with derivative 0 at 0."""
    is_zero = size == 0.0
    return jnp.where(is_zero, 0.0, jnp.sqrt(jnp.where(is_zero, 1.0, size)))

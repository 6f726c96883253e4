"""A funnel that is down to its final width after a finite time, by a power."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_positive, show
from qsmc_jax.base.module import float_field
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.control.funnels.ending import AbstractEndingFunnel


class FiniteTime(AbstractEndingFunnel):
    r"""$\rho(t) = \rho_0 (1 - t / T)^p + \rho_\infty$ until $T$, then $\rho_\infty$.

    Attributes:
        rho0: Initial excess width $\rho_0$, positive, in units of the sliding variable.
        power: $p \ge 1$ [-]; from 2 on its rate has no jump at T.
        end_time: $T$ [s], positive.
        rho_inf: Final half-width $\rho_\infty$, positive, in units of the sliding variable.

    Examples:
        >>> import qsmc_jax as qj
        >>> funnel = qj.funnels.FiniteTime(rho0=4.0, power=2.0, end_time=1.0, rho_inf=0.05)
        >>> [round(float(funnel(t)), 3) for t in (0.0, 0.5, 1.0, 9.0)], round(float(funnel.reaching_time(0.09)), 3)
        ([4.05, 1.05, 0.05, 0.05], 0.9)
    """

    rho0: Float[Array, ""] = float_field()
    power: Float[Array, ""] = float_field()
    end_time: Float[Array, ""] = float_field()
    rho_inf: Float[Array, ""] = float_field()

    def __check_init__(self):
        require_positive("rho0", self.rho0)
        require_positive("end_time", self.end_time)
        require_positive("rho_inf", self.rho_inf)
        fits = is_traced(self.power) or bool(self.power >= 1.0)
        require(fits, f"Argument `power` must be 1 or more, but is {show(self.power)}.")

    def width_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        left = 1.0 - t / self.end_time
        is_over = left <= 0.0
        left = jnp.where(is_over, 1.0, left)
        steep = jnp.where(is_over, 0.0, self.rho0 * left ** (self.power - 1.0))
        return steep * left + self.rho_inf, -self.power / self.end_time * steep

    @property
    def steepest(self) -> RealScalarLike:
        return self.rho0 * self.rate

    @property
    def rate(self) -> RealScalarLike:
        r"""By $1 - x \le e^{-x}$."""
        return self.power / self.end_time

    @entry_point
    def reaching_time(self, bandwidth: RealScalarLike) -> RealScalarLike:
        r"""The time $T (1 - ((\varepsilon - \rho_\infty) / \rho_0)^{1/p})$ [s]; 0 if it starts inside.

        Args:
            bandwidth: Bandwidth $\varepsilon$ of the quasi-sliding mode, in units of the sliding variable.
        """
        part = jnp.asarray((bandwidth - self.rho_inf) / self.rho0)
        reached = part > 0.0
        time = self.end_time * (1.0 - jnp.where(reached, part, 1.0) ** (1.0 / self.power))
        return jnp.where(reached, jnp.maximum(time, 0.0), jnp.inf)

    def is_valid(self) -> BoolScalarLike:
        return (self.rho0 > 0) & (self.power >= 1) & (self.end_time > 0) & (self.rho_inf > 0)

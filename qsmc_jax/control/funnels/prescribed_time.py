"""A funnel that is down to its final width at a prescribed time, smoothly."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_positive
from qsmc_jax.base.module import float_field
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.control.funnels.ending import AbstractEndingFunnel


class PrescribedTime(AbstractEndingFunnel):
    r"""$\rho(t) = \rho_0 e^{-k t / (T - t)} + \rho_\infty$ until $T$, then $\rho_\infty$: smooth, and flat at $T$.

    Attributes:
        rho0: Initial excess width $\rho_0$, positive, in units of the sliding variable.
        shape: $k$ [-], positive: a large one shrinks early, a small one just before T.
        end_time: $T$ [s], positive.
        rho_inf: Final half-width $\rho_\infty$, positive, in units of the sliding variable.

    Examples:
        >>> import qsmc_jax as qj
        >>> funnel = qj.funnels.PrescribedTime(rho0=4.0, shape=1.0, end_time=2.0, rho_inf=0.05)
        >>> [round(float(funnel(t)), 3) for t in (0.0, 1.0, 2.0, 9.0)], round(float(funnel.reaching_time(0.1)), 3)
        ([4.05, 1.522, 0.05, 0.05], 1.628)
    """

    rho0: Float[Array, ""] = float_field()
    shape: Float[Array, ""] = float_field()
    end_time: Float[Array, ""] = float_field()
    rho_inf: Float[Array, ""] = float_field()

    def __check_init__(self):
        for name in ("rho0", "shape", "end_time", "rho_inf"):
            require_positive(name, getattr(self, name))

    def width_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        left = self.end_time - t
        is_over = left <= 0.0
        left = jnp.where(is_over, self.end_time, left)
        excess = jnp.where(is_over, 0.0, self.rho0 * jnp.exp(-self.shape * t / left))
        return excess + self.rho_inf, -self.shape * self.end_time / left**2 * excess

    @property
    @entry_point
    def steepest(self) -> RealScalarLike:
        r"""With $v = T / (T - t) \ge 1$ the rate is $\rho_0 k v^2 e^{-k (v - 1)} / T$, largest at $v = 2 / k$ or 1."""
        v = jnp.maximum(2.0 / self.shape, 1.0)
        return self.rho0 * self.rate * v**2 * jnp.exp(-self.shape * (v - 1.0))

    @property
    def rate(self) -> RealScalarLike:
        r"""By $t / (T - t) \ge t / T$."""
        return self.shape / self.end_time

    @entry_point
    def reaching_time(self, bandwidth: RealScalarLike) -> RealScalarLike:
        r"""The time $T L / (k + L)$ [s] with $L = \ln(\rho_0 / (\varepsilon - \rho_\infty))$; 0 if it starts inside.

        Args:
            bandwidth: Bandwidth $\varepsilon$ of the quasi-sliding mode, in units of the sliding variable.
        """
        excess = jnp.asarray(bandwidth - self.rho_inf)
        reached = excess > 0.0
        needed = jnp.maximum(jnp.log(self.rho0 / jnp.where(reached, excess, self.rho0)), 0.0)
        return jnp.where(reached, self.end_time * needed / (self.shape + needed), jnp.inf)

    def is_valid(self) -> BoolScalarLike:
        return (self.rho0 > 0) & (self.shape > 0) & (self.end_time > 0) & (self.rho_inf > 0)

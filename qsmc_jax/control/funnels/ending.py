"""What funnels have in common that are down to their final width at a time."""

import equinox as eqx
from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.control.funnel import AbstractFunnel, Funnel


class AbstractEndingFunnel(AbstractFunnel):
    r"""A funnel around 0 that narrows from $\rho_0 + \rho_\infty$ to $\rho_\infty$ until $T$.

    With its `rate` as $\mu$ an exponential $\rho_0 e^{-\mu t} + \rho_\infty$ is nowhere narrower.

    Attributes:
        rho0: Initial excess width $\rho_0$, in units of the sliding variable.
        end_time: $T$ [s].
        rho_inf: Final half-width $\rho_\infty$, in units of the sliding variable.
    """

    rho0: eqx.AbstractVar[Float[Array, ""]]
    end_time: eqx.AbstractVar[Float[Array, ""]]
    rho_inf: eqx.AbstractVar[Float[Array, ""]]

    def centre_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        return 0.0, 0.0

    @property
    def bandwidths(self) -> tuple[RealScalarLike, RealScalarLike]:
        return self.rho_inf, self.rho0 + self.rho_inf

    @property
    def narrowest(self) -> RealScalarLike:
        return self.rho_inf

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return self.end_time[None]

    def enclosing(self, bandwidth: RealScalarLike) -> Funnel:
        return Funnel(self.rho0, self.rate, self.rho_inf)

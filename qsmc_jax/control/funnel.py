"""The funnel: the band around the sliding surface, shrinking in time, that the sliding variable must stay in."""

from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_positive, show
from qsmc_jax.base.module import AbstractModule, float_field
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike


class Funnel(AbstractModule):
    r"""Funnel $\rho(t) = \rho_0 e^{-\mu t} + \rho_\infty$, in units of the sliding variable.

    Attributes:
        rho0: Initial excess width $\rho_0$, positive; the funnel starts at $\rho_0 + \rho_\infty$.
        mu: Decay rate $\mu$ [1/s], positive.
        rho_inf: Final half-width $\rho_\infty$, positive.

    Examples:
        >>> import qsmc_jax as qj
        >>> funnel = qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05)
        >>> round(float(funnel(0.0)), 2), round(float(funnel.reaching_time(0.1)), 2)
        (4.05, 1.46)

    Source: paper, eq. (3).
    """

    instead: ClassVar[str] = "Loops are solved in and judged by this funnel only; choose `rho0`, `mu` and `rho_inf`."

    rho0: Float[Array, ""] = float_field()
    mu: Float[Array, ""] = float_field()
    rho_inf: Float[Array, ""] = float_field()

    def __check_init__(self):
        require_positive("rho0", self.rho0)
        require_positive("mu", self.mu)
        require_positive("rho_inf", self.rho_inf)

    def __call__(self, t: RealScalarLike) -> Float[Array, ""]:
        """The half-width rho at time `t` [s]."""
        return self.width_and_rate(t)[0]

    def width_and_rate(self, t: RealScalarLike) -> tuple[Float[Array, ""], Float[Array, ""]]:
        r"""The half-width $\rho$ and its derivative $\dot\rho = -\mu\rho_0 e^{-\mu t}$ at `t` [s], by one `exp`.

        Args:
            t: Time [s].
        """
        excess = self.rho0 * jnp.exp(-self.mu * t)
        return excess + self.rho_inf, -self.mu * excess

    @entry_point
    def reaching_time(self, bandwidth: RealScalarLike) -> RealScalarLike:
        r"""The time $t_r = \frac{1}{\mu}\ln\frac{\rho_0}{\varepsilon - \rho_\infty}$ [s] that the funnel needs.

        Args:
            bandwidth: Bandwidth $\varepsilon$ of the quasi-sliding mode, in units of the sliding variable.

        Returns:
            The time at which $\rho = \varepsilon$: 0 if the funnel starts inside, `inf` if $\varepsilon \le
            \rho_\infty$.

        Source: paper, Theorem 1. Under condition C2 it is the paper's formula as printed.
        """
        excess = jnp.asarray(bandwidth - self.rho_inf)
        reached = excess > 0
        time = jnp.log(self.rho0 / jnp.where(reached, excess, self.rho0)) / self.mu
        return jnp.where(reached, jnp.maximum(time, 0.0), jnp.inf)

    def admits(self, bandwidth: RealScalarLike) -> BoolScalarLike:
        r"""Whether the numbers are positive and condition C2 holds, strictly: $\rho_\infty < \varepsilon < \rho_0$.

        Args:
            bandwidth: Bandwidth $\varepsilon$ of the quasi-sliding mode, in units of the sliding variable.
        """
        return self.is_valid() & (self.rho_inf < bandwidth) & (bandwidth < self.rho0)

    def is_valid(self) -> BoolScalarLike:
        """Whether the three numbers are positive: what the constructor checks, for traced ones."""
        return (self.rho0 > 0) & (self.mu > 0) & (self.rho_inf > 0)

    def check_bandwidth(self, bandwidth: RealScalarLike) -> None:
        """Raises `InputError` unless condition C2 holds; traced numbers pass.

        Args:
            bandwidth: Bandwidth of the quasi-sliding mode, in units of the sliding variable.

        Raises:
            InputError: If it does not lie strictly between `rho_inf` and `rho0`.
        """
        if not is_traced(bandwidth, self):
            require(
                bool(np.all(self.admits(bandwidth))),
                f"Argument `bandwidth` must lie strictly between `rho_inf` = {show(self.rho_inf)} and `rho0` = "
                f"{show(self.rho0)} (condition C2), but is {show(bandwidth)}. Choose a bandwidth above `rho_inf`, or a "
                f"funnel that ends narrower or starts wider.",
            )

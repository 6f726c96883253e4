"""The funnel: the band around the sliding surface that the sliding variable must stay in."""

import abc
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_positive, show
from qsmc_jax.base.module import AbstractModule, float_field
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike


class AbstractFunnel(AbstractModule):
    r"""A funnel $|\sigma - m(t)| < \rho(t)$ with centre $m$ and half-width $\rho$, in units of the sliding variable.

    The law acts on $(\sigma - m) / \rho$. Around $m = 0$, as in the paper, the centre is the plain number 0.0.

    Examples:
        >>> import qsmc_jax as qj
        >>> funnel = qj.funnels.FiniteTime(rho0=4.0, power=2.0, end_time=1.0, rho_inf=0.05)
        >>> isinstance(funnel, qj.AbstractFunnel), float(funnel(0.5)), funnel.centre(0.5)
        (True, 1.05, 0.0)
    """

    hint: ClassVar[str] = "Make one: `qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05)`, or another of `qj.funnels`."

    @abc.abstractmethod
    def width_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        r"""The half-width $\rho$ and its derivative.

        Args:
            t: Time [s].
        """

    @abc.abstractmethod
    def centre_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        """The centre m and its derivative; plain zeros around m = 0.

        Args:
            t: Time [s].
        """

    @property
    @abc.abstractmethod
    def bandwidths(self) -> tuple[RealScalarLike, RealScalarLike]:
        r"""What a bandwidth must lie between (C2): what $|m| + \rho$ tends to, and what it starts from."""

    @property
    @abc.abstractmethod
    def narrowest(self) -> RealScalarLike:
        """The least half-width of all times."""

    @property
    @abc.abstractmethod
    def steepest(self) -> RealScalarLike:
        r"""The largest rate of an edge, $\sup_t |\dot m \pm \dot\rho|$ [1/s times the unit of the sliding variable]."""

    @property
    @abc.abstractmethod
    def rate(self) -> RealScalarLike:
        """How fast it shrinks [1/s], roughly: a scale for what has none of its own."""

    @property
    @abc.abstractmethod
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] at which a rate jumps or kinks; the solver steps to them."""

    @abc.abstractmethod
    def reaching_time(self, bandwidth: RealScalarLike) -> RealScalarLike:
        """The time $t_r$ [s] from which on the funnel lies inside a bandwidth for good; `inf` if it never does.

        Args:
            bandwidth: Bandwidth of the quasi-sliding mode, in units of the sliding variable.
        """

    @abc.abstractmethod
    def enclosing(self, bandwidth: RealScalarLike) -> "Funnel":
        """An exponential funnel that contains this one, and ends inside the bandwidth if this one does.

        Args:
            bandwidth: Bandwidth of the quasi-sliding mode, in units of the sliding variable.
        """

    @abc.abstractmethod
    def is_valid(self) -> BoolScalarLike:
        """Whether its numbers are in range: what the constructor checks, for traced ones."""

    @entry_point
    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        """The half-width rho at time `t` [s]."""
        return self.width_and_rate(t)[0]

    @entry_point
    def centre(self, t: RealScalarLike) -> RealScalarLike:
        """The centre m.

        Args:
            t: Time [s].
        """
        return self.centre_and_rate(t)[0]

    def load(self, t: RealScalarLike, residual: RealScalarLike) -> RealScalarLike:
        r"""How hard the sliding variable is driven to an edge at most, $|w - \dot m| + |\dot\rho|$.

        Args:
            t: Time [s].
            residual: $w$, its rate without input.
        """
        return jnp.abs(residual - self.centre_and_rate(t)[1]) + jnp.abs(self.width_and_rate(t)[1])

    def admits(self, bandwidth: RealScalarLike) -> BoolScalarLike:
        """Whether the numbers are in range and condition C2 holds, strictly.

        Args:
            bandwidth: Bandwidth of the quasi-sliding mode, in units of the sliding variable.
        """
        end, start = self.bandwidths
        return self.is_valid() & (end < bandwidth) & (bandwidth < start)

    def check_bandwidth(self, bandwidth: RealScalarLike) -> None:
        """Raises `InputError` unless condition C2 holds; traced numbers pass.

        Args:
            bandwidth: Bandwidth of the quasi-sliding mode, in units of the sliding variable.

        Raises:
            InputError: If it does not lie strictly between the two of `bandwidths`.
        """
        if not is_traced(bandwidth, self):
            end, start = map(show, self.bandwidths)
            require(
                bool(np.all(self.admits(bandwidth))),
                f"Argument `bandwidth` must lie strictly between {end}, where the funnel ends, and {start}, where it "
                f"starts (condition C2, rho_inf < epsilon < rho0), but is {show(bandwidth)}. Choose another bandwidth, "
                "or a funnel that ends narrower or starts wider.",
            )


class Funnel(AbstractFunnel):
    r"""The paper's funnel $\rho(t) = \rho_0 e^{-\mu t} + \rho_\infty$, in units of the sliding variable.

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

    instead: ClassVar[str] = "A funnel of another shape is one of `qj.funnels`: `qj.funnels.Smooth(fn)` takes any."

    rho0: Float[Array, ""] = float_field()
    mu: Float[Array, ""] = float_field()
    rho_inf: Float[Array, ""] = float_field()

    def __check_init__(self):
        require_positive("rho0", self.rho0)
        require_positive("mu", self.mu)
        require_positive("rho_inf", self.rho_inf)

    def width_and_rate(self, t: RealScalarLike) -> tuple[Float[Array, ""], Float[Array, ""]]:
        r"""The half-width $\rho$ and its derivative $\dot\rho = -\mu\rho_0 e^{-\mu t}$ at `t` [s], by one `exp`."""
        excess = self.rho0 * jnp.exp(-self.mu * t)
        return excess + self.rho_inf, -self.mu * excess

    def centre_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        return 0.0, 0.0

    @property
    def bandwidths(self) -> tuple[RealScalarLike, RealScalarLike]:
        r"""$\rho_\infty$ and $\rho_0$, as the paper has them."""
        return self.rho_inf, self.rho0

    @property
    def narrowest(self) -> RealScalarLike:
        return self.rho_inf

    @property
    def steepest(self) -> RealScalarLike:
        return self.mu * self.rho0

    @property
    def rate(self) -> RealScalarLike:
        return self.mu

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return jnp.zeros((0,))

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

    def enclosing(self, bandwidth: RealScalarLike) -> "Funnel":
        return self

    def is_valid(self) -> BoolScalarLike:
        return (self.rho0 > 0) & (self.mu > 0) & (self.rho_inf > 0)

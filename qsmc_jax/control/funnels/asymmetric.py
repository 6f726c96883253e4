"""A funnel with two edges of its own."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.control.funnel import AbstractFunnel, Funnel


class Asymmetric(AbstractFunnel):
    r"""$-l(t) < \sigma < h(t)$: the half-widths of two funnels as edges, centre $(h - l) / 2$.

    Attributes:
        upper: The funnel whose half-width is $h$, around 0.
        lower: The funnel whose half-width is $l$, around 0.

    Examples:
        A tenth of the room below, which bounds the overshoot of what starts above:

        >>> import qsmc_jax as qj
        >>> funnel = qj.funnels.Asymmetric(qj.Funnel(4.0, 3.0, 0.05), qj.Funnel(0.4, 3.0, 0.05))
        >>> [round(float(value), 3) for value in (funnel.centre(0.0), funnel(0.0), funnel.reaching_time(0.1))]
        [1.8, 2.25, 1.461]

    Source: Bechlioulis and Rovithakis, IEEE Trans. Automatic Control 53 (2008), for bounds that depend on the sign of
    the error. The law on the centred variable: derived here; Theorem 1 holds with $w - \dot m$ in place of $w$.
    """

    upper: AbstractFunnel
    lower: AbstractFunnel

    def __check_init__(self):
        for name in ("upper", "lower"):
            is_one = not isinstance(getattr(self, name), Asymmetric)
            require(is_one, f"Argument `{name}` must be a funnel around 0, but is an `Asymmetric`.")

    def width_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        edges = zip(self.upper.width_and_rate(t), self.lower.width_and_rate(t), strict=True)
        width, rate = (0.5 * (high + low) for high, low in edges)
        return width, rate

    def centre_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        edges = zip(self.upper.width_and_rate(t), self.lower.width_and_rate(t), strict=True)
        centre, rate = (0.5 * (high - low) for high, low in edges)
        return centre, rate

    @property
    @entry_point
    def bandwidths(self) -> tuple[RealScalarLike, RealScalarLike]:
        (end, start), (other_end, other_start) = self.upper.bandwidths, self.lower.bandwidths
        return jnp.maximum(end, other_end), jnp.maximum(start, other_start)

    @property
    def narrowest(self) -> RealScalarLike:
        return 0.5 * (self.upper.narrowest + self.lower.narrowest)

    @property
    @entry_point
    def steepest(self) -> RealScalarLike:
        return jnp.maximum(self.upper.steepest, self.lower.steepest)

    @property
    @entry_point
    def rate(self) -> RealScalarLike:
        return jnp.maximum(self.upper.rate, self.lower.rate)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return jnp.concatenate([self.upper.break_times, self.lower.break_times])

    @entry_point
    def reaching_time(self, bandwidth: RealScalarLike) -> RealScalarLike:
        """The later one of the two edges' [s].

        Args:
            bandwidth: Bandwidth of the quasi-sliding mode, in units of the sliding variable.
        """
        return jnp.maximum(self.upper.reaching_time(bandwidth), self.lower.reaching_time(bandwidth))

    @entry_point
    def enclosing(self, bandwidth: RealScalarLike) -> Funnel:
        high, low = self.upper.enclosing(bandwidth), self.lower.enclosing(bandwidth)
        rate = jnp.minimum(high.mu, low.mu)
        return Funnel(jnp.maximum(high.rho0, low.rho0), rate, jnp.maximum(high.rho_inf, low.rho_inf))

    def is_valid(self) -> BoolScalarLike:
        return self.upper.is_valid() & self.lower.is_valid()

"""A funnel of the user's own."""

import functools as ft
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_positive, show
from qsmc_jax.base.module import float_field
from qsmc_jax.base.precision import entry_point, in_64_bits
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.control.funnel import AbstractFunnel, Funnel
from qsmc_jax.enclosures.unseen import Nodes, Step, unseen
from qsmc_jax.model.smooth import require_smooth

# Cells of time, over the time scale, in which its width is bounded: the first, and each 7 % longer up to 1e9.
_ENDS = np.concatenate([[0.0], np.geomspace(1e-4, 1e9, 13 * 32 + 1)])
_PARTS, _ROUNDS = 64, 2  # into which the last cell outside a bandwidth is cut, and how often
_NODES = Nodes((0.0, 0.5, 1.0), few=(0.0, 0.5, 1.0))
_WIDER = 1.25  # by which an exponential begins wider, to be wider for a while


class Smooth(AbstractFunnel):
    r"""Any smooth, positive function of time as half-width $\rho(t)$.

    What follows for all times, such as the reaching time, comes from bounds on `fn` in cells of time, each 7 % longer
    than the one before, up to 1e9 times `time_scale`: nothing narrower is missed, and a bound that is too wide errs on
    the safe side (a reaching time is late by 2e-5 of itself where the bounds are sharp). As for `references.Smooth`,
    numbers that are swept, drawn or tuned must be seen: `Smooth(eqx.Partial(fn, number))` with `fn(number, t)`.

    Attributes:
        fn: The half-width at a time [s], written with `jax.numpy`, in units of the sliding variable; defined, finite
            and positive at all times, also beyond the horizon.
        time_scale: In which it shrinks [s], roughly, positive.

    Raises:
        InputError: If `fn` is not smooth, or not positive.

    Examples:
        >>> import qsmc_jax as qj
        >>> funnel = qj.funnels.Smooth(lambda t: 4.0 / (1.0 + 2.0 * t) ** 2 + 0.05)
        >>> round(float(funnel(0.5)), 3), round(float(funnel.reaching_time(0.1)), 3)
        (1.05, 3.972)
    """

    fn: Callable[..., Any]
    time_scale: Float[Array, ""] = float_field(default=1.0)

    def __check_init__(self):
        require_positive("time_scale", self.time_scale)
        with in_64_bits():
            require_smooth(self.fn)
        if not is_traced(self.fn, self.time_scale):
            self._require_positive()

    def width_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        t = jnp.asarray(t, jnp.result_type(float))
        return jax.jvp(self._width, (t,), (jnp.ones_like(t),))

    def centre_and_rate(self, t: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
        return 0.0, 0.0

    @property
    @entry_point
    def bandwidths(self) -> tuple[RealScalarLike, RealScalarLike]:
        return self._bounds[1][-1], self._width(jnp.zeros(()))

    @property
    @entry_point
    def narrowest(self) -> RealScalarLike:
        return jnp.min(self._bounds[0])

    @property
    @entry_point
    def steepest(self) -> RealScalarLike:
        low, high = self._bounded(lambda t: self.width_and_rate(t)[1], self._ends)
        return jnp.max(jnp.maximum(-low, high))

    @property
    def rate(self) -> RealScalarLike:
        return 1.0 / self.time_scale

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return jnp.zeros((0,))

    @entry_point
    def reaching_time(self, bandwidth: RealScalarLike) -> RealScalarLike:
        """From when on its bounds lie inside the bandwidth [s].

        Args:
            bandwidth: Bandwidth of the quasi-sliding mode, in units of the sliding variable.
        """
        ends, (_, high) = self._ends, self._bounds
        last = _last_outside(high, bandwidth)
        time, is_never = jnp.where(last < 0, 0.0, ends[last + 1]), last == len(high) - 1
        for _ in range(_ROUNDS):
            start, end = ends[jnp.maximum(last, 0)], time
            ends = start + (end - start) * np.linspace(0.0, 1.0, _PARTS + 1)
            last = _last_outside(self._bounded(self._width, ends)[1], bandwidth)
            time = ends[last + 1]
        return jax.lax.stop_gradient(jnp.where(is_never, jnp.inf, time))

    @entry_point
    def enclosing(self, bandwidth: RealScalarLike) -> Funnel:
        """The slowest of the exponentials that leave each cell above its bound, towards half-way to the bandwidth."""
        ends, (_, high) = self._ends, self._bounds
        end = high[-1]
        level = jnp.where(end < bandwidth, 0.5 * (end + bandwidth), jnp.max(high))
        excess = jnp.maximum(high - level, 0.0)
        rho0 = _WIDER * jnp.maximum(jnp.max(excess), level)
        is_outside = excess > 0.0
        rates = jnp.log(rho0 / jnp.where(is_outside, excess, rho0)) / ends[1:]
        return Funnel(rho0, jnp.min(jnp.where(is_outside, rates, self.rate)), level)

    def is_valid(self) -> BoolScalarLike:
        return (self.time_scale > 0.0) & jnp.all(self._at_ends > 0.0) & jnp.all(jnp.isfinite(self._at_ends))

    @property
    def _ends(self) -> Float[Array, " ends"]:
        return self.time_scale * jnp.asarray(_ENDS)

    @property
    def _at_ends(self) -> Float[Array, " ends"]:
        return jax.vmap(self._width)(self._ends)

    @property
    def _bounds(self) -> tuple[Float[Array, " cells"], Float[Array, " cells"]]:
        return self._bounded(self._width, self._ends)

    def _width(self, t: RealScalarLike) -> Float[Array, ""]:
        return jnp.asarray(self.fn(t), jnp.result_type(float))

    def _bounded(self, fn: Callable[..., Any], ends: Any) -> tuple[Float[Array, " cells"], Float[Array, " cells"]]:
        """The least and largest values in each cell; infinite where they are not known."""
        ends = jnp.asarray(ends)
        found = jax.vmap(lambda t0, t1: _range(ft.partial(unseen, fn), t0, t1))(ends[:-1], ends[1:])
        return jax.lax.stop_gradient(found)

    @entry_point
    def _require_positive(self) -> None:
        values = np.asarray(self._at_ends)
        bad = np.flatnonzero(~(np.isfinite(values) & (values > 0.0)))
        at = bad[0] if len(bad) else 0
        require(
            len(bad) == 0,
            f"Argument `fn` of `funnels.Smooth` must be positive at all times, but is {show(values[at])} at t = "
            f"{show(_ENDS[at] * self.time_scale)} s. What ends at a time is a `FiniteTime` or a `PrescribedTime`.",
        )


def _range(look: Callable[..., Any], t0: Array, t1: Array) -> tuple[Array, Array]:
    found = look(Step(t0, t1, _NODES))
    return jnp.nan_to_num(found.low, nan=-jnp.inf), jnp.nan_to_num(found.high, nan=jnp.inf, posinf=jnp.inf)


def _last_outside(high: Float[Array, " cells"], bandwidth: RealScalarLike) -> Array:
    """The last cell that is not inside the bandwidth; -1 if all are."""
    return jnp.max(jnp.where(high < bandwidth, -1, jnp.arange(high.shape[0])))

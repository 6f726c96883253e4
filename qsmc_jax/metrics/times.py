"""Metrics that are times: when something is so for the first time, or for the last."""

import abc
import dataclasses
import functools as ft
from typing import Any, ClassVar, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.metric import AbstractOfSignals
from qsmc_jax.metrics.record import Worse
from qsmc_jax.metrics.signals import AbstractStep
from qsmc_jax.metrics.view import NODES, View
from qsmc_jax.numerics import pytrees

# A step is halved so often: to 1e-12 of its length.
_BISECTIONS = 40


class _Change(NamedTuple):
    """A step in which it changes, between where in it, and how things stand.

    Attributes:
        data: The step's data.
        on: A place in it where it is so.
        off: The next place in it where it is not so; that of `on` if it is so from the beginning, or to the end.
        is_found: Whether there is such a step.
        is_on: Whether it is so at the end of the last step.
        is_known: Whether the function was a number wherever it was looked at.
    """

    data: Any
    on: RealScalarLike
    off: RealScalarLike
    is_found: Bool[Array, ""]
    is_on: Bool[Array, ""]
    is_known: Bool[Array, ""]


@dataclasses.dataclass(frozen=True)
class AbstractTime(AbstractOfSignals):
    """When a condition changes: it holds where the function is true, or positive.

    To 1e-9 of a step. A function that returns true or false is looked at at five instants of a step. Of one that
    returns a number, positive where it is so, the peak in each step counts too, and the time has a derivative.
    """

    may_jump: ClassVar[bool] = True

    def first(self, step: AbstractStep) -> _Change:
        no, zero = jnp.array(False), jnp.zeros(())
        return _Change(jax.tree.map(jnp.asarray, step.data), zero, zero, no, no, ~no)

    def read(self, state: _Change, step: AbstractStep) -> RealScalarLike:
        found = dataclasses.replace(step, data=state.data)
        ends = jax.lax.stop_gradient((state.on, state.off))
        on, _ = jax.lax.fori_loop(0, _BISECTIONS, ft.partial(self._halve, found), ends)
        on = jax.lax.stop_gradient(on)
        value, slope = jax.jvp(ft.partial(self.value_in, found), (on,), (jnp.ones(()),))
        is_crossing = (state.on != state.off) & (slope != 0.0)
        # Zero, with the derivative of the place: the bisection has none.
        shift = (value - jax.lax.stop_gradient(value)) / jax.lax.stop_gradient(jnp.where(is_crossing, slope, 1.0))
        time = found.t0 + (on - jnp.where(is_crossing, shift, 0.0)) * (found.t1 - found.t0)
        return jnp.where(state.is_known, self.told(state, time), jnp.nan)

    def _halve(self, step: AbstractStep, _: Any, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = 0.5 * (ends[0] + ends[1])
        is_on = self.value_in(step, middle) > 0.0
        return jnp.where(is_on, middle, ends[0]), jnp.where(is_on, ends[1], middle)

    def places(self, view: View) -> tuple[Float[Array, " nodes"], Bool[Array, " nodes"], Bool[Array, ""]]:
        """Places in a step, in order, whether it is so there, and whether the function is a number at all of them.

        What compares with no number is neither so nor not so.
        """
        places, values = jnp.array(NODES), self.values(view)
        is_on = values > 0.0
        # Where it is so at a node, what is between nodes is of no use.
        peak, height, _ = self.summit(view, jnp.where(is_on.any(), jnp.inf, 0.0))
        # Where it is so between nodes only, the peak stands in for the inner node next to it.
        inner = 1 + jnp.argmin(jnp.abs(places[1:-1] - peak))
        is_hidden = (height > 0.0) & ~is_on.any() & (jnp.arange(len(NODES)) == inner)
        return jnp.where(is_hidden, peak, places), is_on | is_hidden, ~jnp.isnan(values).any()

    @abc.abstractmethod
    def told(self, state: _Change, time: RealScalarLike) -> RealScalarLike:
        """The metric, given the time of the change if there is one."""


@dataclasses.dataclass(frozen=True)
class LastTime(AbstractTime):
    """When a condition holds for the last time in its window [s]: `after` if never, inf if still at its end.

    Examples:
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> qj.metrics.LastTime("settling", lambda s: jnp.abs(s.e[0]) - 0.02).record.unit
        's'
    """

    unit: str = dataclasses.field(default="s", kw_only=True)
    worse: ClassVar[Worse | None] = "high"

    def add(self, state: _Change, view: View) -> _Change:
        places, is_on, is_known = self.places(view)
        is_known = state.is_known & is_known
        new = _Change(view.step.data, *_last(places, is_on), jnp.array(True), is_on[-1], is_known)
        return pytrees.where(is_on.any(), new, state._replace(is_on=jnp.array(False), is_known=is_known))

    def told(self, state: _Change, time: RealScalarLike) -> RealScalarLike:
        return jnp.where(state.is_on, jnp.inf, jnp.where(state.is_found, time, self.after))


@dataclasses.dataclass(frozen=True)
class FirstTime(AbstractTime):
    """When a condition holds for the first time in its window [s]: inf if never.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.metrics.FirstTime("rise", lambda s: s.x[0] - 0.9).record.unit
        's'
    """

    unit: str = dataclasses.field(default="s", kw_only=True)

    def add(self, state: _Change, view: View) -> _Change:
        places, is_on, is_known = self.places(view)
        is_known = state.is_known & (state.is_found | is_known)
        new = _Change(view.step.data, *_last(places[::-1], is_on[::-1]), jnp.array(True), is_on[-1], is_known)
        return pytrees.where(is_on.any() & ~state.is_found, new, state._replace(is_known=is_known))

    def told(self, state: _Change, time: RealScalarLike) -> RealScalarLike:
        return jnp.where(state.is_found, time, jnp.inf)


def _last(places: Float[Array, " nodes"], is_on: Bool[Array, " nodes"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The last place at which it is so, and the one after it; itself if there is none."""
    last = len(NODES) - 1 - jnp.argmax(is_on[::-1])
    return places[last], places[jnp.minimum(last + 1, len(NODES) - 1)]

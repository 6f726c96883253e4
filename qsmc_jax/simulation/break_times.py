"""Break times of a loop, passed one after another at a cost that does not grow with their number."""

import functools as ft
from collections.abc import Callable, Iterable
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.numerics.barrier import Barrier
from qsmc_jax.numerics.places import place

# For each table the place of the first entry that is still ahead.
Cursor: TypeAlias = tuple[Int[Array, ""], ...]
# Breaks that a program may hold one by one.
_FEW = 64


class BreakTimes(AbstractModule):
    """Break times: few one by one, which a batch goes through in vectors, and tables in order, with a place in each.

    A long list stays a table of its own, so that runs which share it do not each have a copy. In a table times that are
    the same up to rounding are one entry, so that its place moves by one at most from step to step.

    Attributes:
        few: Break times [s], in any order; unused places hold `inf`.
        firsts: Tables of more: of each group of times that are the same, the first; then `inf`.
        lasts: The last of each group.
    """

    few: Scalars
    firsts: tuple[Array, ...]
    lasts: tuple[Array, ...]

    @property
    def is_empty(self) -> bool:
        """Whether there are none."""
        return not self.few and not self.firsts

    def start(self, t: RealScalarLike) -> Cursor:
        """The cursor of what begins at `t` [s]."""
        return tuple(place(table, t) for table in self.firsts)

    def moved(self, cursor: Cursor, t: RealScalarLike) -> Cursor:
        """The cursor after a step to `t` [s], which has passed one entry of each table at most."""
        return tuple(jnp.where(first <= t, i + 1, i) for i, first in zip(cursor, self._ahead(cursor), strict=True))

    def after(self, cursor: Cursor, t: RealScalarLike) -> RealScalarLike:
        """The first break after `t`, to which the cursor was moved; inf if there is none."""
        return self._folded(jnp.minimum, lambda b: jnp.where(b > t, b, jnp.inf), self._ahead(cursor))

    def before_next(self, cursor: Cursor, t: RealScalarLike) -> RealScalarLike:
        """Just before the first break after `t`; at `t` just before one, that break itself."""
        ahead = self.after(cursor, t)
        fixed = jax.lax.stop_gradient(ahead)
        before = ahead + jnp.where(jnp.isfinite(fixed), jnp.nextafter(fixed, -jnp.inf) - fixed, 0.0)
        return jnp.where(before > t, before, ahead)

    def has(self, cursor: Cursor, t: RealScalarLike) -> Bool[Array, ""]:
        """Whether a break is at `t` exactly, the next one ahead."""
        return self._folded(jnp.logical_or, lambda b: b == t, [b == t for b in self._ahead(cursor)])

    def until(self, cursor: Cursor, t: RealScalarLike) -> RealScalarLike:
        """The last break that is at most `t` or the same as one that is; of a table, if it was still ahead."""
        ahead = zip(self._ahead(cursor), map(_at, self.lasts, cursor), strict=True)
        tables = [jnp.where(first <= t, last, -jnp.inf) for first, last in ahead]
        return self._folded(jnp.maximum, lambda b: jnp.where(b <= t, b, -jnp.inf), tables)

    def _ahead(self, cursor: Cursor) -> list[RealScalarLike]:
        return list(map(_at, self.firsts, cursor))

    def _folded(self, two: Any, of_few: Callable[[Any], Any], tables: list[Any]) -> Any:
        return ft.reduce(two, [*map(of_few, self.few), *tables])


def break_times(parts: Iterable[Array], barrier: Barrier, same: float = 0.0) -> BreakTimes:
    """Break times of several parts.

    Args:
        parts: Those of each, in any order; unused places hold `inf`.
        barrier: Around long ones: XLA takes seconds to sort numbers that it knows.
        same: Times closer than this, relative to themselves, are the same.
    """
    parts = [part for part in parts if len(part)]
    long = [part for part in parts if len(part) > _FEW]
    short = [part for part in parts if len(part) <= _FEW]
    if sum(map(len, short)) > _FEW:
        long, short = [*long, jnp.concatenate(short)], []
    tables = [_grouped(barrier(part), same) for part in long]
    few = tuple(time for part in short for time in part)
    return BreakTimes(few, tuple(first for first, _ in tables), tuple(last for _, last in tables))


def _grouped(times: Float[Array, " breaks"], same: float) -> tuple[Array, Array]:
    """First and last of each group of times that are the same, in order, and `inf` once more at the end."""
    times = jnp.sort(times)
    begins, edge = times[1:] > times[:-1] + same * jnp.abs(times[:-1]), jnp.ones(1, bool)
    groups = jnp.concatenate([edge, begins]), jnp.concatenate([begins, edge])
    first, last = (jnp.append(jnp.sort(jnp.where(group, times, jnp.inf)), jnp.inf) for group in groups)
    return first, last


def _at(table: Float[Array, " breaks"], i: Int[Array, ""]) -> RealScalarLike:
    return table[jnp.minimum(i, table.shape[0] - 1)]

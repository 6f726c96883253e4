"""Enclosures of several numbers that a program computes together, each with what is known of it alone."""

import functools as ft
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from typing import Any

import jax
import jax.numpy as jnp

from qsmc_jax.enclosures.enclosure import CannotEncloseError, Enclosure, Walk
from qsmc_jax.enclosures.intervals import Enclosed, Interval, is_point
from qsmc_jax.enclosures.rounding import Rounding
from qsmc_jax.tracing.programs import (
    Equation,
    Program,
    UnknownProgramError,
    dtype_of,
    evaluated,
    is_literal,
    parts,
)

# A result that so many operations use is worked out once.
_OFTEN = 2


def enclose_each(
    fn: Callable[..., Sequence[Any]],
    *box: Enclosed,
    rounding: Rounding = Rounding.NEAREST,
    once: Callable[[Any], Any] | None = None,
) -> tuple[Enclosure, ...]:
    """Encloses several numbers of scalars over a box: one walk, but what is known of each is its own.

    Args:
        fn: A function that JAX can trace; its results are so many numbers.
        *box: Its arguments, each a point or an `Interval`.
        rounding: How the ends are rounded.
        once: Around intervals that are used more than once, such as a `Barrier`; None for programs so short that
            XLA may work them out anew for each use.
    """
    points = [jnp.asarray(side) if is_point(side) else side.lo for side in box]
    program = jax.make_jaxpr(lambda *given: tuple(fn(*given)))(*points)
    try:
        walk = _SharedWalk(program, rounding, once)
        values = evaluated(program, box, walk.results)
        return tuple(
            Enclosure((value,), *walk.known_of(name))
            for value, name in zip(values, parts(program).outputs, strict=True)
        )
    except UnknownProgramError as error:
        raise CannotEncloseError("a program of this version of JAX") from error


class _SharedWalk:
    """One pass through a program, on which nothing is done in vain or twice.

    Of each variable is kept which operations it depends on that may jump, or have no rule.
    """

    def __init__(self, program: Program, rounding: Rounding, once: Callable[[Any], Any] | None):
        self._walk, self._once, self._plan = Walk(rounding), once, _Plan(program)
        self._jumps: dict[Any, dict[int, Any]] = {}
        self._unknown: dict[Any, frozenset[str]] = {}
        self._values: dict[Any, Enclosed] = {}

    def results(self, eqn: Equation, operands: list[Enclosed]) -> Sequence[Enclosed]:
        """The results of an operation; of one that nothing needs none."""
        if not self._plan.is_needed(eqn):
            return [None] * len(eqn.outputs)
        same = [self._plan.first.get(name, name) for name in eqn.outputs]
        if not all(name in self._values for name in same):
            self._values |= zip(same, map(self._kept, same, self._new(eqn, operands)), strict=True)
        for name, other in zip(eqn.outputs, same, strict=True):
            self._jumps[name], self._unknown[name] = self._jumps[other], self._unknown[other]
        return [self._values[name] for name in same]

    def known_of(self, name: Any) -> tuple[Any, tuple[str, ...]]:
        """Whether a variable may jump, and what it uses that has no rule."""
        if is_literal(name):
            return jnp.zeros((), bool), ()
        jumps = ft.reduce(jnp.logical_or, self._jumps.get(name, {}).values(), jnp.zeros((), bool))
        return jumps, tuple(sorted(self._unknown.get(name, ())))

    def _new(self, eqn: Equation, operands: list[Enclosed]) -> Sequence[Enclosed]:
        walk = self._walk
        walk.jumps, walk.unknown = nothing, _ = jnp.zeros((), bool), set()
        results = walk.results(eqn, operands)
        names = [name for name in eqn.inputs if not is_literal(name)]
        jumps = {key: jump for name in names for key, jump in self._jumps.get(name, {}).items()}
        jumps |= {} if walk.jumps is nothing else {id(walk.jumps): walk.jumps}
        unknown = frozenset(walk.unknown).union(*(self._unknown.get(name, ()) for name in names))
        for name in eqn.outputs:
            self._jumps[name], self._unknown[name] = jumps, unknown
        return results

    def _kept(self, name: Any, value: Enclosed) -> Enclosed:
        if self._once is None or self._plan.uses[name] < _OFTEN or not isinstance(value, Interval):
            return value
        return Interval(*self._once(tuple(value))) if jnp.issubdtype(value.lo.dtype, jnp.floating) else value


class _Plan:
    """Which operations of a program are needed, and which are the same as one before.

    Attributes:
        first: For a variable the one that the same operation on the same inputs sets first.
        uses: How many operations use a variable, each counted once.
    """

    def __init__(self, program: Program):
        made_of = parts(program)
        self.first: dict[Any, Any] = {}
        self.uses: Counter[Any] = Counter(name for name in made_of.outputs if not is_literal(name))
        self._needed = set(self.uses)
        for eqn in reversed(made_of.equations):
            if self.is_needed(eqn):
                self._needed.update(name for name in eqn.inputs if not is_literal(name))
        done: dict[Hashable, tuple[Any, ...]] = {}
        for eqn in filter(self.is_needed, made_of.equations):
            key = self._key(eqn)
            if key is not None and key in done:
                self.first |= zip(eqn.outputs, done[key], strict=True)
                continue
            self.uses.update(self.first.get(name, name) for name in eqn.inputs if not is_literal(name))
            if key is not None:
                done[key] = eqn.outputs

    def is_needed(self, eqn: Equation) -> bool:
        """Whether a result of the program depends on an operation.

        Args:
            eqn: The operation.
        """
        return not self._needed.isdisjoint(eqn.outputs)

    def _key(self, eqn: Equation) -> Hashable:
        """What two operations share that have the same results; None if that can't be told."""
        inputs = tuple(
            (repr(name.val), dtype_of(name)) if is_literal(name) else self.first.get(name, name) for name in eqn.inputs
        )
        key = eqn.name, inputs, tuple(sorted(eqn.params.items()))
        try:
            hash(key)
        except TypeError:
            return None
        return key

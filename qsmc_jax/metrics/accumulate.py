"""What is kept of a run for the measures of its study, all together."""

from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.metrics.metric import AbstractKept, AbstractMeasure, Extent
from qsmc_jax.metrics.signals import AbstractStep
from qsmc_jax.metrics.view import View

# What is kept for each measure, by its name: once for each of its parts.
States = dict[str, tuple[Any, ...]]


def first_states(measures: Sequence[AbstractMeasure], step: AbstractStep) -> States:
    """What is kept before the first step, given one of no length at the start."""
    return {each.name: tuple(jax.tree.map(_as_float, part.first(step)) for part in each.parts) for each in measures}


def add_step(measures: Sequence[AbstractMeasure], states: States, step: AbstractStep) -> States:
    """What is kept after one more step; no window begins or ends inside it."""
    view = View(step)

    def added(part: AbstractKept, state: Any) -> Any:
        return jax.tree.map(_as_float, part.add_if_inside(_typed(part, state, step), view))

    return {each.name: tuple(map(added, each.parts, states[each.name])) for each in measures}


def read_states(
    measures: Sequence[AbstractMeasure], states: States, step: AbstractStep, extent: Extent
) -> dict[str, Array]:
    """The columns of the measures, by their names."""
    columns: dict[str, Array] = {}
    for each in measures:
        kept = (_typed(part, state, step) for part, state in zip(each.parts, states[each.name], strict=True))
        columns.update(each.report(tuple(kept), step, extent))
    return columns


def _as_float(leaf: Any) -> Float[Array, "..."]:
    """What a solver can carry: it knows floating-point numbers only."""
    return jnp.asarray(leaf).astype(float)


def _typed(part: AbstractKept, state: Any, step: AbstractStep) -> Any:
    """The state with the types that it had at first."""
    at_first = jax.eval_shape(lambda: part.first(step))
    return jax.tree.map(lambda leaf, first: leaf.astype(first.dtype), state, at_first)

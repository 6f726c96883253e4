"""The metrics of a study, kept up together over a run."""

import math
from collections.abc import Sequence
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from qsmc_jax.base import trees
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.metric import AbstractMetric, View
from qsmc_jax.metrics.signals import AbstractStep

# What is kept of each metric, by its name.
States = dict[str, Any]


def first_states(metrics: Sequence[AbstractMetric], step: AbstractStep) -> States:
    """What is kept before the first step, given one of no length at the start."""
    return {metric.name: jax.tree.map(_as_float, metric.first(step)) for metric in metrics}


def add_step(metrics: Sequence[AbstractMetric], states: States, step: AbstractStep) -> States:
    """What is kept after one more step; no window begins or ends inside it."""
    if not metrics:
        return states
    view = View.of(step)
    middle, has_length = 0.5 * (step.t0 + step.t1), jnp.asarray(step.t1 > step.t0)

    def added(metric: AbstractMetric, state: Any) -> Any:
        is_inside = has_length & (middle > metric.after) & (middle < metric.before)
        new = jax.tree.map(_as_float, metric.add(_typed(metric, state, step), view))
        return trees.where(is_inside, new, state)

    return {metric.name: added(metric, states[metric.name]) for metric in metrics}


def read_states(
    metrics: Sequence[AbstractMetric], states: States, step: AbstractStep, horizon: RealScalarLike, is_complete: Any
) -> dict[str, Float[Array, ""]]:
    """The metrics by their names: NaN of a run that was not completed, or ended before the window did."""

    def known(metric: AbstractMetric) -> Bool[Array, ""]:
        # A window without an end is up to the horizon.
        is_whole = horizon > metric.after if math.isinf(metric.before) else horizon >= metric.before
        return is_complete & is_whole

    return {
        metric.name: jnp.where(known(metric), metric.read(_typed(metric, states[metric.name], step), step), jnp.nan)
        for metric in metrics
    }


def _as_float(leaf: Any) -> Float[Array, "..."]:
    """What a solver can carry: it knows floating-point numbers only."""
    return jnp.asarray(leaf).astype(float)


def _typed(metric: AbstractMetric, state: Any, step: AbstractStep) -> Any:
    """The state with the types that it had at first."""
    return jax.tree.map(
        lambda leaf, at_first: leaf.astype(at_first.dtype), state, jax.eval_shape(lambda: metric.first(step))
    )

"""From the end of a sampled run to what a user reads: outcome, verdict per claim, and its metrics."""

import dataclasses
import functools as ft

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.metrics.accumulate import read_states
from qsmc_jax.metrics.metric import Extent
from qsmc_jax.metrics.standard import Metrics, SampledMetrics
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.joined import joined
from qsmc_jax.simulation.judge import first_to_apply, later_verdicts
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.problem import AbstractProblem, Problem
from qsmc_jax.simulation.sampled.cell import CellStep, no_cell
from qsmc_jax.simulation.sampled.state import ChannelState, LoopState
from qsmc_jax.simulation.spans import Span, is_since, last_outside

# By what part of their size signals may be wrong, over the square root of the relative tolerance.
_RESOLUTION = 0.2


def read_sampled_metrics(
    problem: AbstractProblem, refused: Int[Array, ""], horizon: RealScalarLike, max_steps: int, state: LoopState
) -> Metrics:
    """Outcome first, then the verdicts, then the metrics: those of an unfinished run are masked.

    A run that left the funnel is followed further, unless it is lost: its metrics are those of the whole run.
    """
    lost = [each.is_lost for each in state.channels]
    outcome = _outcome(refused, horizon, max_steps, state, ft.reduce(jnp.logical_or, lost))
    starts_outside = ft.reduce(jnp.logical_or, [each.starts_outside for each in state.channels])
    is_admitted = (outcome != Outcome.BAD_PARAMETERS) & ~starts_outside
    extent = Extent(state.t, horizon, outcome == Outcome.COMPLETED, is_admitted, _RESOLUTION * jnp.sqrt(problem.rtol))
    own = read_states(problem.measures, state.own, CellStep(no_cell(state.points), problem), extent)
    parts = zip(problem.channels, state.channels, lost, strict=True)
    channels = [_of_channel(*each, outcome, is_admitted, horizon, state.steps) for each in parts]
    return dataclasses.replace(channels[0], own=own) if len(channels) == 1 else joined(channels, None, own)


def _of_channel(
    problem: Problem,
    state: ChannelState,
    is_lost: BoolScalarLike,
    outcome: Int[Array, ""],
    is_admitted: BoolScalarLike,
    horizon: RealScalarLike,
    steps: RealScalarLike,
) -> Metrics:
    """The metrics of a channel, which may be the only one."""
    cells, end_time = state.cells, state.now.t
    is_complete, is_lost = outcome == Outcome.COMPLETED, (outcome == Outcome.LOST) & is_lost
    reach_time = last_outside(cells.outside, problem.bandwidth, end_time)
    recovery_time = last_outside(cells.last_exit, 1.0, end_time)
    settle_time = jnp.where(cells.unsettled.end >= end_time, jnp.inf, cells.unsettled.end)
    verdict, reaching, tracking = _verdicts(problem, is_complete, is_admitted, horizon, state)
    steady = end_time - problem.reaching_time
    is_steady = is_complete & (steady > 0.0)

    def known(value: RealScalarLike, where_lost: RealScalarLike = jnp.nan) -> Float[Array, ""]:
        return jnp.where(is_complete, value, jnp.where(is_lost, where_lost, jnp.nan))

    def known_steady(value: RealScalarLike) -> Float[Array, ""]:
        return jnp.where(is_steady, value, jnp.nan)

    return Metrics(
        verdict=verdict,
        verdict_reaching=reaching,
        verdict_tracking=tracking,
        outcome=outcome,
        end_time=end_time,
        # Where exactly it was when it was given up depends on the cells: it got as far as that, or farther.
        peak_ratio=known(cells.peak_ratio, state.farthest),
        margin=known(1.0 - cells.peak_ratio, 1.0 - state.farthest),
        peak_time=known(cells.peak_time),
        peak_u=known(jnp.maximum(jnp.abs(cells.max_u), jnp.abs(cells.min_u)), jnp.inf),
        max_u=known(cells.max_u, jnp.inf),
        min_u=known(cells.min_u, -jnp.inf),
        peak_u_bound=jnp.full((), jnp.nan),
        reach_time=known(reach_time, jnp.inf),
        violation_time=_violation_time(state),
        settle_time=known(settle_time, jnp.inf),
        peak_errors=tuple(known_steady(peak) for peak in cells.peak_errors),
        rms_error=known(jnp.sqrt(cells.squared_error / jnp.where(is_complete, end_time, 1.0))),
        energy_u=known(cells.energy),
        total_variation_u=known(cells.total_variation),
        least_gain=cells.least_gain,
        largest_disturbance=cells.largest_disturbance,
        steps=jnp.asarray(steps).astype(int),
        sampled=SampledMetrics(
            recovery_time=known(recovery_time, jnp.inf),
            peak_excess=known(cells.peak_excess, jnp.inf),
            excess_variation_u=known_steady(cells.steady_variation - cells.equivalent_variation),
            reversal_rate=known_steady(state.commands.reversals.count / jnp.where(is_steady, steady, 1.0)),
            high_frequency_ratio=known_steady(_ratio(cells.filter.high_power, cells.filter.power)),
            peak_rate_u=known_steady(state.commands.peak_rate),
        ),
    )


def _outcome(
    refused: Int[Array, ""], horizon: RealScalarLike, max_steps: int, state: LoopState, is_lost: BoolScalarLike
) -> Int[Array, ""]:
    """The code of how the run ended."""
    has_overflown = ft.reduce(jnp.logical_or, [each.computer.has_overflown for each in state.channels])
    cases = (
        (state.t >= horizon, Outcome.COMPLETED),
        (has_overflown, Outcome.QUEUE_FULL),
        (is_lost, Outcome.LOST),
        (state.steps >= max_steps, Outcome.MAX_STEPS),
    )
    return first_to_apply(refused, cases, Outcome.STEP_TOO_SMALL)


def _verdicts(
    problem: Problem,
    is_complete: BoolScalarLike,
    is_admitted: BoolScalarLike,
    horizon: RealScalarLike,
    state: ChannelState,
) -> tuple[Int[Array, ""], Int[Array, ""], Int[Array, ""]]:
    """The verdicts on the three claims of Theorem 1, each on its own: a run may leave the funnel and come back.

    So a run that was lost, or could not be finished, decides a claim only if it broke it while it was followed.
    """
    held, violated, undecided, inadmissible = (int(verdict) for verdict in Verdict)
    cells = state.cells
    funnel = jnp.where(is_complete, held, undecided)
    funnel = jnp.where(cells.first_exit.length > 0.0, violated, funnel)
    last_far = Span(cells.outside.start, cells.outside.start + cells.outside.length)
    is_broken = is_since(last_far, problem.reaching_time), is_since(cells.unsettled, problem.settling_time)
    later = later_verdicts(problem, horizon, is_broken, (is_complete, is_complete))
    funnel, reaching, tracking = (jnp.where(is_admitted, verdict, inadmissible) for verdict in (funnel, *later))
    return funnel, reaching, tracking


def _violation_time(state: ChannelState) -> Float[Array, ""]:
    """When the run first left the funnel: inf if it did not."""
    exit_ = state.cells.first_exit
    crossed = exit_.start + exit_.cubic.first_ascent(1.0) * exit_.length
    time = jnp.where(exit_.length > 0.0, crossed, jnp.inf)
    return jnp.where(state.starts_outside, 0.0, time)


def _ratio(part: RealScalarLike, whole: RealScalarLike) -> Float[Array, ""]:
    has_power = jnp.asarray(whole > 0.0)
    return jnp.where(has_power, part / jnp.where(has_power, whole, 1.0), 0.0)

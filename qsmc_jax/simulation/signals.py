"""A solve read off along a time grid: states, errors, sliding variable, funnel, input, disturbance."""

import functools as ft
from collections.abc import Hashable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require, require_finite, show
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.metrics.signals import Signals
from qsmc_jax.metrics.standard import Metrics
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.simulation.engine import pose, solve
from qsmc_jax.simulation.ideal.step import ideal_signals, joint_ideal_signals
from qsmc_jax.simulation.judge import is_refused
from qsmc_jax.simulation.problem import AbstractProblem
from qsmc_jax.simulation.sampled.cell import loop_points, sampled_signals
from qsmc_jax.simulation.settings import INSTANT, SolverSettings

_DEFAULT_TIMES = 2001


class GridSignals(NamedTuple):
    """All signals of one run, by the names they have in a `Trajectory`; NaN after its end."""

    x: Float[Array, "times states"]
    desired: Float[Array, "times n"]
    e: Float[Array, "times n"]
    sigma: Float[Array, "times ..."]
    rho: Float[Array, "times ..."]
    u: Float[Array, "times ..."]
    d: Float[Array, "times ..."]


class SolvedRun(NamedTuple):
    """One run in full: its metrics, its signals, and the thresholds that they were judged by."""

    metrics: Metrics
    signals: GridSignals
    error_bounds: Float[Array, " n"]
    settling_time: Float[Array, ""]


def solve_along(
    loop: ClosedLoop | MultivariableLoop,
    x0: Float[Array | np.ndarray, " n"],
    t1: RealScalarLike,
    bandwidth: Any,
    ts: Float[Array | np.ndarray, " times"],
    settings: SolverSettings,
    is_drawn_well: BoolScalarLike = True,
    made_of: Hashable = (),
    own: tuple[AbstractMeasure, ...] = (),
) -> SolvedRun:
    """Solves one run and reads its signals at the times; pure, to be compiled.

    Args:
        loop: The closed loop.
        x0: The start, n numbers.
        t1: The horizon [s], positive.
        bandwidth: Bandwidth of quasi-sliding mode, in units of the sliding variable.
        ts: Times [s], increasing, from 0 on; those beyond the horizon count as after the end.
        settings: Method and tolerances.
        is_drawn_well: Whether what was drawn for the run had arguments in range.
        made_of: As for `pose`.
        own: Metrics and requirements of the study.
    """
    start, ts = loop.start(x0), jnp.asarray(ts)
    problem = pose(loop.whole, start, bandwidth, settings, made_of, own)
    metrics, saved = solve(problem, start, t1, settings, jnp.minimum(ts, t1), is_drawn_well)
    read = _ideal if loop.implementation is None else _implemented
    signals = jax.vmap(lambda t, y: read(problem, t, y))(ts, saved)
    # A horizon that was computed elsewhere may differ in its last place.
    has_ended = (ts * (1.0 - INSTANT) > metrics.end_time) | is_refused(metrics.outcome)
    names = ("x", "e", "sigma", "u")
    told = {name: jax.vmap(_unless)(has_ended, getattr(signals, name)) for name in names}
    bounds = jnp.stack([jnp.asarray(bound) for each in problem.channels for bound in each.error_bounds])
    settled = ft.reduce(jnp.maximum, [jnp.asarray(each.settling_time) for each in problem.channels])
    return SolvedRun(metrics, signals._replace(**told), bounds, settled)


def _unless(has_ended: Array, signal: Array) -> Array:
    return jnp.where(has_ended, jnp.nan, signal)


@entry_point
def signals_at_start(loop: ClosedLoop | MultivariableLoop, x0: Float[np.ndarray, " n"]) -> Signals:
    """The signals at time 0 without input, as metrics see them."""
    if isinstance(loop, MultivariableLoop):
        # The inputs are not asked for: any funnel coordinates will do.
        x, rest = loop.start(x0), (jnp.zeros(()),) * (loop.channels[0].states - loop.states)
        return joint_ideal_signals(loop, np.zeros(()), x, [_at_start(each, (*x, *rest)) for each in loop.channels])
    return _at_start(loop.whole, loop.start(x0))


def _at_start(loop: ClosedLoop, x0: Scalars) -> Signals:
    e, desired, rho = loop.errors(0.0, x0), loop.desired(0.0, x0), loop.control.funnel(0.0)
    ratio = loop.ratio(0.0, x0)
    balance, sigma = loop.balance(0.0, x0, e, desired), jnp.asarray(loop.control.surface(e))
    driven = balance.disturbance, balance.residual, balance.gain
    return Signals(np.zeros(()), x0, desired[:-1], e, sigma, rho, ratio, np.zeros(()), *driven)


def grid_of(ts: Any, t1: RealScalarLike) -> Float[np.ndarray, " times"]:
    """The times to read at: those asked for, or 2001 evenly spaced on [0, t1].

    Raises:
        InputError: They do not increase, or not all of them lie within [0, t1].
    """
    t1 = float(t1)
    if ts is None:
        return np.linspace(0.0, t1, _DEFAULT_TIMES)
    grid = as_float64(ts)
    require(grid.ndim == 1 and grid.size > 0, f"Argument `ts` must be a list of times, but has shape {grid.shape}.")
    require_finite("ts", grid)
    inside, ends = bool(grid[0] >= 0.0 and grid[-1] <= t1), f"[{show(grid[0])}, {show(grid[-1])}]"
    require(inside, f"Argument `ts` must lie within [0, t1] = [0, {show(t1)}], but spans {ends}.")
    increases = bool(np.all(np.diff(grid) > 0))
    require(increases, "Argument `ts` must increase, but has a time not later than the one before it.")
    return grid


def _ideal(problem: AbstractProblem, t: Array, y: tuple[Array, ...]) -> GridSignals:
    return _stacked(ideal_signals(problem, t, y))


def _implemented(problem: AbstractProblem, t: Array, saved: tuple[Array, ...]) -> GridSignals:
    states = len(saved) - len(problem.channels)
    return _stacked(sampled_signals(problem, loop_points(problem, t, saved[:states]), saved[states:]))


def _stacked(now: Signals) -> GridSignals:
    """The signals at one instant, those with a number for each derivative, or each channel, as arrays."""

    def stacked(name: str) -> Array:
        leaves = [jnp.asarray(leaf) for leaf in jax.tree.leaves(getattr(now, name))]
        return jnp.stack(leaves) if isinstance(getattr(now, name), tuple) else leaves[0]

    return GridSignals(*map(stacked, GridSignals._fields))

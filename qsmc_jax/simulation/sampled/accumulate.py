"""The running metrics of a sampled loop: kept up cell by cell for the plant, sample by sample for the command."""

import functools as ft

import jax.numpy as jnp
from jaxtyping import Array, Bool

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.hermite import Cubic, integral_of_square
from qsmc_jax.simulation.problem import Problem
from qsmc_jax.simulation.sampled.cell import Cell, LoopPoint
from qsmc_jax.simulation.spans import OutsideStep, Span

# A reversal of the command counts if it is more than this part of the range of the commands so far.
HYSTERESIS = 0.01

_SQRT2 = 2.0**0.5


class Filter(AbstractModule):
    r"""A Butterworth high-pass filter, $s^2 / (s^2 + \sqrt 2 \omega s + \omega^2)$, and what it has let through.

    Attributes:
        low: Output of the low-pass filter beside it.
        rate: The rate of that, over the cutoff frequency.
        high_power: Integral of the squared output.
        power: Integral of the squared input.
    """

    low: RealScalarLike
    rate: RealScalarLike
    high_power: RealScalarLike
    power: RealScalarLike


class Reversals(AbstractModule):
    """Turns of the command with hysteresis.

    Attributes:
        direction: 1 or -1; 0 before the first move.
        extreme: The extreme since the last turn.
        least: Least command so far.
        largest: Largest command so far.
        count: Turns so far.
    """

    direction: RealScalarLike
    extreme: RealScalarLike
    least: RealScalarLike
    largest: RealScalarLike
    count: RealScalarLike


class RunningCommandMetrics(AbstractModule):
    """The metrics of the command as computed, in the steady phase."""

    reversals: Reversals
    peak_rate: RealScalarLike


class RunningCellMetrics(AbstractModule):
    """The metrics of the plant and its input, all scalars; see `Metrics` for what becomes of them.

    `first_exit` is the first cell with |z| >= 1 somewhere, `last_exit` the last, `outside` the last with |sigma| >=
    bandwidth, `unsettled` the last in which an error reached its bound. The extremes of the input leave out
    what it was at time 0 alone, before the first command.
    """

    peak_ratio: RealScalarLike
    peak_time: RealScalarLike
    peak_excess: RealScalarLike
    first_exit: OutsideStep
    last_exit: OutsideStep
    outside: OutsideStep
    unsettled: Span
    peak_errors: Scalars
    max_u: RealScalarLike
    min_u: RealScalarLike
    last_u: RealScalarLike
    total_variation: RealScalarLike
    steady_variation: RealScalarLike
    equivalent_variation: RealScalarLike
    energy: RealScalarLike
    squared_error: RealScalarLike
    filter: Filter
    least_gain: RealScalarLike
    largest_disturbance: RealScalarLike


def first_cell_metrics(problem: Problem, start: LoopPoint) -> RunningCellMetrics:
    """The metrics at time 0, before any input."""
    zero, inf = jnp.zeros(()), jnp.full((), jnp.inf)
    none = OutsideStep(zero, zero, Cubic(zero, zero, zero, zero))
    return RunningCellMetrics(
        peak_ratio=jnp.abs(start.ratio),
        peak_time=zero,
        peak_excess=jnp.abs(start.sigma - start.centre) - start.rho,
        first_exit=none,
        last_exit=none,
        outside=none,
        unsettled=Span(zero, zero),
        peak_errors=(zero,) * problem.loop.order,
        max_u=-inf,
        min_u=inf,
        last_u=zero,
        total_variation=zero,
        steady_variation=zero,
        equivalent_variation=zero,
        energy=zero,
        squared_error=zero,
        filter=Filter(zero, zero, zero, zero),
        least_gain=jnp.asarray(problem.loop.control.gain_sign * start.terms.gain),
        largest_disturbance=jnp.abs(jnp.asarray(start.terms.disturbance)),
    )


def first_command_metrics() -> RunningCommandMetrics:
    """The metrics before the first command."""
    zero, inf = jnp.zeros(()), jnp.full((), jnp.inf)
    return RunningCommandMetrics(Reversals(zero, zero, inf, -inf, zero), zero)


def add_cell(problem: Problem, cutoff: RealScalarLike, running: RunningCellMetrics, cell: Cell) -> RunningCellMetrics:
    """The metrics after one more cell. No cell has the reaching or the settling time inside."""
    t0, t1, h = cell.left.t, cell.right.t, cell.length
    is_steady = t0 >= problem.reaching_time
    sigma, z, errors = cell.sigma(), cell.ratio(), cell.errors()
    place, height = problem.barrier(z.crest())
    excess = _excess(cell, sigma, jnp.sign(z(place)))
    is_higher, exit_ = height > running.peak_ratio, OutsideStep(t0, h, z)
    is_out = problem.barrier.claim((h > 0.0) & ((height >= 1.0) | (jnp.abs(z.y0) >= 1.0)))
    is_far = problem.barrier.claim((h > 0.0) & (_height(sigma) >= problem.bandwidth))
    heights = problem.barrier(tuple(_height(cubic) for cubic in errors))
    jump = jnp.where(t0 > 0.0, jnp.abs(cell.u0 - running.last_u), 0.0)
    change = jump + cell.swing.variation
    equivalent = jnp.abs(cell.right.equivalent_input - cell.left.equivalent_input)
    gain = problem.loop.control.gain_sign * cell.right.terms.gain
    left = errors[0].y0, cell.left.error_rates(cell.u0)[0]
    right = errors[0].y1, cell.right.error_rates(cell.u1)[0]
    return RunningCellMetrics(
        peak_ratio=jnp.maximum(height, running.peak_ratio),
        peak_time=jnp.where(is_higher, t0 + place * h, running.peak_time),
        peak_excess=jnp.maximum(running.peak_excess, excess),
        first_exit=pytrees.where(is_out & (running.first_exit.length == 0.0), exit_, running.first_exit),
        last_exit=pytrees.where(is_out, exit_, running.last_exit),
        outside=pytrees.where(is_far, OutsideStep(t0, h, sigma), running.outside),
        unsettled=pytrees.where(problem.barrier.claim(_exceeds(problem, heights)), Span(t0, t1), running.unsettled),
        peak_errors=pytrees.where(
            is_steady, tuple(map(jnp.maximum, heights, running.peak_errors)), running.peak_errors
        ),
        max_u=jnp.where(t1 > 0.0, jnp.maximum(running.max_u, cell.swing.high), running.max_u),
        min_u=jnp.where(t1 > 0.0, jnp.minimum(running.min_u, cell.swing.low), running.min_u),
        last_u=cell.u1,
        total_variation=running.total_variation + change,
        steady_variation=running.steady_variation + jnp.where(is_steady, change, 0.0),
        equivalent_variation=running.equivalent_variation + jnp.where(is_steady, equivalent, 0.0),
        energy=running.energy + cell.swing.energy,
        squared_error=running.squared_error + integral_of_square(h, left, right),
        filter=_filtered(running.filter, cell, cutoff, is_steady),
        least_gain=jnp.minimum(running.least_gain, gain),
        largest_disturbance=jnp.maximum(running.largest_disturbance, jnp.abs(cell.right.terms.disturbance)),
    )


def add_command(
    running: RunningCommandMetrics,
    command: RealScalarLike,
    last: RealScalarLike,
    period: RealScalarLike,
    is_steady: BoolScalarLike,
) -> RunningCommandMetrics:
    """The metrics after one more command."""
    rate = jnp.abs(command - last) / period
    new = RunningCommandMetrics(_turned(running.reversals, command), jnp.maximum(running.peak_rate, rate))
    return pytrees.where(is_steady, new, running)


def _excess(cell: Cell, sigma: Cubic, side: RealScalarLike) -> RealScalarLike:
    """How far beyond the funnel's edge on one side the sliding variable gets in a cell, after its beginning.

    It is farthest out at another instant than the ratio is highest: the funnel shrinks.
    """
    left, right, h = cell.left, cell.right, cell.length
    ends = [side * (end.sigma - end.centre) - end.rho for end in (left, right)]
    rates = zip((sigma.m0, sigma.m1), (left, right), strict=True)
    past = Cubic(*ends, *(side * (m - h * end.centre_rate) - h * end.rho_rate for m, end in rates))
    return jnp.maximum(past(past.parabolas_turn()), past.y1)


def _height(cubic: Cubic) -> RealScalarLike:
    """How high |p| gets in the cell, its beginning included."""
    return jnp.maximum(jnp.abs(cubic.y0), cubic.crest()[1])


def _exceeds(problem: Problem, heights: Scalars) -> Bool[Array, ""]:
    """Whether any error reaches its bound in the cell."""
    reaches = (jnp.asarray(h >= bound) for h, bound in zip(heights, problem.error_bounds, strict=True))
    return ft.reduce(jnp.logical_or, reaches)


def _filtered(filter_: Filter, cell: Cell, cutoff: RealScalarLike, is_steady: BoolScalarLike) -> Filter:
    """The filter after a cell, by the trapezium rule (Tustin's), which is stable for any length of it."""
    # notation: a = omega h / 2; y, v = the low-pass filter's output and its rate over omega
    h, u, y, v = cell.length, cell.middle, filter_.low, filter_.rate
    a = 0.5 * cutoff * h
    v1 = (v * (1.0 - _SQRT2 * a - a * a) + 2.0 * a * (u - y)) / (1.0 + _SQRT2 * a + a * a)
    y1 = y + a * (v + v1)
    high0, high1 = u - y - _SQRT2 * v, u - y1 - _SQRT2 * v1
    high = jnp.where(is_steady, h / 3.0 * (high0 * high0 + high0 * high1 + high1 * high1), 0.0)
    return Filter(y1, v1, filter_.high_power + high, filter_.power + jnp.where(is_steady, h * u * u, 0.0))


def _turned(turns: Reversals, u: RealScalarLike) -> Reversals:
    """The turns after one more command."""
    is_first = turns.least > turns.largest
    least, largest = jnp.minimum(turns.least, u), jnp.maximum(turns.largest, u)
    move = jnp.where(is_first, 0.0, u - turns.extreme)
    goes_on = move * turns.direction >= 0.0
    is_turn = ~goes_on & (jnp.abs(move) > HYSTERESIS * (largest - least))
    moves = (turns.direction == 0.0) | is_turn
    return Reversals(
        direction=jnp.where(moves, jnp.sign(move), turns.direction),
        extreme=jnp.where(is_first | goes_on | is_turn, u, turns.extreme),
        least=least,
        largest=largest,
        count=turns.count + jnp.where(is_turn, 1.0, 0.0),
    )

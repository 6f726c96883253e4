"""The loop of an implemented controller: open between events, at which something is sampled, arrives or jumps.

Between events the plant's right-hand side is smooth (the feedback stands still), so an explicit method is always right,
and the tangent's pole, which no step can jump over here, is met by the law alone, which says what it does there. Every
cell ends at the next event at the latest, each run at its own; cells are shorter only where the plant asks for it.
"""

import dataclasses
import functools as ft
import itertools as it
from collections.abc import Sequence

import diffrax as dfx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.enclosures.unseen import Nodes, Step
from qsmc_jax.metrics.accumulate import add_step as add_own
from qsmc_jax.metrics.accumulate import first_states
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.hermite import cubics
from qsmc_jax.numerics.lockstep import any_lane
from qsmc_jax.simulation.break_times import BreakTimes, break_times
from qsmc_jax.simulation.guard import Path, hidden_in_cell
from qsmc_jax.simulation.problem import AbstractProblem, Problem
from qsmc_jax.simulation.sampled.accumulate import add_cell, first_cell_metrics, first_command_metrics
from qsmc_jax.simulation.sampled.cell import Cell, CellStep, LoopPoint, loop_points, no_cell, rates, seen
from qsmc_jax.simulation.sampled.computer import Computer, place_in, sample
from qsmc_jax.simulation.sampled.drive import Drive
from qsmc_jax.simulation.sampled.state import ChannelState, LoopState, Saved, implementation_of
from qsmc_jax.simulation.settings import INSTANT, SolverSettings, absolute_tolerance
from qsmc_jax.solvers.explicit import explicit_stages, weighted

# Bogacki and Shampine's pair of order 3(2): between samples, cells are short anyhow.
_TABLEAU = dfx.Bosh3.tableau
# Tolerance of the peak of |sigma| / rho, in units of the relative one.
_READING = 10.0
_NODES = Nodes(tuple(sorted({0.0, *map(float, _TABLEAU.c)})), few=(0.0, 0.5, 1.0))
_SHRINKS_BY, _GROWS_BY, _SAFETY = 0.2, 5.0, 0.9
_FIRST_STEP, _SHORTEST_STEP = 1e-2, 1e-14  # of the horizon


class LoopConstants(AbstractModule):
    """What stays the same from cell to cell; the cutoff is one for each channel."""

    problem: AbstractProblem
    horizon: RealScalarLike
    breaks: BreakTimes
    cutoffs: Scalars
    rtol: RealScalarLike
    atol: RealScalarLike
    max_steps: int


def run_sampled(
    problem: AbstractProblem,
    x0: Scalars,
    horizon: RealScalarLike,
    is_admitted: BoolScalarLike,
    settings: SolverSettings,
    ts: Float[Array, " times"] | None,
) -> LoopState:
    """Runs a loop with an implementation to the horizon, as far as it gets.

    Args:
        problem: The loop and its thresholds.
        x0: The start, n scalars.
        horizon: The horizon [s].
        is_admitted: Whether there is anything to run; if not, no step is taken.
        settings: `rtol` (of the sliding variable, relative to the funnel) and `max_steps`.
        ts: Times [s] at which to save states and inputs, or None.
    """
    constants, zero = _constants(problem, horizon, settings), jnp.zeros(())
    start = jax.tree.map(jnp.asarray, loop_points(problem, zero, tuple(map(jnp.asarray, x0))))
    channels = tuple(_first(*each) for each in zip(problem.channels, start, strict=True))
    saved = None
    if ts is not None:
        rows = jnp.zeros_like(ts)
        saved = Saved(ts, (rows,) * len(x0), (rows,) * len(channels), jnp.array(0))
    first = LoopState(
        channels=channels,
        own=first_states(problem.measures, CellStep(no_cell(start), problem)),
        step=_FIRST_STEP * horizon,
        steps=zero,
        cursor=constants.breaks.start(zero),
        is_running=jnp.asarray(is_admitted),
        saved=saved,
    )
    start = first, any_lane(first.is_running)
    # The one kind of loop can be differentiated backwards, the other forwards; solving is the same.
    kind = "checkpointed" if settings.adjoint == "reverse" else "lax"
    return eqxi.while_loop(_goes_on, ft.partial(_in_step, constants), start, max_steps=settings.max_steps, kind=kind)[0]


def _first(problem: Problem, start: LoopPoint) -> ChannelState:
    """A channel at time 0."""
    implementation, zero = implementation_of(problem), jnp.zeros(())
    computer = Computer(
        memory=tuple(map(jnp.asarray, problem.loop.control.first_memory())),
        sent=zero,
        held=zero,
        sample=zero,
        arrival=zero,
        queue=jnp.zeros((implementation.queue,)) if implementation.is_late else None,
        has_overflown=jnp.array(False),
    )
    return ChannelState(
        now=start,
        actuator=() if implementation.actuator is None else implementation.actuator.rest(),
        computer=computer,
        first_ratio=jnp.abs(start.ratio),
        cells=first_cell_metrics(problem, start),
        commands=first_command_metrics(),
    )


def _goes_on(carry: tuple[LoopState, BoolScalarLike]) -> BoolScalarLike:
    return carry[1]


def _in_step(constants: LoopConstants, carry: tuple[LoopState, BoolScalarLike]) -> tuple[LoopState, BoolScalarLike]:
    """All lanes one cell further; those that are done stay as they are."""
    state = _advance(constants, carry[0])
    return state, any_lane(state.is_running)


def _constants(problem: AbstractProblem, horizon: RealScalarLike, settings: SolverSettings) -> LoopConstants:
    times = [jnp.asarray(each) for one in problem.channels for each in (one.reaching_time, one.settling_time)]
    breaks = break_times([*problem.break_times, jnp.stack(times)], problem.barrier)
    cutoffs = tuple(map(_cutoff, problem.channels))
    return LoopConstants(problem, horizon, breaks, cutoffs, settings.rtol, settings.atol, settings.max_steps)


def _cutoff(problem: Problem) -> RealScalarLike:
    """The angular frequency [rad/s] above which power of the input counts as high-frequency."""
    loop, cutoff = problem.loop, implementation_of(problem).cutoff
    degree, rate = loop.order - 1, loop.control.funnel.rate
    if degree > 0:
        rate = jnp.maximum(rate, jnp.abs(loop.control.surface.c[0]) ** (1.0 / degree))
    return 5.0 * rate if cutoff is None else cutoff


def _advance(constants: LoopConstants, state: LoopState) -> LoopState:
    """One cell further, or a shorter try at the same one; then whatever happens at its end."""
    problem = constants.problem
    times = [_event_times(each, one) for each, one in zip(problem.channels, state.channels, strict=True)]
    event, end = _next_event(constants, state, ft.reduce(jnp.minimum, it.chain.from_iterable(times)))
    ends, cells, error = _cross(constants, state, end)
    is_good = problem.barrier.claim(state.is_running & (error <= 1.0))
    h, tried = cells[0].length, state.step
    wanted = h * _step_factor(error)
    step = jnp.where(is_good & (h < tried), jnp.maximum(tried, wanted), wanted)
    steps = state.steps + jnp.where(state.is_running, 1.0, 0.0)
    counted = dataclasses.replace(state, step=jnp.where(state.is_running, step, tried), steps=steps)
    channels = []
    for i, (each, one, cell) in enumerate(zip(problem.channels, state.channels, cells, strict=True)):
        running, actuator = add_cell(each, constants.cutoffs[i], one.cells, cell), _drive(each, one).state_at(end)
        channels.append(dataclasses.replace(one, now=ends[i], actuator=actuator, cells=running))
    cursor = constants.breaks.moved(state.cursor, ends[0].t)
    own = add_own(problem.measures, state.own, CellStep(cells, problem))
    arrived = dataclasses.replace(counted, channels=tuple(channels), cursor=cursor, own=own)
    has_event = is_good & (end >= event)
    happens = [(has_event & (captured <= event), has_event & (arrived_at <= event)) for captured, arrived_at in times]
    return _judged(constants, _handle(constants, pytrees.where(is_good, arrived, counted), has_event, happens))


def _next_event(
    constants: LoopConstants, state: LoopState, of_computer: RealScalarLike
) -> tuple[RealScalarLike, RealScalarLike]:
    """The time of the next event, and where the next cell ends: there, or at the end of one of equal parts."""
    t, event = state.t, jnp.minimum(constants.horizon, of_computer)
    event = jnp.minimum(event, constants.problem.barrier(constants.breaks.before_next(state.cursor, t)))
    if state.saved is not None:
        event = jnp.minimum(event, _save_time(state.saved))
    for drive in _drives(constants, state):
        event = ft.reduce(jnp.minimum, drive.kinks(), event)
    left = event - t
    parts = jnp.ceil(left / state.step)
    return event, jnp.where(parts <= 1.0, event, t + left / jnp.maximum(parts, 1.0))


def _event_times(problem: Problem, state: ChannelState) -> tuple[RealScalarLike, RealScalarLike]:
    """When the states of the next sample are measured, and when the next command arrives; not before now.

    Worked out once a step, behind a barrier: rounded in two ways, a time could come without its event, again and again.
    """
    implementation, computer, t = implementation_of(problem), state.computer, state.now.t
    age, delay, barrier = implementation.measurement_delay, implementation.delay, problem.barrier
    sampled, sent = implementation.instant(computer.sample), implementation.instant(computer.arrival)
    captured, arrived = sampled if age is None else sampled - age, sent if delay is None else sent + delay
    captured, is_under_way = barrier(jnp.maximum(captured, t)), computer.arrival < computer.sample
    arrived = jnp.where(is_under_way, jnp.maximum(arrived, t), jnp.inf)
    return captured, barrier(arrived) if implementation.is_late else jnp.inf


def _drive(problem: Problem, state: ChannelState) -> Drive:
    return Drive(implementation_of(problem).actuator, state.actuator, state.computer.held, state.now.t)


def _drives(constants: LoopConstants, state: LoopState) -> list[Drive]:
    return list(map(_drive, constants.problem.channels, state.channels))


def _save_time(saved: Saved) -> RealScalarLike:
    """The next of the times asked for."""
    last = saved.ts.shape[0] - 1
    return jnp.where(saved.count <= last, saved.ts[jnp.minimum(saved.count, last)], jnp.inf)


def _cross(
    constants: LoopConstants, state: LoopState, end: RealScalarLike
) -> tuple[tuple[LoopPoint, ...], tuple[Cell, ...], RealScalarLike]:
    """Where the channels are at `end`, the cells up to there, and the estimated error in units of what is allowed."""
    problem, barrier, points = constants.problem, constants.problem.barrier, state.points
    loop, drives, now = problem.channels[0].loop, _drives(constants, state), state.t
    h = end - now
    inputs_at = lambda t: tuple(drive.input_at(t) for drive in drives)  # noqa: E731

    def field(t: RealScalarLike, x: Scalars) -> Scalars:
        *chain, last = rates(problem, t, x, inputs_at(t))
        return (*chain, barrier(last))

    u0, u1 = inputs_at(now), inputs_at(end)  # u0: an actuator without a lag has changed since the last cell
    lefts = seen(points, u0)
    first = loop.rates(lefts[0].terms, lefts[0].x, u0[0])
    x1, stages = explicit_stages(_TABLEAU, field, now, end, lefts[0].x, first)
    ends = loop_points(problem, end, barrier(x1))
    rights = seen(ends, u1)
    stages.append(loop.rates(rights[0].terms, rights[0].x, u1[0]))
    missed = tuple(h * error for error in weighted(_TABLEAU.b_error, stages))
    middles, swings = inputs_at(now + 0.5 * h), [drive.swing(h) for drive in drives]
    cells = tuple(map(Cell, lefts, rights, u0, middles, u1, swings))
    largest = [ft.reduce(jnp.maximum, map(jnp.abs, (cell.u0, cell.middle, cell.u1))) for cell in cells]
    path = _path(lefts[0], h, x1, first, stages[-1])
    least = constants.atol / constants.rtol
    hides = hidden_in_cell(problem, Step(now, end, _NODES), path, largest, constants.rtol, least)
    local = _local_error(constants, state, cells, missed)
    misread = ft.reduce(jnp.maximum, map(_misread, problem.channels, cells))
    error = ft.reduce(jnp.maximum, (local, hides**2, misread / (_READING * constants.rtol)))
    return ends, cells, jnp.where(jnp.isfinite(error), error, jnp.inf)


def _local_error(
    constants: LoopConstants, state: LoopState, cells: tuple[Cell, ...], missed: Scalars
) -> RealScalarLike:
    """The error in each sliding variable, and in each state of a plant in its own coordinates, over what is allowed."""
    parts = []
    for each, one, cell in zip(constants.problem.channels, state.channels, cells, strict=True):
        loop, right = each.loop, cell.right
        speed = jnp.abs(cell.left.sigma_rate(cell.u0)) + jnp.abs(right.sigma_rate(cell.u1))
        width, moved = constants.rtol * right.rho, INSTANT * right.t * speed
        allowed = constants.rtol * jnp.abs(right.sigma) + absolute_tolerance(width, one.cells.peak_ratio, moved)
        if isinstance(loop.plant, AbstractPlant):
            return loop.control.surface(tuple(map(jnp.abs, missed))) / allowed
        in_errors = jax.jvp(lambda *x, loop=loop, t=right.t: loop.errors(t, x), right.x, missed)[1]
        parts.append(loop.control.surface(tuple(map(jnp.abs, in_errors))) / allowed)
    for a, b, wrong in zip(cells[0].left.x, cells[0].right.x, missed, strict=True):
        size = jnp.maximum(jnp.abs(a), jnp.abs(b))
        parts.append(jnp.abs(wrong) / (constants.rtol * size + constants.atol))
    return ft.reduce(jnp.maximum, parts)


def _misread(problem: Problem, cell: Cell) -> RealScalarLike:
    r"""By how much the peak of $z = \sigma/\rho$ in a cell may be read wrongly off its cubic [-].

    The cubic is wrong where the funnel bends, for which its middle tells; and the peak is looked for where the parabola
    turns that has the slopes of both ends.
    """
    z, sigma, middle = cell.ratio(), cell.sigma(), cell.left.t + 0.5 * cell.length
    funnel = problem.loop.control.funnel
    bend, *_ = z.coefficients()
    return jnp.abs(z(0.5) - (sigma(0.5) - funnel.centre(middle)) / funnel(middle)) + 0.1 * jnp.abs(bend)


def _path(now: LoopPoint, h: RealScalarLike, x1: Scalars, rates0: Scalars, rates1: Scalars) -> Path:
    """The state in a cell, by the cubic through its ends and their rates."""
    pieces = cubics(h, now.x, x1, rates0, rates1)
    inverse = jnp.where(h > 0.0, 1.0 / jnp.where(h > 0.0, h, 1.0), 0.0)
    return lambda t: tuple(cubic((t - now.t) * inverse) for cubic in pieces)


def _step_factor(error: RealScalarLike) -> RealScalarLike:
    """By how much the next step may be longer: a fourth root where a third would do, and roots are cheap."""
    root = jnp.sqrt(jnp.maximum(error, 1e-8))
    gentle = _SAFETY / jnp.sqrt(root)
    return jnp.clip(jnp.where(error > 1.0, _SAFETY / root, gentle), _SHRINKS_BY, _GROWS_BY)


def _handle(
    constants: LoopConstants,
    state: LoopState,
    has_event: BoolScalarLike,
    happens: Sequence[tuple[BoolScalarLike, BoolScalarLike]],
) -> LoopState:
    """What happens at the end of a cell: commands arrive, samples are taken, a state is saved."""
    parts = zip(constants.problem.channels, state.channels, happens, strict=True)
    channels = tuple(_handle_channel(constants, *each) for each in parts)
    state, saved = dataclasses.replace(state, channels=channels), state.saved
    return state if saved is None else _save(constants, state, saved, has_event & (state.t >= _save_time(saved)))


def _handle_channel(
    constants: LoopConstants, problem: Problem, state: ChannelState, happens: tuple[BoolScalarLike, BoolScalarLike]
) -> ChannelState:
    """What happens in a channel: a command arrives, a sample is taken."""
    t, computer, commands, (is_captured, arrives) = state.now.t, state.computer, state.commands, happens
    if computer.queue is not None:
        place = place_in(computer.queue, computer.arrival)
        computer = dataclasses.replace(
            computer,
            held=jnp.where(arrives, computer.queue[place], computer.held),
            arrival=jnp.where(arrives, computer.arrival + 1.0, computer.arrival),
        )
    samples = is_captured & (t < constants.horizon)
    sampled, accumulated = sample(problem, implementation_of(problem), state.now, computer, commands)
    computer = pytrees.where(samples, sampled, computer)
    commands = pytrees.where(samples, accumulated, commands)
    return dataclasses.replace(state, computer=computer, commands=commands)


def _save(constants: LoopConstants, state: LoopState, saved: Saved, is_time: BoolScalarLike) -> LoopState:
    """The signals at the time asked for, after whatever happened at it."""
    us = tuple(drive.input_at(state.t) for drive in _drives(constants, state))
    place = jnp.where(is_time, saved.count, saved.ts.shape[0])  # out of bounds: dropped
    x, u = (
        tuple(old.at[place].set(new, mode="drop") for old, new in zip(rows, values, strict=True))
        for rows, values in ((saved.x, state.points[0].x), (saved.u, us))
    )
    count = saved.count + jnp.where(is_time, 1, 0)
    return dataclasses.replace(state, saved=Saved(saved.ts, x, u, count))


def _judged(constants: LoopConstants, state: LoopState) -> LoopState:
    """Whether the run goes on."""
    goes_on = (
        (state.t < constants.horizon)
        & (state.steps < constants.max_steps)
        & (state.step > _SHORTEST_STEP * constants.horizon)
    )
    for each in state.channels:
        goes_on = goes_on & each.goes_on
    return dataclasses.replace(state, is_running=state.is_running & goes_on)

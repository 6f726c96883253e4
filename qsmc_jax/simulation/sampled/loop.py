"""The loop of an implemented controller: open between events, at which something is sampled, arrives or jumps.

Between events the plant's right-hand side is smooth (the feedback stands still), so an explicit method is always right,
and the tangent's pole, which no step can jump over here, is met by the law alone, which says what it does there. Every
cell ends at the next event at the latest, each run at its own; cells are shorter only where the plant asks for it.
"""

import dataclasses
import functools as ft

import diffrax as dfx
import equinox.internal as eqxi
import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float, Int

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.enclosures.unseen import Nodes, Step
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.hermite import cubics
from qsmc_jax.numerics.lockstep import any_lane
from qsmc_jax.simulation.break_times import BreakTimes, Cursor, break_times
from qsmc_jax.simulation.guard import Path, hidden_in_cell
from qsmc_jax.simulation.problem import Problem
from qsmc_jax.simulation.sampled.accumulate import (
    RunningCellMetrics,
    RunningCommandMetrics,
    add_cell,
    first_cell_metrics,
    first_command_metrics,
)
from qsmc_jax.simulation.sampled.cell import Cell, LoopPoint, loop_point
from qsmc_jax.simulation.sampled.computer import Computer, place_in, sample
from qsmc_jax.simulation.sampled.drive import Drive
from qsmc_jax.simulation.settings import INSTANT, SolverSettings, absolute_tolerance
from qsmc_jax.solvers.explicit import explicit_stages, weighted

# Bogacki and Shampine's pair of order 3(2): between samples, cells are short anyhow.
_TABLEAU = dfx.Bosh3.tableau
# Tolerance of the peak of |sigma| / rho, in units of the relative one.
_READING = 10.0
_NODES = Nodes(tuple(sorted({0.0, *map(float, _TABLEAU.c)})), few=(0.0, 0.5, 1.0))
# A run is lost once it is this many funnel widths away, or this many times as far as it started.
_LOST = 1000.0
_SHRINKS_BY, _GROWS_BY, _SAFETY = 0.2, 5.0, 0.9
_FIRST_STEP, _SHORTEST_STEP = 1e-2, 1e-14  # of the horizon


class Saved(AbstractModule):
    """States and inputs at the times asked for, `ts`, and how many there are so far."""

    ts: Float[Array, " times"]
    x: tuple[Float[Array, " times"], ...]
    u: Float[Array, " times"]
    count: Int[Array, ""]


class LoopState(AbstractModule):
    """Everything that a run carries from cell to cell.

    Attributes:
        now: Where the loop is.
        actuator: State of the actuator; empty if there is none.
        computer: The controller's side.
        step: Length [s] of the longest cell that the tolerance allows, as far as is known.
        steps: Cells tried so far.
        cursor: Which breaks are still ahead.
        is_running: Whether the run goes on.
        first_ratio: |z| at the start, z where in the funnel the sliding variable is.
        cells: Metrics of the plant.
        commands: Metrics of the commands.
        saved: States and inputs at the times asked for.
    """

    now: LoopPoint
    actuator: Scalars
    computer: Computer
    step: RealScalarLike
    steps: RealScalarLike
    cursor: Cursor
    is_running: Bool[Array, ""]
    first_ratio: RealScalarLike
    cells: RunningCellMetrics
    commands: RunningCommandMetrics
    saved: Saved | None

    @property
    def starts_outside(self) -> BoolScalarLike:
        """Whether it started outside the funnel."""
        return jnp.asarray(self.first_ratio >= 1.0)

    @property
    def farthest(self) -> RealScalarLike:
        """How far out, in funnel widths, it counts as lost."""
        return _LOST * jnp.maximum(1.0, self.first_ratio)


class LoopConstants(AbstractModule):
    """What stays the same from cell to cell."""

    problem: Problem
    implementation: Implementation
    horizon: RealScalarLike
    breaks: BreakTimes
    cutoff: RealScalarLike
    rtol: RealScalarLike
    atol: RealScalarLike
    max_steps: int


def run_sampled(
    problem: Problem,
    implementation: Implementation,
    x0: Scalars,
    horizon: RealScalarLike,
    is_admitted: BoolScalarLike,
    settings: SolverSettings,
    ts: Float[Array, " times"] | None,
) -> LoopState:
    """Runs a loop with an implementation to the horizon, as far as it gets.

    Args:
        problem: The loop and its thresholds.
        implementation: Its implementation.
        x0: The start, n scalars.
        horizon: The horizon [s].
        is_admitted: Whether there is anything to run; if not, no step is taken.
        settings: `rtol` (of the sliding variable, relative to the funnel) and `max_steps`.
        ts: Times [s] at which to save states and inputs, or None.
    """
    constants, zero = _constants(problem, implementation, horizon, settings), jnp.zeros(())
    start = jax.tree.map(jnp.asarray, loop_point(problem, zero, tuple(map(jnp.asarray, x0))))
    computer = Computer(
        memory=tuple(map(jnp.asarray, problem.loop.control.first_memory())),
        sent=zero,
        held=zero,
        sample=zero,
        arrival=zero,
        queue=jnp.zeros((implementation.queue,)) if implementation.is_late else None,
        has_overflown=jnp.array(False),
    )
    first = LoopState(
        now=start,
        actuator=() if implementation.actuator is None else implementation.actuator.rest(),
        computer=computer,
        step=_FIRST_STEP * horizon,
        steps=zero,
        cursor=constants.breaks.start(zero),
        is_running=jnp.asarray(is_admitted),
        first_ratio=jnp.abs(start.ratio),
        cells=first_cell_metrics(problem, start),
        commands=first_command_metrics(),
        saved=None if ts is None else Saved(ts, (jnp.zeros_like(ts),) * len(x0), jnp.zeros_like(ts), jnp.array(0)),
    )
    start = first, any_lane(first.is_running)
    # The one kind of loop can be differentiated backwards, the other forwards; solving is the same.
    kind = "checkpointed" if settings.adjoint == "reverse" else "lax"
    return eqxi.while_loop(_goes_on, ft.partial(_in_step, constants), start, max_steps=settings.max_steps, kind=kind)[0]


def _goes_on(carry: tuple[LoopState, BoolScalarLike]) -> BoolScalarLike:
    return carry[1]


def _in_step(constants: LoopConstants, carry: tuple[LoopState, BoolScalarLike]) -> tuple[LoopState, BoolScalarLike]:
    """All lanes one cell further; those that are done stay as they are."""
    state = _advance(constants, carry[0])
    return state, any_lane(state.is_running)


def _constants(
    problem: Problem, implementation: Implementation, horizon: RealScalarLike, settings: SolverSettings
) -> LoopConstants:
    loop, funnel = problem.loop, problem.loop.control.funnel
    judged_from = jnp.stack([jnp.asarray(problem.reaching_time), jnp.asarray(problem.settling_time)])
    breaks = break_times([*problem.break_times, judged_from], problem.barrier)
    degree = loop.order - 1
    rate = funnel.rate
    if degree > 0:
        rate = jnp.maximum(rate, jnp.abs(loop.control.surface.c[0]) ** (1.0 / degree))
    cutoff = 5.0 * rate if implementation.cutoff is None else implementation.cutoff
    return LoopConstants(
        problem, implementation, horizon, breaks, cutoff, settings.rtol, settings.atol, settings.max_steps
    )


def _advance(constants: LoopConstants, state: LoopState) -> LoopState:
    """One cell further, or a shorter try at the same one; then whatever happens at its end."""
    captured, arrived_at = _event_times(constants, state)
    event, end = _next_event(constants, state, jnp.minimum(captured, arrived_at))
    cell, actuator, error = _cross(constants, state, end)
    is_good = constants.problem.barrier.claim(state.is_running & (error <= 1.0))
    h, tried = cell.length, state.step
    wanted = h * _step_factor(error)
    step = jnp.where(is_good & (h < tried), jnp.maximum(tried, wanted), wanted)
    cells = add_cell(constants.problem, constants.cutoff, state.cells, cell)
    steps = state.steps + jnp.where(state.is_running, 1.0, 0.0)
    counted = dataclasses.replace(state, step=jnp.where(state.is_running, step, tried), steps=steps)
    cursor = constants.breaks.moved(state.cursor, cell.right.t)
    arrived = dataclasses.replace(counted, now=cell.right, actuator=actuator, cells=cells, cursor=cursor)
    has_event = is_good & (end >= event)
    happens = has_event & (captured <= event), has_event & (arrived_at <= event)
    return _judged(constants, _handle(constants, pytrees.where(is_good, arrived, counted), has_event, happens))


def _next_event(
    constants: LoopConstants, state: LoopState, of_computer: RealScalarLike
) -> tuple[RealScalarLike, RealScalarLike]:
    """The time of the next event, and where the next cell ends: there, or at the end of one of equal parts."""
    t, event = state.now.t, jnp.minimum(constants.horizon, of_computer)
    event = jnp.minimum(event, constants.problem.barrier(constants.breaks.before_next(state.cursor, t)))
    if state.saved is not None:
        event = jnp.minimum(event, _save_time(state.saved))
    event = ft.reduce(jnp.minimum, _drive(constants, state).kinks(), event)
    left = event - t
    parts = jnp.ceil(left / state.step)
    return event, jnp.where(parts <= 1.0, event, t + left / jnp.maximum(parts, 1.0))


def _event_times(constants: LoopConstants, state: LoopState) -> tuple[RealScalarLike, RealScalarLike]:
    """When the states of the next sample are measured, and when the next command arrives; not before now.

    Worked out once a step, behind a barrier: rounded in two ways, a time could come without its event, again and again.
    """
    implementation, computer, t = constants.implementation, state.computer, state.now.t
    age, delay, barrier = implementation.measurement_delay, implementation.delay, constants.problem.barrier
    sampled, sent = implementation.instant(computer.sample), implementation.instant(computer.arrival)
    captured, arrived = sampled if age is None else sampled - age, sent if delay is None else sent + delay
    captured, is_under_way = barrier(jnp.maximum(captured, t)), computer.arrival < computer.sample
    arrived = jnp.where(is_under_way, jnp.maximum(arrived, t), jnp.inf)
    return captured, barrier(arrived) if implementation.is_late else jnp.inf


def _drive(constants: LoopConstants, state: LoopState) -> Drive:
    return Drive(constants.implementation.actuator, state.actuator, state.computer.held, state.now.t)


def _save_time(saved: Saved) -> RealScalarLike:
    """The next of the times asked for."""
    last = saved.ts.shape[0] - 1
    return jnp.where(saved.count <= last, saved.ts[jnp.minimum(saved.count, last)], jnp.inf)


def _cross(constants: LoopConstants, state: LoopState, end: RealScalarLike) -> tuple[Cell, Scalars, RealScalarLike]:
    """The cell from now to `end`, the actuator there, and the estimated error in units of what is allowed."""
    loop, barrier, now = constants.problem.loop, constants.problem.barrier, state.now
    drive, h = _drive(constants, state), end - now.t

    def field(t: RealScalarLike, x: Scalars) -> Scalars:
        *chain, last = loop.rates(loop.terms(t, x), x, drive.input_at(t))
        return (*chain, barrier(last))

    u0, u1 = drive.input_at(now.t), drive.input_at(end)  # u0: an actuator without a lag has changed since the last cell
    first = loop.rates(now.terms, now.x, u0)
    x1, stages = explicit_stages(_TABLEAU, field, now.t, end, now.x, first)
    right = loop_point(constants.problem, end, barrier(x1))
    stages.append(loop.rates(right.terms, right.x, u1))
    missed = tuple(h * error for error in weighted(_TABLEAU.b_error, stages))
    speed = jnp.abs(now.sigma_rate(u0)) + jnp.abs(right.sigma_rate(u1))
    width, moved = constants.rtol * right.rho, INSTANT * end * speed
    allowed = constants.rtol * jnp.abs(right.sigma) + absolute_tolerance(width, state.cells.peak_ratio, moved)
    cell = Cell(now, right, u0, drive.input_at(now.t + 0.5 * h), u1, drive.swing(h))
    largest = ft.reduce(jnp.maximum, map(jnp.abs, (cell.u0, cell.middle, cell.u1)))
    path = _path(now, h, x1, first, stages[-1])
    least = constants.atol / constants.rtol
    hides = hidden_in_cell(
        constants.problem, constants.implementation, Step(now.t, end, _NODES), path, largest, constants.rtol, least
    )
    local = _local_error(constants, cell, missed, allowed)
    error = ft.reduce(jnp.maximum, (local, hides**2, _misread(constants, cell) / (_READING * constants.rtol)))
    return cell, drive.state_at(end), jnp.where(jnp.isfinite(error), error, jnp.inf)


def _local_error(constants: LoopConstants, cell: Cell, missed: Scalars, allowed: RealScalarLike) -> RealScalarLike:
    """The error in the sliding variable, and in each state of a plant in its own coordinates, over what is allowed."""
    loop, right = constants.problem.loop, cell.right
    if isinstance(loop.plant, AbstractPlant):
        return loop.control.surface(tuple(map(jnp.abs, missed))) / allowed
    in_errors = jax.jvp(lambda *x: loop.errors(right.t, x), right.x, missed)[1]
    parts = [loop.control.surface(tuple(map(jnp.abs, in_errors))) / allowed]
    for a, b, wrong in zip(cell.left.x, right.x, missed, strict=True):
        size = jnp.maximum(jnp.abs(a), jnp.abs(b))
        parts.append(jnp.abs(wrong) / (constants.rtol * size + constants.atol))
    return ft.reduce(jnp.maximum, parts)


def _misread(constants: LoopConstants, cell: Cell) -> RealScalarLike:
    r"""By how much the peak of $z = \sigma/\rho$ in a cell may be read wrongly off its cubic [-].

    The cubic is wrong where the funnel bends, for which its middle tells; and the peak is looked for where the parabola
    turns that has the slopes of both ends.
    """
    z, sigma, middle = cell.ratio(), cell.sigma(), cell.left.t + 0.5 * cell.length
    funnel = constants.problem.loop.control.funnel
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
    happens: tuple[BoolScalarLike, BoolScalarLike],
) -> LoopState:
    """What happens at the end of a cell: a command arrives, a sample is taken, a state is saved."""
    t, computer, commands, (is_captured, arrives) = state.now.t, state.computer, state.commands, happens
    if computer.queue is not None:
        place = place_in(computer.queue, computer.arrival)
        computer = dataclasses.replace(
            computer,
            held=jnp.where(arrives, computer.queue[place], computer.held),
            arrival=jnp.where(arrives, computer.arrival + 1.0, computer.arrival),
        )
    samples = is_captured & (t < constants.horizon)
    sampled, accumulated = sample(constants.problem, constants.implementation, state.now, computer, commands)
    computer = pytrees.where(samples, sampled, computer)
    commands = pytrees.where(samples, accumulated, commands)
    state = dataclasses.replace(state, computer=computer, commands=commands)
    saved = state.saved
    return state if saved is None else _save(constants, state, saved, has_event & (t >= _save_time(saved)))


def _save(constants: LoopConstants, state: LoopState, saved: Saved, is_time: BoolScalarLike) -> LoopState:
    """The signals at the time asked for, after whatever happened at it."""
    u = _drive(constants, state).input_at(state.now.t)
    place = jnp.where(is_time, saved.count, saved.u.shape[0])  # out of bounds: dropped
    x = tuple(old.at[place].set(xi, mode="drop") for old, xi in zip(saved.x, state.now.x, strict=True))
    count = saved.count + jnp.where(is_time, 1, 0)
    return dataclasses.replace(state, saved=Saved(saved.ts, x, saved.u.at[place].set(u, mode="drop"), count))


def _judged(constants: LoopConstants, state: LoopState) -> LoopState:
    """Whether the run goes on."""
    z = jnp.abs(state.now.ratio)
    goes_on = (
        (state.now.t < constants.horizon)
        & (z < state.farthest)
        & (state.steps < constants.max_steps)
        & (state.step > _SHORTEST_STEP * constants.horizon)
        & ~state.computer.has_overflown
    )
    return dataclasses.replace(state, is_running=state.is_running & goes_on)

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

from qsmc_jax.base import trees
from qsmc_jax.base.hermite import cubics
from qsmc_jax.base.lockstep import any_lane
from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.control.control import Sample
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.implementation.swing import held_swing
from qsmc_jax.numerics.unseen import Nodes, Step
from qsmc_jax.simulation.explicit import explicit_stages, weighted
from qsmc_jax.simulation.guard import Path, hidden_in_cell
from qsmc_jax.simulation.instant import Cell, Instant, at_instant
from qsmc_jax.simulation.sampled_tally import (
    CellTally,
    CommandTally,
    add_cell,
    add_command,
    first_cell_tally,
    first_command_tally,
)
from qsmc_jax.simulation.settings import INSTANT, SolverSettings, absolute_tolerance
from qsmc_jax.simulation.tally import Problem

# Bogacki and Shampine's pair of order 3(2): between samples, cells are short anyhow.
_TABLEAU = dfx.Bosh3.tableau
# Tolerance of the peak of |sigma| / rho, in units of the relative one.
_READING = 10.0
_NODES = Nodes(tuple(sorted({0.0, *map(float, _TABLEAU.c)})), few=(0.0, 0.5, 1.0))
# A run is lost once it is this many funnel widths away, or this many times as far as it started.
_LOST = 1000.0
_SHRINKS_BY, _GROWS_BY, _SAFETY = 0.2, 5.0, 0.9
_FIRST_STEP, _SHORTEST_STEP = 1e-2, 1e-14  # of the horizon


class Computer(AbstractModule):
    """The controller's side: what it keeps, and the commands under way.

    Attributes:
        memory: The law's own memory.
        sent: The last command computed.
        held: The command that the actuator has.
        sample: Number of the next sample.
        arrival: Number of the next command to arrive.
        queue: Commands under way, that of sample k at k modulo the length; None if none are ever.
        has_overflown: Whether more commands were under way than the queue holds.
    """

    memory: Scalars
    sent: RealScalarLike
    held: RealScalarLike
    sample: RealScalarLike
    arrival: RealScalarLike
    queue: Float[Array, " queue"] | None
    has_overflown: Bool[Array, ""]


class Saved(AbstractModule):
    """States and inputs at the times asked for, `ts`, and how many there are so far."""

    ts: Float[Array, " times"]
    x: tuple[Float[Array, " times"], ...]
    u: Float[Array, " times"]
    count: Int[Array, ""]


class Course(AbstractModule):
    """Everything that a run carries from cell to cell.

    Attributes:
        now: Where the loop is.
        actuator: State of the actuator; empty if there is none.
        computer: The controller's side.
        step: Length [s] of the longest cell that the tolerance allows, as far as is known.
        steps: Cells tried so far.
        is_running: Whether the run goes on.
        first_ratio: |sigma| / rho at the start.
        cells: Figures of the plant.
        commands: Figures of the commands.
        saved: States and inputs at the times asked for.
    """

    now: Instant
    actuator: Scalars
    computer: Computer
    step: RealScalarLike
    steps: RealScalarLike
    is_running: Bool[Array, ""]
    first_ratio: RealScalarLike
    cells: CellTally
    commands: CommandTally
    saved: Saved | None

    @property
    def starts_outside(self) -> BoolScalarLike:
        """Whether it started outside the funnel."""
        return jnp.asarray(self.first_ratio >= 1.0)

    @property
    def farthest(self) -> RealScalarLike:
        """How far out, in funnel widths, it counts as lost."""
        return _LOST * jnp.maximum(1.0, self.first_ratio)


class Plan(AbstractModule):
    """What stays the same from cell to cell."""

    problem: Problem
    implementation: Implementation
    horizon: RealScalarLike
    breaks: Float[Array, " breaks"]
    cutoff: RealScalarLike
    rtol: RealScalarLike
    max_steps: int


def run_sampled(
    problem: Problem,
    implementation: Implementation,
    x0: Scalars,
    horizon: RealScalarLike,
    is_admitted: BoolScalarLike,
    settings: SolverSettings,
    ts: Float[Array, " times"] | None,
) -> Course:
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
    plan, zero = _plan(problem, implementation, horizon, settings), jnp.zeros(())
    start = jax.tree.map(jnp.asarray, at_instant(problem, zero, tuple(map(jnp.asarray, x0))))
    computer = Computer(
        memory=tuple(map(jnp.asarray, problem.loop.control.first_memory())),
        sent=zero,
        held=zero,
        sample=zero,
        arrival=zero,
        queue=jnp.zeros((implementation.queue,)) if implementation.is_late else None,
        has_overflown=jnp.array(False),
    )
    first = Course(
        now=start,
        actuator=() if implementation.actuator is None else implementation.actuator.rest(),
        computer=computer,
        step=_FIRST_STEP * horizon,
        steps=zero,
        is_running=jnp.asarray(is_admitted),
        first_ratio=jnp.abs(start.sigma) / start.rho,
        cells=first_cell_tally(problem, start),
        commands=first_command_tally(),
        saved=None if ts is None else Saved(ts, (jnp.zeros_like(ts),) * len(x0), jnp.zeros_like(ts), jnp.array(0)),
    )
    start = first, any_lane(first.is_running)
    # The one kind of loop can be differentiated backwards, the other forwards; solving is the same.
    kind = "checkpointed" if settings.adjoint == "reverse" else "lax"
    advance = ft.partial(_in_step, plan)
    return eqxi.while_loop(_goes_on, advance, start, max_steps=settings.max_steps, kind=kind)[0]


def _goes_on(carry: tuple[Course, BoolScalarLike]) -> BoolScalarLike:
    return carry[1]


def _in_step(plan: Plan, carry: tuple[Course, BoolScalarLike]) -> tuple[Course, BoolScalarLike]:
    """All lanes one cell further; those that are done stay as they are."""
    course = _advance(plan, carry[0])
    return course, any_lane(course.is_running)


def _plan(problem: Problem, implementation: Implementation, horizon: RealScalarLike, settings: SolverSettings) -> Plan:
    loop, funnel = problem.loop, problem.loop.control.funnel
    # A cell ends just before a jump, and the next one, of no length, takes it.
    judged_from = jnp.stack([jnp.asarray(problem.reaching_time), jnp.asarray(problem.settling_time)])
    breaks = jnp.concatenate([problem.break_times, judged_from])
    fixed = jax.lax.stop_gradient(breaks)
    just_before = jnp.where(jnp.isfinite(fixed), jnp.nextafter(fixed, -jnp.inf) - fixed, 0.0)
    breaks = jnp.concatenate([breaks + just_before, breaks])
    degree = loop.order - 1
    rate = funnel.mu if degree == 0 else jnp.maximum(funnel.mu, jnp.abs(loop.control.surface.c[0]) ** (1.0 / degree))
    cutoff = 5.0 * rate if implementation.cutoff is None else implementation.cutoff
    return Plan(problem, implementation, horizon, breaks, cutoff, settings.rtol, settings.max_steps)


def _advance(plan: Plan, course: Course) -> Course:
    """One cell further, or a shorter try at the same one; then whatever happens at its end."""
    event, end = _next_event(plan, course)
    cell, actuator, error = _cross(plan, course, end)
    is_good = plan.problem.fence.claim(course.is_running & (error <= 1.0))
    h, tried = cell.length, course.step
    wanted = h * _step_factor(error)
    step = jnp.where(is_good & (h < tried), jnp.maximum(tried, wanted), wanted)
    cells = add_cell(plan.problem, plan.cutoff, course.cells, cell)
    steps = course.steps + jnp.where(course.is_running, 1.0, 0.0)
    counted = dataclasses.replace(course, step=jnp.where(course.is_running, step, tried), steps=steps)
    arrived = dataclasses.replace(counted, now=cell.right, actuator=actuator, cells=cells)
    return _judged(plan, _handle(plan, trees.where(is_good, arrived, counted), is_good & (end >= event)))


def _next_event(plan: Plan, course: Course) -> tuple[RealScalarLike, RealScalarLike]:
    """The time of the next event, and where the next cell ends: there, or at the end of one of equal parts."""
    t, implementation, computer = course.now.t, plan.implementation, course.computer
    event = jnp.minimum(plan.horizon, _capture_time(plan, course))
    if implementation.is_late:
        event = jnp.minimum(event, jnp.where(computer.arrival < computer.sample, _arrival_time(plan, course), jnp.inf))
    event = jnp.minimum(event, jnp.min(jnp.where(plan.breaks > t, plan.breaks, jnp.inf)))
    if course.saved is not None:
        event = jnp.minimum(event, _save_time(course.saved))
    left = event - t
    parts = jnp.ceil(left / course.step)
    return event, jnp.where(parts <= 1.0, event, t + left / jnp.maximum(parts, 1.0))


def _capture_time(plan: Plan, course: Course) -> RealScalarLike:
    """When the states of the next sample are measured: not before now."""
    instant = plan.implementation.instant(course.computer.sample)
    age = plan.implementation.measurement_delay
    return jnp.maximum(instant if age is None else instant - age, course.now.t)


def _arrival_time(plan: Plan, course: Course) -> RealScalarLike:
    """When the next command arrives at the actuator: not before now."""
    instant, delay = plan.implementation.instant(course.computer.arrival), plan.implementation.delay
    return jnp.maximum(instant if delay is None else instant + delay, course.now.t)


def _save_time(saved: Saved) -> RealScalarLike:
    """The next of the times asked for."""
    last = saved.ts.shape[0] - 1
    return jnp.where(saved.count <= last, saved.ts[jnp.minimum(saved.count, last)], jnp.inf)


def _cross(plan: Plan, course: Course, end: RealScalarLike) -> tuple[Cell, Scalars, RealScalarLike]:
    """The cell from now to `end`, the actuator there, and the estimated error in units of what is allowed."""
    loop, fence, now = plan.problem.loop, plan.problem.fence, course.now

    def actuator_at(t: RealScalarLike) -> Scalars:
        actuator = plan.implementation.actuator
        return () if actuator is None else actuator.move(course.actuator, course.computer.held, t - now.t)

    def input_at(t: RealScalarLike) -> RealScalarLike:
        return course.computer.held if plan.implementation.actuator is None else actuator_at(t)[0]

    def field(t: RealScalarLike, x: Scalars) -> Scalars:
        *chain, last = loop.rates(loop.terms(t, x), x, input_at(t))
        return (*chain, fence(last))

    u0 = input_at(now.t)  # which an actuator without a lag has changed since the last cell
    first = loop.rates(now.terms, now.x, u0)
    x1, stages = explicit_stages(_TABLEAU, field, now.t, end, now.x, first)
    right = at_instant(plan.problem, end, fence(x1))
    stages.append(loop.rates(right.terms, right.x, input_at(end)))
    h = end - now.t
    errors = loop.control.surface(tuple(jnp.abs(h * error) for error in weighted(_TABLEAU.b_error, stages)))
    speed = jnp.abs(now.sigma_rate(u0)) + jnp.abs(right.sigma_rate(input_at(end)))
    width, moved = plan.rtol * right.rho, INSTANT * end * speed
    allowed = plan.rtol * jnp.abs(right.sigma) + absolute_tolerance(width, course.cells.peak_ratio, moved)
    actuator, held = plan.implementation.actuator, course.computer.held
    swing = held_swing(held, h) if actuator is None else actuator.swing(course.actuator, held, h)
    cell = Cell(now, right, u0, input_at(now.t + 0.5 * h), input_at(end), swing)
    largest = ft.reduce(jnp.maximum, map(jnp.abs, (cell.u0, cell.middle, cell.u1)))
    path = _path(now, h, x1, first, stages[-1])
    hides = hidden_in_cell(plan.problem, plan.implementation, Step(now.t, end, _NODES), path, largest, plan.rtol)
    error = ft.reduce(jnp.maximum, (errors / allowed, hides**2, _misread(plan, cell) / (_READING * plan.rtol)))
    return cell, actuator_at(end), jnp.where(jnp.isfinite(error), error, jnp.inf)


def _misread(plan: Plan, cell: Cell) -> RealScalarLike:
    r"""By how much the peak of $z = \sigma/\rho$ in a cell may be read wrongly off its cubic [-].

    The cubic is wrong where the funnel bends, for which its middle tells; and the peak is looked for where the parabola
    turns that has the slopes of both ends.
    """
    z, sigma, middle = cell.ratio(), cell.sigma(), cell.left.t + 0.5 * cell.length
    bend, *_ = z.coefficients()
    return jnp.abs(z(0.5) - sigma(0.5) / plan.problem.loop.control.funnel(middle)) + 0.1 * jnp.abs(bend)


def _path(now: Instant, h: RealScalarLike, x1: Scalars, rates0: Scalars, rates1: Scalars) -> Path:
    """The state in a cell, by the cubic through its ends and their rates."""
    pieces = cubics(h, now.x, x1, rates0, rates1)
    inverse = jnp.where(h > 0.0, 1.0 / jnp.where(h > 0.0, h, 1.0), 0.0)
    return lambda t: tuple(cubic((t - now.t) * inverse) for cubic in pieces)


def _step_factor(error: RealScalarLike) -> RealScalarLike:
    """By how much the next step may be longer: a fourth root where a third would do, and roots are cheap."""
    root = jnp.sqrt(jnp.maximum(error, 1e-8))
    gentle = _SAFETY / jnp.sqrt(root)
    return jnp.clip(jnp.where(error > 1.0, _SAFETY / root, gentle), _SHRINKS_BY, _GROWS_BY)


def _handle(plan: Plan, course: Course, has_event: BoolScalarLike) -> Course:
    """What happens at the end of a cell: a command arrives, a sample is taken, a state is saved."""
    t, computer, commands = course.now.t, course.computer, course.commands
    if computer.queue is not None:
        arrives = has_event & (computer.arrival < computer.sample) & (t >= _arrival_time(plan, course))
        place = _place(computer.arrival, computer.queue)
        computer = dataclasses.replace(
            computer,
            held=jnp.where(arrives, computer.queue[place], computer.held),
            arrival=jnp.where(arrives, computer.arrival + 1.0, computer.arrival),
        )
    samples = has_event & (t >= _capture_time(plan, course)) & (t < plan.horizon)
    sampled, tallied = _sample(plan, course, computer)
    computer = trees.where(samples, sampled, computer)
    commands = trees.where(samples, tallied, commands)
    course = dataclasses.replace(course, computer=computer, commands=commands)
    saved = course.saved
    return course if saved is None else _save(plan, course, saved, has_event & (t >= _save_time(saved)))


def _sample(plan: Plan, course: Course, computer: Computer) -> tuple[Computer, CommandTally]:
    """The computer after one more sample, and the figures of its commands."""
    loop, implementation, now, k = plan.problem.loop, plan.implementation, course.now, computer.sample
    is_old = implementation.measurement_delay is not None
    is_exact = implementation.noise is None and implementation.measurement_resolution is None
    t = implementation.instant(k) if is_old else now.t
    rho = loop.control.funnel(t) if is_old else now.rho
    desired = loop.desired(t)
    if is_old or not is_exact:
        measured = implementation.measured(now.x, t, k)
        sigma = loop.control.surface(tuple(x - d for x, d in zip(measured, desired, strict=False)))
    else:
        sigma = now.sigma
    sample = Sample(t, implementation.sample_period, sigma, rho, desired, implementation.beyond)
    wanted, memory = loop.control.command(sample, computer.memory)
    command = plan.problem.fence(implementation.limited(wanted, computer.sent))
    is_steady = t >= plan.problem.reaching_time
    tallied = add_command(course.commands, command, computer.sent, implementation.sample_period, is_steady)
    new = dataclasses.replace(computer, memory=memory, sent=command, sample=k + 1.0)
    if computer.queue is None:
        return dataclasses.replace(new, held=command), tallied
    place = _place(k, computer.queue)
    is_full = k - computer.arrival >= computer.queue.shape[0]
    queue, has_overflown = computer.queue.at[place].set(command), computer.has_overflown | is_full
    return dataclasses.replace(new, queue=queue, has_overflown=has_overflown), tallied


def _place(k: RealScalarLike, queue: Float[Array, " queue"]) -> Int[Array, ""]:
    """Where in the queue the command of sample k lies."""
    return jnp.asarray(k % queue.shape[0]).astype(int)


def _save(plan: Plan, course: Course, saved: Saved, is_time: BoolScalarLike) -> Course:
    """The signals at the time asked for, after whatever happened at it."""
    actuator, held = plan.implementation.actuator, course.computer.held
    u = held if actuator is None else actuator.move(course.actuator, held, 0.0)[0]
    place = jnp.where(is_time, saved.count, saved.u.shape[0])  # out of bounds: dropped
    x = tuple(old.at[place].set(xi, mode="drop") for old, xi in zip(saved.x, course.now.x, strict=True))
    count = saved.count + jnp.where(is_time, 1, 0)
    return dataclasses.replace(course, saved=Saved(saved.ts, x, saved.u.at[place].set(u, mode="drop"), count))


def _judged(plan: Plan, course: Course) -> Course:
    """Whether the run goes on."""
    z = jnp.abs(course.now.sigma) / course.now.rho
    goes_on = (
        (course.now.t < plan.horizon)
        & (z < course.farthest)
        & (course.steps < plan.max_steps)
        & (course.step > _SHORTEST_STEP * plan.horizon)
        & ~course.computer.has_overflown
    )
    return dataclasses.replace(course, is_running=course.is_running & goes_on)

"""The one place that solves a run: a problem, a start and a horizon in, metrics (and signals) out."""

import functools as ft
from collections.abc import Hashable
from typing import Any

import diffrax as dfx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from qsmc_jax.base.checks import require
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, State
from qsmc_jax.control.error_bounds import peak_gains
from qsmc_jax.control.settling import settling_time
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.metrics.standard import Metrics
from qsmc_jax.model.recording import is_recorded
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.barrier import Barrier
from qsmc_jax.simulation.break_times import break_times
from qsmc_jax.simulation.ideal.accumulate import first_metrics
from qsmc_jax.simulation.ideal.coordinates import AbstractCoordinates
from qsmc_jax.simulation.ideal.guarded_solver import GuardedSolver, Run
from qsmc_jax.simulation.ideal.lifted import ChannelCoordinates, named_coordinates
from qsmc_jax.simulation.ideal.read import FinalState, read_metrics
from qsmc_jax.simulation.ideal.step_size import SAME_TIME, StepSize
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.problem import AbstractProblem, JointProblem, Problem
from qsmc_jax.simulation.sampled.loop import run_sampled
from qsmc_jax.simulation.sampled.read import read_sampled_metrics
from qsmc_jax.simulation.sampled.state import implementation_of
from qsmc_jax.simulation.settings import CHECKPOINTS, SolverSettings
from qsmc_jax.solvers.rosenbrock import RODAS4, RODAS5P, Rosenbrock
from qsmc_jax.solvers.tsit5 import Tsit5
from qsmc_jax.tracing.vectorise import vectorised

# The first step, as a part of the loop's time scale. It grows tenfold with every step kept.
_FIRST_STEP = 1e-3


def pose(
    loop: ClosedLoop | MultivariableLoop,
    x0: State,
    bandwidth: Any,
    settings: SolverSettings,
    made_of: Hashable = (),
    measures: tuple[AbstractMeasure, ...] = (),
) -> AbstractProblem:
    """The problem of solving a loop from a start: its thresholds and the coordinates that the settings name.

    Args:
        loop: The loop.
        x0: The start, n scalars.
        bandwidth: Bandwidth of quasi-sliding mode, in units of the sliding variable; of several channels one for all,
            or m of them.
        settings: The settings.
        made_of: Whatever tells loops apart that look alike, since what their functions read from outside differs.
        measures: The study's own metrics and requirements.
    """
    require(
        isinstance(loop, ClosedLoop) or settings.coordinates == "funnel" or loop.implementation is not None,
        'Setting `coordinates` must be "funnel" for an ideal loop with several inputs, which is solved in no other.',
    )
    barrier, kept = Barrier(settings.rtol / settings.rtol), (made_of, settings.rtol)
    if isinstance(loop, ClosedLoop):
        coordinates = named_coordinates(settings.coordinates, loop)
        return _posed(loop, x0, bandwidth, coordinates, barrier, *kept, measures)
    channels = tuple(
        _posed(each, x0, width, ChannelCoordinates(), barrier, *kept)
        for each, width in zip(loop.channels, loop.widths(bandwidth), strict=True)
    )
    return JointProblem(loop, channels, barrier, settings.rtol, measures)


def _posed(
    loop: ClosedLoop,
    x0: State,
    bandwidth: RealScalarLike,
    coordinates: AbstractCoordinates,
    barrier: Barrier,
    made_of: Hashable,
    rtol: RealScalarLike,
    measures: tuple[AbstractMeasure, ...] = (),
) -> Problem:
    surface, funnel = loop.control.surface, loop.control.funnel
    gains = peak_gains(surface.c)
    bounds = tuple(bandwidth * gains[i] for i in range(loop.order))
    return Problem(
        loop=loop,
        coordinates=coordinates,
        bandwidth=bandwidth,
        reaching_time=funnel.reaching_time(bandwidth),
        error_bounds=bounds,
        settling_time=settling_time(surface.c, funnel, bandwidth, bounds, loop.errors(0.0, x0)),
        barrier=barrier,
        made_of=made_of,
        rtol=rtol,
        measures=measures,
    )


def solve(
    problem: AbstractProblem,
    x0: State,
    t1: RealScalarLike,
    settings: SolverSettings,
    ts: Float[Array, " times"] | None = None,
    is_drawn_well: BoolScalarLike = True,
) -> tuple[Metrics, tuple[Array, ...] | None]:
    """Solves one run from time 0 to `t1`.

    Args:
        problem: From `pose`.
        x0: The start, n scalars.
        t1: The horizon [s], positive.
        settings: Method and tolerances.
        ts: Times [s] at which to save the integrated coordinates, sorted, within [0, t1].
        is_drawn_well: Whether what was drawn for the run had arguments in range; if not, it is refused.

    Returns:
        The metrics, and at `ts` the coordinates (an array each), or for a loop with an implementation the states and
        the inputs (an array each); meaningless after the end of a run that stopped early or was refused.
    """
    solver = _solve_ideal if problem.channels[0].loop.implementation is None else _solve_sampled
    solver = vectorised(solver) if settings.vectorise else solver
    return solver(problem, x0, t1, settings, ts, is_drawn_well)


def _solve_sampled(
    problem: AbstractProblem,
    x0: State,
    t1: RealScalarLike,
    settings: SolverSettings,
    ts: Float[Array, " times"] | None,
    is_drawn_well: BoolScalarLike,
) -> tuple[Metrics, tuple[Array, ...] | None]:
    horizon, is_fit = jnp.asarray(t1), is_drawn_well
    for each in problem.channels:
        is_fit = each.loop.control.is_valid() & implementation_of(each).is_valid(horizon) & is_fit
        is_fit = is_fit & is_recorded(each.loop, horizon)
    refused = jnp.where(is_fit, int(Outcome.COMPLETED), int(Outcome.BAD_PARAMETERS))
    state = run_sampled(problem, tuple(x0), horizon, is_fit, settings, ts)
    saved = None if state.saved is None else (*state.saved.x, *state.saved.u)
    return read_sampled_metrics(problem, refused, horizon, settings.max_steps, state), saved


def _solve_ideal(
    problem: AbstractProblem,
    x0: State,
    t1: RealScalarLike,
    settings: SolverSettings,
    ts: Float[Array, " times"] | None,
    is_drawn_well: BoolScalarLike,
) -> tuple[Metrics, tuple[Array, ...] | None]:
    refused = _refusal(problem, x0, t1, is_drawn_well)
    is_admitted = refused == Outcome.COMPLETED
    horizon = jnp.asarray(t1)
    # A refused run is given no time: it takes no step, and holds up nobody in its block.
    end = jnp.where(is_admitted, horizon, 0.0)
    times = None if ts is None else jnp.where(is_admitted, ts, 0.0)
    start = problem.start(x0)
    # Where that is not a number, the start itself will do: as it is, and where s comes beside it with a 0.
    y0 = pytrees.where(is_admitted, start, (*x0, *(0.0,) * len(problem.channels))[: len(start)])
    run0 = Run(y0, first_metrics(problem, y0))
    solution = dfx.diffeqsolve(
        dfx.ODETerm(_carry),
        GuardedSolver(_method(settings), settings),
        t0=jnp.zeros(()),
        t1=end,
        dt0=None,
        y0=run0,
        args=problem,
        saveat=_saveat(times),
        stepsize_controller=StepSize(
            break_times(problem.break_times, problem.barrier, SAME_TIME), _first_step(problem, x0, run0, horizon)
        ),
        max_steps=settings.max_steps,
        adjoint=dfx.ForwardMode() if settings.adjoint == "forward" else dfx.RecursiveCheckpointAdjoint(CHECKPOINTS),
        throw=False,
    )
    last, saved = solution.ys  # pyright: ignore[reportGeneralTypeIssues]  # None only if nothing is saved
    end_time, run = solution.ts[0][0], pytrees.first(last)  # pyright: ignore[reportOptionalSubscript]
    final = FinalState(
        refused=refused,
        horizon=horizon,
        end_time=end_time,
        run=run,
        rates=problem.vector_field(end_time, run.y),
        result=solution.result,
        first_heights=tuple(each.peak.height for each in run0.running.channels),
        steps=solution.stats["num_steps"],
    )
    return read_metrics(problem, final), saved


def _carry(t: RealScalarLike, run: Run, problem: AbstractProblem) -> Run:
    """The vector field over the whole integrated state; the solver itself only ever asks for that of `y`."""
    return Run(problem.vector_field(t, run.y), pytrees.zeros_like(run.running))


def _first_step(problem: AbstractProblem, x0: State, run0: Run, horizon: RealScalarLike) -> RealScalarLike:
    r"""A part of the time that the loop needs to answer, $2 \rho / (\pi |g| \cosh^2 s)$, and of the horizon."""
    answers = [
        jnp.abs(each.loop.gain(0.0, x0)) * (1.0 + running.input.sinh**2) / each.loop.control.funnel(0.0)
        for each, running in zip(problem.channels, run0.running.channels, strict=True)
    ]
    return jax.lax.stop_gradient(_FIRST_STEP / (1.0 / horizon + ft.reduce(jnp.maximum, answers)))


def _refusal(problem: AbstractProblem, x0: State, t1: RealScalarLike, is_drawn_well: BoolScalarLike) -> Int[Array, ""]:
    """COMPLETED if the premises at the start hold, else the outcome that names the broken one."""
    starts_inside, is_fit = [], is_drawn_well
    for each in problem.channels:
        control = each.loop.control
        sigma = each.loop.sliding_variable(0.0, x0) - control.funnel.centre(0.0)
        starts_inside.append(jnp.abs(sigma) < control.funnel(0.0))
        is_fit = is_fit & is_recorded(each.loop, t1) & control.is_valid()
    inside = ft.reduce(jnp.logical_and, starts_inside)
    code = jnp.where(inside, int(Outcome.COMPLETED), int(Outcome.STARTED_OUTSIDE))
    return jnp.where(is_fit, code, int(Outcome.BAD_PARAMETERS))


def _method(settings: SolverSettings) -> Tsit5 | Rosenbrock:
    implicit = {"rodas4": RODAS4, "rodas5p": RODAS5P}
    if settings.method not in implicit:
        return Tsit5()
    return Rosenbrock(implicit[settings.method], Barrier(settings.rtol / settings.rtol))


def _saveat(ts: Float[Array, " times"] | None) -> dfx.SaveAt:
    end = dfx.SubSaveAt(t1=True)
    along = None if ts is None else dfx.SubSaveAt(ts=ts, fn=lambda t, run, args: run.y)
    return dfx.SaveAt(subs=(end, along))

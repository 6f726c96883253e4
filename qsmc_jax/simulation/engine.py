"""The one place that solves a run: a problem, a start and a horizon in, metrics (and signals) out."""

from collections.abc import Hashable
from typing import cast

import diffrax as dfx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, State
from qsmc_jax.control.error_bounds import peak_gains
from qsmc_jax.control.settling import settling_time
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.metrics.standard import Metrics
from qsmc_jax.model.recording import is_recorded
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.barrier import Barrier
from qsmc_jax.simulation.break_times import break_times
from qsmc_jax.simulation.ideal.accumulate import first_metrics
from qsmc_jax.simulation.ideal.guarded_solver import GuardedSolver, Run
from qsmc_jax.simulation.ideal.lifted import named_coordinates
from qsmc_jax.simulation.ideal.read import FinalState, read_metrics
from qsmc_jax.simulation.ideal.step_size import SAME_TIME, StepSize
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.problem import Problem
from qsmc_jax.simulation.sampled.loop import run_sampled
from qsmc_jax.simulation.sampled.read import read_sampled_metrics
from qsmc_jax.simulation.settings import CHECKPOINTS, SolverSettings
from qsmc_jax.solvers.rosenbrock import RODAS4, RODAS5P, Rosenbrock
from qsmc_jax.solvers.tsit5 import Tsit5
from qsmc_jax.tracing.vectorise import vectorised

# The first step, as a part of the loop's time scale. It grows tenfold with every step kept.
_FIRST_STEP = 1e-3


def pose(
    loop: ClosedLoop,
    x0: State,
    bandwidth: RealScalarLike,
    settings: SolverSettings,
    made_of: Hashable = (),
    measures: tuple[AbstractMeasure, ...] = (),
) -> Problem:
    """The problem of solving a loop from a start: its thresholds and the coordinates that the settings name.

    Args:
        loop: The loop.
        x0: The start, n scalars.
        bandwidth: Bandwidth of quasi-sliding mode, in units of the sliding variable.
        settings: The settings.
        made_of: Whatever tells loops apart that look alike, since what their functions read from outside differs.
        measures: The study's own metrics and requirements.
    """
    surface, funnel = loop.control.surface, loop.control.funnel
    gains = peak_gains(surface.c)
    bounds = tuple(bandwidth * gains[i] for i in range(loop.order))
    return Problem(
        loop=loop,
        coordinates=named_coordinates(settings.coordinates, loop),
        bandwidth=bandwidth,
        reaching_time=funnel.reaching_time(bandwidth),
        error_bounds=bounds,
        settling_time=settling_time(surface.c, funnel, bandwidth, bounds, loop.errors(0.0, x0)),
        barrier=Barrier(settings.rtol / settings.rtol),
        made_of=made_of,
        rtol=settings.rtol,
        measures=measures,
    )


def solve(
    problem: Problem,
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
        The metrics, and at `ts` the coordinates (n arrays), or for a loop with an implementation the states and the
        input (n + 1 arrays); meaningless after the end of a run that stopped early or was refused.
    """
    solver = _solve_ideal if problem.loop.implementation is None else _solve_sampled
    solver = vectorised(solver) if settings.vectorise else solver
    return solver(problem, x0, t1, settings, ts, is_drawn_well)


def _solve_sampled(
    problem: Problem,
    x0: State,
    t1: RealScalarLike,
    settings: SolverSettings,
    ts: Float[Array, " times"] | None,
    is_drawn_well: BoolScalarLike,
) -> tuple[Metrics, tuple[Array, ...] | None]:
    horizon, implementation = jnp.asarray(t1), cast(Implementation, problem.loop.implementation)
    is_fit = problem.loop.control.is_valid() & implementation.is_valid(horizon) & is_drawn_well
    is_fit = is_fit & is_recorded(problem.loop, horizon)
    refused = jnp.where(is_fit, int(Outcome.COMPLETED), int(Outcome.BAD_PARAMETERS))
    state = run_sampled(problem, implementation, tuple(x0), horizon, is_fit, settings, ts)
    saved = None if state.saved is None else (*state.saved.x, state.saved.u)
    return read_sampled_metrics(problem, refused, horizon, settings.max_steps, state), saved


def _solve_ideal(
    problem: Problem,
    x0: State,
    t1: RealScalarLike,
    settings: SolverSettings,
    ts: Float[Array, " times"] | None,
    is_drawn_well: BoolScalarLike,
) -> tuple[Metrics, tuple[Array, ...] | None]:
    refused = _refusal(problem, x0, is_drawn_well & is_recorded(problem.loop, t1))
    is_admitted = refused == Outcome.COMPLETED
    horizon = jnp.asarray(t1)
    # A refused run is given no time: it takes no step, and holds up nobody in its block.
    end = jnp.where(is_admitted, horizon, 0.0)
    times = None if ts is None else jnp.where(is_admitted, ts, 0.0)
    start = problem.coordinates.start(problem.loop, x0)
    # Where that is not a number, the start itself will do: as it is, and where s comes beside it with a 0.
    y0 = pytrees.where(is_admitted, start, (*x0, 0.0)[: len(start)])
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
    final = FinalState(
        refused=refused,
        horizon=horizon,
        end_time=solution.ts[0][0],  # pyright: ignore[reportOptionalSubscript]
        run=pytrees.first(last),
        result=solution.result,
        first_height=run0.running.peak.height,
        steps=solution.stats["num_steps"],
    )
    return read_metrics(problem, final), saved


def _carry(t: RealScalarLike, run: Run, problem: Problem) -> Run:
    """The vector field over the whole integrated state; the solver itself only ever asks for that of `y`."""
    return Run(problem.coordinates.vector_field(t, run.y, problem.loop), pytrees.zeros_like(run.running))


def _first_step(problem: Problem, x0: State, run0: Run, horizon: RealScalarLike) -> RealScalarLike:
    r"""A part of the time that the loop needs to answer, $2 \rho / (\pi |g| \cosh^2 s)$, and of the horizon."""
    answer = jnp.abs(problem.loop.gain(0.0, x0)) * (1.0 + run0.running.input.sinh**2) / problem.loop.control.funnel(0.0)
    return jax.lax.stop_gradient(_FIRST_STEP / (1.0 / horizon + answer))


def _refusal(problem: Problem, x0: State, is_drawn_well: BoolScalarLike) -> Int[Array, ""]:
    """COMPLETED if the premises at the start hold, else the outcome that names the broken one."""
    control = problem.loop.control
    sigma = problem.loop.sliding_variable(0.0, x0) - control.funnel.centre(0.0)
    starts_inside = jnp.abs(sigma) < control.funnel(0.0)
    code = jnp.where(starts_inside, int(Outcome.COMPLETED), int(Outcome.STARTED_OUTSIDE))
    return jnp.where(control.is_valid() & is_drawn_well, code, int(Outcome.BAD_PARAMETERS))


def _method(settings: SolverSettings) -> Tsit5 | Rosenbrock:
    implicit = {"rodas4": RODAS4, "rodas5p": RODAS5P}
    return Rosenbrock(implicit[settings.method]) if settings.method in implicit else Tsit5()


def _saveat(ts: Float[Array, " times"] | None) -> dfx.SaveAt:
    end = dfx.SubSaveAt(t1=True)
    along = None if ts is None else dfx.SubSaveAt(ts=ts, fn=lambda t, run, args: run.y)
    return dfx.SaveAt(subs=(end, along))

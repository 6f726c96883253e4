"""The solver of the closed loop: a diffrax method, a guard, and the running metrics."""

import functools as ft
from collections.abc import Callable, Iterable
from typing import Any, ClassVar

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.enclosures.unseen import Step as Stretch
from qsmc_jax.numerics import pytrees
from qsmc_jax.simulation.guard import hidden
from qsmc_jax.simulation.ideal.accumulate import Running, RunningMetrics, add_step
from qsmc_jax.simulation.ideal.step import Step
from qsmc_jax.simulation.problem import AbstractProblem, JointProblem, Problem
from qsmc_jax.simulation.settings import INSTANT, SolverSettings, absolute_tolerance
from qsmc_jax.simulation.stiffness import steepness
from qsmc_jax.solvers.rosenbrock import Rosenbrock
from qsmc_jax.solvers.tsit5 import Tsit5, derivative_at_start

# |s| at which a run ends: 1 - |sigma|/rho = 1e-13, an input of 5e12. Only a loop whose input does not push back gets
# there.
ESCAPE = 30.0
# |s| beyond which a candidate step is refused rather than kept: cosh(s) sinh(s) stays far from overflow.
FARTHEST = 2.0 * ESCAPE
# Largest decay in a step of the explicit method: there it damps a deviation by half or better, and never alternates.
_STABLE = 3.3
# Power by which a step beyond it counts as an error.
_STABLE_STEEPNESS = 8


class Run(eqx.Module):
    """The integrated state: coordinates `y`, which the method advances, and the running metrics, which ride along."""

    y: Scalars
    running: Running


class StepError(eqx.Module):
    """What is wrong with a step, in units of what is tolerated: its local error, and what it may hide."""

    local: RealScalarLike
    hidden: RealScalarLike


class _RunInterpolation(dfx.AbstractLocalInterpolation):
    """The method's own interpolant for `y`; the running metrics are those of the step's end."""

    inner: dfx.AbstractLocalInterpolation
    running: Running

    @property
    def t0(self) -> RealScalarLike:
        return self.inner.t0

    @property
    def t1(self) -> RealScalarLike:
        return self.inner.t1

    def evaluate(self, t0: RealScalarLike, t1: RealScalarLike | None = None, left: bool = True) -> Run:
        return Run(self.inner.evaluate(t0, t1, left), self.running)


class GuardedSolver(dfx.AbstractAdaptiveSolver):
    """Advances `y` by `method`, refuses what is not finite or too far out, and brings the running metrics up to date.

    A refused candidate reports an infinite error and the old state. diffrax alone turns an infinite candidate into a
    NaN step factor, and tries the same step for ever (0.7.2). The method must be one whose solver state is the
    derivative at the start of its next step, and whose dense output is quartic: `Tsit5` or `Rosenbrock`. Errors are
    reported in units of what is tolerated, so that the step size controller has to hold them below 1.

    Attributes:
        method: The method.
        settings: The tolerances.
    """

    method: Tsit5 | Rosenbrock
    settings: SolverSettings

    term_structure: ClassVar = dfx.AbstractTerm

    @property
    def interpolation_cls(  # pyright: ignore[reportIncompatibleMethodOverride]  # diffrax's own wrapping solvers do so too
        self,
    ) -> Callable[..., _RunInterpolation]:
        def interpolation(*, t0: RealScalarLike, t1: RealScalarLike, inner: Any, running: Running) -> _RunInterpolation:
            return _RunInterpolation(inner=self.method.interpolation_cls(t0=t0, t1=t1, **inner), running=running)

        return interpolation

    def order(self, terms: Any) -> int | None:
        return self.method.order(terms)

    def func(self, terms: Any, t0: RealScalarLike, y0: Run, args: AbstractProblem) -> Run:
        return Run(_field(t0, y0.y, args), pytrees.zeros_like(y0.running))

    def init(self, terms: Any, t0: RealScalarLike, t1: RealScalarLike, y0: Run, args: AbstractProblem) -> Any:
        return self.method.init(_TERM, t0, t1, y0.y, args)

    def step(
        self,
        terms: Any,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Run,
        args: AbstractProblem,
        solver_state: Any,
        made_jump: Any,
    ) -> tuple[Run, StepError, dict[str, Any], Any, dfx.RESULTS]:
        rate0 = derivative_at_start(_TERM, t0, y0.y, args, solver_state, made_jump)
        y1, error, dense, rate1, result = self.method.step(_TERM, t0, t1, y0.y, args, rate0, False)
        farthest = _largest(jnp.abs(each.coordinates.funnel_coordinate(each.loop, t1, y1)) for each in args.channels)
        is_sound = pytrees.is_finite((y1, error, rate1)) & (farthest <= FARTHEST)
        kept1, rate1 = pytrees.where(is_sound, (y1, rate1), (y0.y, rate0))
        running = _ADD_STEP(args, y0.running, Step(t0, t1, **{**dense, "y1": kept1}, derivative=rate1))
        moved = tuple(INSTANT * t1 * (jnp.abs(a) + jnp.abs(b)) for a, b in zip(rate0, rate1, strict=True))
        peak = _largest(each.peak.height for each in running.channels)
        local = self._in_tolerances(args, error, y0.y, kept1, peak, moved)
        if not isinstance(self.method, Rosenbrock):
            local = jnp.maximum(local, (_decay(args, t0, t1, running, kept1) / _STABLE) ** _STABLE_STEEPNESS)
        step, ys = Stretch(t0, t1, self.method.nodes), (y0.y, dense["middle"], y1)
        ends = list(zip(y0.running.channels, running.channels, strict=True))
        sinhs, us = ([_sizes(pair, name) for pair in ends] for name in ("sinh", "u"))
        unseen = hidden(args, step, ys, sinhs, us, self.settings.rtol, self.settings.atol / self.settings.rtol)
        y1, error = kept1, StepError(jnp.where(is_sound, local, jnp.inf), unseen)
        has_escaped = is_sound & (farthest >= ESCAPE)
        result = dfx.RESULTS.where(has_escaped, dfx.RESULTS.event_occurred, result)
        return Run(y1, running), error, {"inner": dense, "running": running}, rate1, result

    def _in_tolerances(
        self, problem: AbstractProblem, error: Scalars, y0: Scalars, y1: Scalars, peak: RealScalarLike, moved: Scalars
    ) -> RealScalarLike:
        """The largest error, in units of what is tolerated."""
        size = tuple(jnp.maximum(jnp.abs(a), jnp.abs(b)) for a, b in zip(y0, y1, strict=True))
        parts = zip(error, moved, *problem.tolerances(size, self.settings), strict=True)
        return ft.reduce(jnp.maximum, [jnp.abs(e) / (r + absolute_tolerance(a, peak, m)) for e, m, r, a in parts])


@eqx.filter_jit  # so that its many calls in a step are traced once
def _field(t: RealScalarLike, y: Scalars, problem: AbstractProblem) -> Scalars:
    return problem.barrier(problem.vector_field(t, y))


def _sizes(pair: tuple[RunningMetrics, RunningMetrics], name: str) -> tuple[RealScalarLike, RealScalarLike]:
    """The size of the input, or of sinh s, at both ends of a step."""
    before, after = (jnp.abs(getattr(each.input, name)) for each in pair)
    return before, after


def _largest(values: Iterable[RealScalarLike]) -> RealScalarLike:
    return ft.reduce(jnp.maximum, values)


def _decay(
    problem: AbstractProblem, t0: RealScalarLike, t1: RealScalarLike, end: Running, y1: Scalars
) -> RealScalarLike:
    """By how much a deviation decays within a step [-], by its end; of several channels a bound of the fastest mode."""
    pairs = list(zip(problem.channels, end.channels, strict=True))
    if not isinstance(problem, JointProblem):
        rate = _largest(_decay_rate(each, t1, y1, last, jnp.abs(last.gain)) for each, last in pairs)
        return jax.lax.stop_gradient((t1 - t0) * rate)
    # diag(a) B diag(b) is similar to diag(r) B diag(r) with r^2 = ab: no mode is faster than a row's sum.
    roots = [jnp.sqrt(_decay_rate(each, t1, y1, last, 1.0)) for each, last in pairs]
    rows = problem.loop.decoupling(t1, y1[: problem.loop.states])
    sums = (sum(jnp.abs(b) * root for b, root in zip(row, roots, strict=True)) for row in rows)
    rate = _largest(root * total for root, total in zip(roots, sums, strict=True))
    return jax.lax.stop_gradient((t1 - t0) * rate)


def _decay_rate(
    problem: Problem, t1: RealScalarLike, y1: Scalars, end: RunningMetrics, gain: RealScalarLike
) -> RealScalarLike:
    r"""The rate of that decay for a gain g: $|g| K \frac{\pi}{2\rho} \cosh 2s$ for s.

    For a law of the user's it is that of the sliding variable.
    """
    law = problem.loop.control
    if isinstance(law, QuasiSlidingControl):
        return gain * law.gain_at(t1) * (0.5 * jnp.pi) * (1.0 + 2.0 * end.input.sinh**2) / law.funnel(t1)
    deviation = law.surface(end.errors) - law.funnel.centre(t1)
    x1 = problem.coordinates.state(problem.loop, t1, y1)
    return gain * steepness(problem.loop, t1, x1, end.errors, problem.loop.desired(t1, x1), deviation)


_TERM = dfx.ODETerm(_field)
_ADD_STEP = eqx.filter_jit(add_step)  # for the same reason: diffrax traces a step three times

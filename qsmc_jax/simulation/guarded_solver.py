"""The solver of the closed loop: a diffrax method, a guard, and the tally."""

from collections.abc import Callable
from typing import Any, ClassVar

import diffrax as dfx
import equinox as eqx
import jax.numpy as jnp

from qsmc_jax.base import trees
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.simulation.rosenbrock import Rosenbrock
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.tally import Problem, Step, Tally, add_step
from qsmc_jax.simulation.tsit5 import derivative_at_start

# |s| at which a run ends: 1 - |sigma|/rho = 1e-13, an input of 5e12. Only a loop whose input does not push back gets
# there.
ESCAPE = 30.0
# |s| beyond which a candidate step is refused rather than kept: cosh(s) sinh(s) stays far from overflow.
FARTHEST = 2.0 * ESCAPE


class Run(eqx.Module):
    """The integrated state: coordinates `y`, which the method advances, and the tally, which rides along."""

    y: Scalars
    tally: Tally


class _RunInterpolation(dfx.AbstractLocalInterpolation):
    """The method's own interpolant for `y`; the tally is that of the step's end."""

    inner: dfx.AbstractLocalInterpolation
    tally: Tally

    @property
    def t0(self) -> RealScalarLike:
        return self.inner.t0

    @property
    def t1(self) -> RealScalarLike:
        return self.inner.t1

    def evaluate(self, t0: RealScalarLike, t1: RealScalarLike | None = None, left: bool = True) -> Run:
        return Run(self.inner.evaluate(t0, t1, left), self.tally)


class GuardedSolver(dfx.AbstractAdaptiveSolver):
    """Advances `y` by `method`, refuses what is not finite or too far out, and brings the tally up to date.

    A refused candidate reports an infinite error and the old state. diffrax alone turns an infinite candidate into a
    NaN step factor, and tries the same step for ever (0.7.2). The method must be one whose solver state is the
    derivative at the start of its next step, and whose dense output is quartic: `Tsit5` or `Rosenbrock`. Errors are
    reported in units of what is tolerated, so that the step size controller has to hold them below 1.

    Attributes:
        method: The method.
        settings: The tolerances.
    """

    method: dfx.AbstractAdaptiveSolver
    settings: SolverSettings

    term_structure: ClassVar = dfx.AbstractTerm

    @property
    def interpolation_cls(  # pyright: ignore[reportIncompatibleMethodOverride]  # diffrax's own wrapping solvers do so too
        self,
    ) -> Callable[..., _RunInterpolation]:
        def interpolation(*, t0: RealScalarLike, t1: RealScalarLike, inner: Any, tally: Tally) -> _RunInterpolation:
            return _RunInterpolation(inner=self.method.interpolation_cls(t0=t0, t1=t1, **inner), tally=tally)

        return interpolation

    def order(self, terms: Any) -> int | None:
        return self.method.order(terms)

    def func(self, terms: Any, t0: RealScalarLike, y0: Run, args: Problem) -> Run:
        return Run(_field(t0, y0.y, args), trees.zeros_like(y0.tally))

    def init(self, terms: Any, t0: RealScalarLike, t1: RealScalarLike, y0: Run, args: Problem) -> Any:
        return self.method.init(_TERM, t0, t1, y0.y, args)

    def step(
        self,
        terms: Any,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Run,
        args: Problem,
        solver_state: Any,
        made_jump: Any,
    ) -> tuple[Run, Run, dict[str, Any], Any, dfx.RESULTS]:
        rate0 = derivative_at_start(_TERM, t0, y0.y, args, solver_state, made_jump)
        y1, error, dense, rate1, result = self.method.step(_TERM, t0, t1, y0.y, args, rate0, False)
        s1 = args.coordinates.funnel_coordinate(args.loop, t1, y1)
        is_sound = trees.is_finite((y1, error, rate1)) & (jnp.abs(s1) <= FARTHEST)
        if isinstance(self.method, Rosenbrock):
            is_sound = is_sound & ~_hides_growth(args, t0, t1, (y0.y, dense["middle"], y1))
        y1, rate1 = trees.where(is_sound, (y1, rate1), (y0.y, rate0))
        tally = _ADD_STEP(args, y0.tally, Step(t0, t1, **{**dense, "y1": y1}, derivative=rate1))
        error = Run(self._in_tolerances(args, error, y0.y, y1), trees.zeros_like(tally))
        error = trees.where(is_sound, error, trees.full_like(error, jnp.inf))
        has_escaped = is_sound & (jnp.abs(s1) >= ESCAPE)
        result = dfx.RESULTS.where(has_escaped, dfx.RESULTS.event_occurred, result)
        return Run(y1, tally), error, {"inner": dense, "tally": tally}, rate1, result

    def _in_tolerances(self, problem: Problem, error: Scalars, y0: Scalars, y1: Scalars) -> Scalars:
        size = tuple(jnp.maximum(jnp.abs(a), jnp.abs(b)) for a, b in zip(y0, y1, strict=True))
        tolerances = problem.coordinates.tolerances(size, self.settings)
        return tuple(each / tolerance for each, tolerance in zip(error, tolerances, strict=True))


@eqx.filter_jit  # so that its many calls in a step are traced once
def _field(t: RealScalarLike, y: Scalars, problem: Problem) -> Scalars:
    return problem.fence(problem.coordinates.vector_field(t, y, problem.loop))


def _hides_growth(
    problem: Problem, t0: RealScalarLike, t1: RealScalarLike, ys: tuple[Scalars, Scalars, Scalars]
) -> BoolScalarLike:
    """Whether sigma grows in the step, since the gain has the wrong sign, too fast for an implicit method to show it.

    Such methods damp whatever is fast, growth included: a loop at rest would seem to stay there. The gain is looked at
    where the step starts, halfway and where it ends, given the coordinates there.
    """
    loop, h = problem.loop, t1 - t0
    growth = jnp.zeros(())
    for t, y in zip((t0, t0 + 0.5 * h, t1), ys, strict=True):
        outward = -loop.control.gain_sign * loop.plant.gain(t, problem.coordinates.state(loop, t, y))
        growth = jnp.maximum(growth, outward)
    return h * growth * (0.5 * jnp.pi) / loop.control.funnel(t1) > 1.0


_TERM = dfx.ODETerm(_field)
_ADD_STEP = eqx.filter_jit(add_step)  # likewise: diffrax traces a step three times

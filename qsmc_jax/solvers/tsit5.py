"""Tsitouras' explicit method of order 5, on a state of scalars, with its stages written out."""

from typing import Any, ClassVar

import diffrax as dfx
import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.enclosures.unseen import Nodes
from qsmc_jax.solvers.explicit import explicit_stages, weighted
from qsmc_jax.solvers.quartic_interpolation import QuarticInterpolation

_TABLEAU = dfx.Tsit5.tableau
# Weights of the stages in the method's interpolant at the middle of the step.
_MIDDLE = (
    0.10741235230096871,
    0.01135625,
    0.39560903056045305,
    -0.34475214352593553,
    1.3161853649581645,
    -1.0170608542936508,
    0.03125,
)


class Tsit5(dfx.AbstractAdaptiveSolver):
    """The method of `diffrax.Tsit5`, with its numbers and its interpolant, for states that are tuples of scalars.

    The solver state is the derivative at the start of the next step.

    Source: Tsitouras (2011), Runge-Kutta pairs of order 5(4) satisfying only the first column simplifying assumption.
    """

    nodes: ClassVar = Nodes(tuple(sorted({0.0, *map(float, _TABLEAU.c)})), few=(0.0, float(_TABLEAU.c[1]), 1.0))
    term_structure: ClassVar = dfx.AbstractTerm
    interpolation_cls: ClassVar = QuarticInterpolation

    def order(self, terms: Any) -> int:
        return 5

    def func(self, terms: Any, t0: RealScalarLike, y0: Scalars, args: Any) -> Scalars:
        return terms.vf(t0, y0, args)

    def init(self, terms: Any, t0: RealScalarLike, t1: RealScalarLike, y0: Scalars, args: Any) -> Scalars:
        return terms.vf(t0, y0, args)

    def step(
        self,
        terms: Any,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Scalars,
        args: Any,
        solver_state: Scalars,
        made_jump: Any,
    ) -> tuple[Scalars, Scalars, dict[str, Any], Scalars, dfx.RESULTS]:
        h = t1 - t0
        first = derivative_at_start(terms, t0, y0, args, solver_state, made_jump)
        y1, stages = explicit_stages(_TABLEAU, lambda t, y: terms.vf(t, y, args), t0, t1, y0, first)
        stages.append(terms.vf(t1, y1, args))
        error = tuple(h * change for change in weighted(_TABLEAU.b_error, stages))
        middle = tuple(y + h * change for y, change in zip(y0, weighted(_MIDDLE, stages), strict=True))
        dense = {"y0": y0, "y1": y1, "dy0": stages[0], "dy1": stages[-1], "middle": middle}
        return y1, error, dense, stages[-1], dfx.RESULTS.successful


def derivative_at_start(
    terms: Any, t0: RealScalarLike, y0: Scalars, args: Any, known: Scalars, made_jump: Any
) -> Scalars:
    """The derivative where a step starts: known from the last one, unless the field has jumped there."""
    if made_jump is False:
        return known
    return tuple(jnp.where(made_jump, new, old) for new, old in zip(terms.vf(t0, y0, args), known, strict=True))

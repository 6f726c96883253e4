"""The stages of an explicit Runge-Kutta method on a state of scalars, written out."""

from collections.abc import Callable
from typing import Any

from qsmc_jax.base.types import RealScalarLike, Scalars


def explicit_stages(
    tableau: Any,
    field: Callable[[RealScalarLike, Scalars], Scalars],
    t0: RealScalarLike,
    t1: RealScalarLike,
    y0: Scalars,
    first: Scalars,
) -> tuple[Scalars, list[Scalars]]:
    """The state at the end of a step, and the derivatives in all stages but the last, which is the end.

    Where diffrax keeps the stages in an array and each is a product with it, here they are scalars, which XLA turns
    into well-vectorised loops under `vmap`: two thirds of the time.

    Args:
        tableau: The `tableau` of a solver of diffrax.
        field: The derivative at a time and state.
        t0: Start of the step.
        t1: End of the step.
        y0: State at its start.
        first: Derivative there.
    """
    h, stages = t1 - t0, [first]
    for node, weights in zip(tableau.c[:-1], tableau.a_lower[:-1], strict=True):
        stages.append(field(t1 if node == 1.0 else t0 + node * h, _moved(y0, h, weights, stages)))
    return _moved(y0, h, tableau.a_lower[-1], stages), stages


def _moved(y0: Scalars, h: RealScalarLike, weights: Any, stages: list[Scalars]) -> Scalars:
    return tuple(y + h * change for y, change in zip(y0, weighted(weights, stages), strict=True))


def weighted(weights: Any, stages: list[Scalars]) -> Scalars:
    """The sum of the stages with the given weights, component by component."""
    used = [(float(weight), stage) for weight, stage in zip(weights, stages, strict=False) if weight != 0.0]
    return tuple(sum(weight * stage[i] for weight, stage in used) for i in range(len(stages[0])))

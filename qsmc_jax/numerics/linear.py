"""Small linear systems, written out entry by entry: under `vmap` every operation is one over all lanes."""

from typing import Any, NamedTuple

import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.numerics.barrier import Barrier


class Factors(NamedTuple):
    """A matrix after Gaussian elimination with pairwise pivoting: a row gives way to a later one with a larger pivot.

    Attributes:
        upper: Rows of the upper triangle, from the diagonal on.
        steps: What was done to the rows, in order: (upper row, lower row, whether they were exchanged, multiplier).
        once: Around what is used more than once; None where it costs more than it saves.
    """

    upper: list[list[RealScalarLike]]
    steps: list[tuple[int, int, Any, RealScalarLike]]
    once: Barrier | None = None


def eliminate(matrix: list[list[RealScalarLike]], once: Barrier | None = None) -> Factors:
    """Eliminates below the diagonal of a square matrix, given by its rows; a singular one leaves zeros or NaN.

    Args:
        matrix: The rows.
        once: Around what the next column needs; without it XLA works out each entry anew for all that come from it,
            which doubles with every column.
    """
    rows, steps = [list(row) for row in matrix], []
    for k in range(len(rows)):
        if once is not None and k > 0:
            rows[k:] = once(rows[k:])
        for i in range(k + 1, len(rows)):
            is_larger = jnp.abs(rows[i][k]) > jnp.abs(rows[k][k])
            rows[k], rows[i] = _exchanged(is_larger, rows[k], rows[i], start=k)
            multiplier = rows[i][k] / rows[k][k]
            rows[i] = [x if j <= k else x - multiplier * rows[k][j] for j, x in enumerate(rows[i])]
            steps.append((k, i, is_larger, multiplier))
    return Factors([row[k:] for k, row in enumerate(rows)], steps, once)


def substitute(factors: Factors, sides: Scalars) -> Scalars:
    """The solution for the given right-hand sides."""
    b, once = list(sides), factors.once
    b = b if once is None else once(b)
    for k, i, is_exchanged, multiplier in factors.steps:
        b[k], b[i] = jnp.where(is_exchanged, b[i], b[k]), jnp.where(is_exchanged, b[k], b[i])
        b[i] = b[i] - multiplier * b[k]
    b = b if once is None else once(b)
    for k in reversed(range(len(b))):
        diagonal, *others = factors.upper[k]
        known = sum(u * x for u, x in zip(others, b[k + 1 :], strict=True))
        b[k] = (b[k] - known) / diagonal
    return tuple(b)


def _exchanged(condition: Any, upper: list[Any], lower: list[Any], start: int) -> tuple[list[Any], list[Any]]:
    """The two rows, exchanged from entry `start` on where the condition holds."""
    first = [x if j < start else jnp.where(condition, y, x) for j, (x, y) in enumerate(zip(upper, lower, strict=True))]
    second = [y if j < start else jnp.where(condition, x, y) for j, (x, y) in enumerate(zip(upper, lower, strict=True))]
    return first, second

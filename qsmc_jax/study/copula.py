"""Matrices by which numbers are drawn together: the Gaussian copula, and checks of a covariance or correlation."""

from typing import Any

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import is_traced, require, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import as_float64
from qsmc_jax.study import quantiles
from qsmc_jax.study.specs import require_fixed

# By how much a matrix that was worked out may be off: `np.corrcoef` leaves a diagonal of 1 - 1e-16.
_ROUNDING = 1e-12


class Copula:
    r"""Correlates coordinates of the unit cube: $u_i = \Phi(z_i)$ with $z = L \xi$, $\xi_i = \Phi^{-1}$ (coordinate i).

    L is the Cholesky factor of the correlation matrix, so that the i-th depends on the first i coordinates alone.

    Source: Nelsen, An Introduction to Copulas, section 2.
    """

    def __init__(self, factor: Float[np.ndarray, "n n"]):
        """Starts at the first number.

        Args:
            factor: The Cholesky factor.
        """
        self._factor = factor
        self._independent: list[Any] = []

    @property
    def left(self) -> int:
        """How many numbers are still to be drawn."""
        return len(self._factor) - len(self._independent)

    def correlated(self, name: str, u: Any) -> Any:
        """Independent coordinates made dependent on those before."""
        self._require_room(name, u.size)
        scores = [self._advance(xi) for xi in quantiles.score(u).reshape(-1)]
        return quantiles.probability(as_float64(scores)).reshape(u.shape)

    def independent(self, name: str, u: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The other way round: the independent coordinates, and what `correlated` makes of them, rounding included."""
        self._require_room(name, u.size)
        free, again = [], []
        for z in quantiles.score(u).reshape(-1):
            row, i = self._factor[len(self._independent)], len(self._independent)
            free.append(quantiles.probability((z - self._before(row)) / row[i]))
            again.append(self._advance(quantiles.score(free[-1])))
        return np.reshape(free, u.shape), np.asarray(quantiles.probability(np.reshape(again, u.shape)))

    def _advance(self, xi: Any) -> Any:
        row = self._factor[len(self._independent)]
        z = self._before(row) + row[len(self._independent)] * xi
        self._independent.append(xi)
        return z

    def _before(self, row: np.ndarray) -> Any:
        return sum((weight * xi for weight, xi in zip(row, self._independent, strict=False)), np.float64(0.0))

    def _require_room(self, name: str, count: int) -> None:
        require(
            count <= self.left,
            f"Argument `correlation` must have a row for every number that is drawn under it, but has "
            f"{len(self._factor)}: too few for `{name}`.",
        )


def factor_of(argument: str, matrix: Any, count: int | None = None) -> Float[np.ndarray, "n n"]:
    """The Cholesky factor of a symmetric positive definite matrix.

    Args:
        argument: The argument, as messages name it.
        matrix: The matrix, fixed numbers.
        count: How many rows it must have; None for any.

    Raises:
        InputError: It is none, or its numbers depend on draws.
    """
    require_fixed(argument, matrix)
    matrix = as_float64(matrix)
    is_square = matrix.ndim == 2 and matrix.shape[0] == matrix.shape[1] > 0
    wanted = "a square matrix" if count is None else f"a matrix of {count} rows and columns"
    fits = is_square and count in (None, len(matrix))
    require(fits, f"Argument `{argument}` must be {wanted}, but has shape {matrix.shape}.")
    require(bool(np.isfinite(matrix).all()), f"Argument `{argument}` must be finite, but is {show(matrix)}.")
    is_symmetric = bool(np.all(abs(matrix - matrix.T) <= _ROUNDING * abs(matrix).max()))
    require(is_symmetric, f"Argument `{argument}` must be symmetric, but is {show(matrix)}. Take (m + m.T) / 2.")
    try:
        return np.linalg.cholesky((matrix + matrix.T) / 2)
    except np.linalg.LinAlgError:
        least = np.linalg.eigvalsh(matrix)[0]
        raise InputError(
            f"Argument `{argument}` must be positive definite, but its least eigenvalue is {least:.3g}. Draw fewer, "
            "and work out by a formula what they determine."
        ) from None


def correlation_factor(matrix: Any) -> Float[np.ndarray, "n n"]:
    """The Cholesky factor of a correlation matrix.

    Args:
        matrix: The matrix, fixed numbers.

    Raises:
        InputError: It is none.
    """
    if not is_traced(matrix):
        numbers = as_float64(matrix)
        inside = bool(np.all(abs(numbers) <= 1 + _ROUNDING))
        require(inside, f"Argument `correlation` must have entries in [-1, 1], but is {show(numbers)}.")
        diagonal = np.diag(numbers) if numbers.ndim == 2 else np.ones(1)
        ones = bool(np.all(abs(diagonal - 1) <= _ROUNDING))
        require(ones, f"Argument `correlation` must have 1 on its diagonal, but has {show(diagonal)}.")
    return factor_of("correlation", matrix)

"""Small linear systems against NumPy, with the exchanges that they need."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qsmc_jax.numerics.linear import eliminate, substitute


@jax.jit
def solve(matrix, sides):
    size = len(sides)
    rows = [[matrix[i, j] for j in range(size)] for i in range(size)]
    return jnp.stack(substitute(eliminate(rows), tuple(sides)))


@pytest.mark.parametrize("size", range(1, 9))
@pytest.mark.slow
def test_solution_is_numpys(size):
    random = np.random.default_rng(size)
    for _ in range(20):
        matrix, x = random.normal(size=(size, size)), random.normal(size=size)
        # Backward stable: the residual is small whatever the condition.
        residual = matrix @ solve(matrix, matrix @ x) - matrix @ x
        assert np.max(np.abs(residual)) < 1e-12 * np.max(np.abs(matrix)) * size * (1 + np.max(np.abs(x)))


@pytest.mark.parametrize("scale", [1e-300, 1e-20, 1.0])
def test_small_pivot_is_exchanged(scale):
    matrix = np.array([[scale * 1e-18, 1.0, 0.0], [1.0, 1.0, 2.0], [0.0, 3.0, 1.0]])
    x = np.array([1.0, -2.0, 3.0])
    np.testing.assert_allclose(solve(matrix, matrix @ x), x, rtol=1e-14)


def test_singular_matrix_gives_no_finite_solution():
    assert not np.all(np.isfinite(solve(np.ones((2, 2)), np.array([1.0, 2.0]))))

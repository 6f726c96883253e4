r"""The loop linearised where it rests: polynomials of its stability, and the positive roots that bound it.

Time is in units of $1 / k'$, so that the loop is $L(s) = \sum_m a_m / s^m$, m = 1 ... n, with $a_1 = 1$.
"""

import itertools as it
import math

import numpy as np
from jaxtyping import Float
from numpy.polynomial import Polynomial
from scipy import optimize

from qsmc_jax.numerics.hurwitz import is_hurwitz

_TINY = 1e-300  # absolute tolerance of root finding: none, the relative one decides


def is_stable(a: Float[np.ndarray, " n"]) -> bool:
    """Whether the ideal loop is."""
    return bool(is_hurwitz(a[::-1]))


def loop_parts(a: Float[np.ndarray, " n"]) -> tuple[Polynomial, Polynomial]:
    r"""$\mathrm{Re} L$ and $-\omega \mathrm{Im} L$ at $s = j \omega$, polynomials in $y = 1 / \omega^2$."""
    signed = a * (-1.0) ** (np.arange(1, len(a) + 1) // 2)
    return Polynomial([0.0, *signed[1::2]]), Polynomial(signed[0::2])


def positive_roots(polynomial: Polynomial) -> list[float]:
    """The positive roots at which the sign changes: one between turning points, which come from the derivative."""
    coefficients = polynomial.trim().coef
    if len(coefficients) == 1:
        return []
    powers = 1.0 / np.arange(len(coefficients) - 1, 0, -1)
    bound = 2.0 * float(np.max(np.abs(coefficients[:-1] / coefficients[-1]) ** powers))  # Fujiwara's
    knots = [0.0, *positive_roots(polynomial.trim().deriv()), bound]
    cells = [(low, high) for low, high in it.pairwise(knots) if (polynomial(low) < 0) != (polynomial(high) < 0)]
    return [float(optimize.brentq(polynomial, *cell, xtol=_TINY, maxiter=2000)) for cell in cells]


def sampled_loop(a: Float[np.ndarray, " n"]) -> list[Polynomial]:
    r"""The coefficients, lowest first, of the sampled loop's polynomial in s; each a polynomial in the period."""
    order = len(a)
    table = np.zeros((order + 1, order + 1))
    table[order, 0] = 1.0
    for m in range(1, order + 1):
        for j, value in enumerate(_held_integrators(m).coef):
            table[order - m + j, j] += a[m - 1] * value / 2.0**j
    return [Polynomial(row) for row in table]


def _held_integrators(m: int) -> Polynomial:
    r"""$(1 - v)^m B_m(z) / m!$ with $z = (1 + v) / (1 - v)$ and the Eulerian polynomial $B_m$."""
    row = [1]
    for i in range(2, m + 1):
        row = [(j + 1) * right + (i - j) * left for j, (left, right) in enumerate(it.pairwise([0, *row, 0]))]
    plus, minus = Polynomial([1.0, 1.0]), Polynomial([1.0, -1.0])
    terms = (number * plus**j * minus ** (m - j) for j, number in enumerate(row))
    return sum(terms, start=Polynomial([0.0])) / math.factorial(m)


def hurwitz_matrix(coefficients: list[Polynomial]) -> list[list[Polynomial]]:
    """Hurwitz's matrix of size n - 1 for a polynomial of degree n, lowest coefficient first."""
    n = len(coefficients) - 1
    padded = [Polynomial([0.0])] * n + coefficients + [Polynomial([0.0])] * n
    return [[padded[n + n - 2 * j + i - 1] for j in range(n - 1)] for i in range(n - 1)]


def determinant(rows: list[list[Polynomial]]) -> Polynomial:
    """The determinant of a small matrix of polynomials, by its first row."""
    total = Polynomial([1.0 if not rows else 0.0])
    for j, entry in enumerate(rows[0] if rows else []):
        if np.any(entry.coef):
            total += (-1.0) ** j * entry * determinant([row[:j] + row[j + 1 :] for row in rows[1:]])
    return total

"""How errors are boxed: a flow that remembers where they started, and coordinates in which the rest decays."""

from collections.abc import Sequence

import numpy as np

from qsmc_jax.control.error_bounds import poles
from qsmc_jax.proof.field import Mode

# Roots nearer than this, relative to their size, are taken as one of several.
_SAME = 1e-3


def frame_for(c: Sequence[float]) -> np.ndarray:
    r"""The lower triangular matrix Q of coordinates $v = Q E$ in which boxes decay.

    $p(s) = \prod_k (s + \lambda_k) \prod_j ((s + a_j)^2 + b_j^2)$ makes a cascade,
    $v_{k+1} = \dot v_k + \lambda_k v_k$, and for a pair $v_{k+1} = \dot v_k + a v_k$,
    $v_{k+2} = \dot v_{k+1} + a v_{k+1} + b^2 v_k$. Boxes of a pair decay if b < a; otherwise they grow.

    Args:
        c: Coefficients of the surface.
    """
    order = len(c)
    rows = [np.eye(1, order)[0]]
    for root in sorted(poles(np.asarray(c, float)), key=lambda root: -root.real):
        rate = -root.real
        if root.imag > 0.0:  # its pair stands for both
            middle = _derived(rows[-1]) + rate * rows[-1]
            rows += [middle, _derived(middle) + rate * middle + root.imag**2 * rows[-1]]
        elif root.imag == 0.0:
            rows.append(_derived(rows[-1]) + rate * rows[-1])
    return np.array(rows[:order]).reshape(order, order)


def _derived(row: np.ndarray) -> np.ndarray:
    """The rate of a combination of errors along the chain."""
    return np.concatenate([[0.0], row[:-1]])


def modes_for(c: Sequence[float]) -> list[Mode]:
    r"""The functions and matrices of $e^{A t}$, A the companion matrix of the surface, as near as doubles come.

    Args:
        c: Coefficients of the surface.
    """
    order = len(c)
    if order == 0:
        return []
    found: list[list[complex]] = []
    for root in sorted((r for r in poles(np.asarray(c, float)) if r.imag >= 0.0), key=lambda r: (r.imag > 0.0, r.real)):
        near = [group for group in found if abs(root - group[0]) <= _SAME * abs(root)]
        near[0].append(root) if near else found.append([root])
    functions: list[tuple[int, float, float, bool]] = []
    for group in found:
        mean = complex(np.mean(group))
        for power in range(len(group)):
            kinds = (False, True) if mean.imag else (False,)
            functions += [(power, -mean.real, mean.imag, is_sine) for is_sine in kinds]
    a = np.vstack([np.eye(order)[1:], -np.asarray(c, float)])
    derivatives = np.array([_derivatives(*function, order) for function in functions]).T
    powers = np.array([np.linalg.matrix_power(a, k).ravel() for k in range(order)])
    matrices = np.linalg.lstsq(derivatives, powers, rcond=None)[0].reshape(-1, order, order)
    return [Mode(*function, matrix) for function, matrix in zip(functions, matrices, strict=True)]


def _derivatives(power: int, rate: float, frequency: float, is_sine: bool, count: int) -> list[float]:
    """The first derivatives at 0 of t**power exp(-rate t) cos or sin(frequency t)."""
    root = complex(-rate, frequency)
    found = []
    for k in range(count):
        falling = np.prod(np.arange(k - power + 1, k + 1), initial=1.0) if k >= power else 0.0
        value = falling * root ** max(k - power, 0)
        found.append(value.imag if is_sine else value.real)
    return found

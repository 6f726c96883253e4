"""Inverse CDFs, written once for NumPy and for JAX: what takes a coordinate of the unit cube to a drawn number."""

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp
import jax.scipy.special
import numpy as np
import scipy.special

from qsmc_jax.base.checks import is_traced
from qsmc_jax.study.tabulated import LEAST, Tabulated

# Into how many parts the cube is cut when the coordinate of a value is searched.
_PARTS = 64


class Library(NamedTuple):
    """The functions the inverse CDFs are written with."""

    xp: ModuleType
    ndtr: Callable[[Any], Any]
    ndtri: Callable[[Any], Any]


# What is not traced stays in NumPy: JAX would round it outside a 64-bit context, and compiles for seconds op by op
_NUMPY = Library(np, scipy.special.ndtr, scipy.special.ndtri)
_JAX = Library(jnp, jax.scipy.special.ndtr, jax.scipy.special.ndtri)


def evaluate(quantile: Callable[..., Any], u: Any, *arguments: Any) -> Any:
    """The inverse CDF at `u`, by JAX if anything is traced."""
    if is_traced(u, arguments):
        return quantile(_JAX, _guarded(_JAX, u), *arguments)
    with np.errstate(all="ignore"):  # of arguments out of range, which JAX takes without a word too
        return quantile(_NUMPY, _guarded(_NUMPY, np.asarray(u, dtype=np.float64)), *arguments)


def _guarded(lib: Library, u: Any) -> Any:
    """`u` moved off the ends of (0, 1), where an inverse CDF may be infinite, to the nearest number inside."""
    limits = jnp.finfo(u.dtype)
    return lib.xp.clip(u, limits.tiny, 1 - limits.epsneg)


def uniform(lib: Library, u: Any, low: Any, high: Any) -> Any:
    """Inverse CDF as a weighted mean, which cannot overflow; clipped, since rounding may pass an end."""
    return lib.xp.clip(low * (1 - u) + high * u, low, high)


def log_uniform(lib: Library, u: Any, low: Any, high: Any) -> Any:
    """Inverse CDF of the log-uniform distribution; clipped in the same way."""
    return lib.xp.clip(lib.xp.exp(lib.xp.log(low) * (1 - u) + lib.xp.log(high) * u), low, high)


def normal(lib: Library, u: Any, mean: Any, std: Any) -> Any:
    """Inverse CDF."""
    return mean + std * lib.ndtri(u)


def truncated_normal(lib: Library, u: Any, mean: Any, std: Any, low: Any, high: Any) -> Any:
    """Inverse CDF between the CDF at the ends, mirrored if need be into the lower tail, where it keeps its digits."""
    a, b = (low - mean) / std, (high - mean) / std
    is_upper = a + b > 0
    p, q = lib.ndtr(lib.xp.where(is_upper, -b, a)), lib.ndtr(lib.xp.where(is_upper, -a, b))
    v = lib.xp.where(is_upper, 1 - u, u)
    z = lib.ndtri(_guarded(lib, p * (1 - v) + q * v))
    return lib.xp.clip(mean + std * lib.xp.where(is_upper, -z, z), low, high)


def triangular(lib: Library, u: Any, low: Any, mode: Any, high: Any) -> Any:
    """Inverse CDF by its two branches; the root not taken gets 1, or its derivative at 0 would be NaN."""
    is_left = u < (mode - low) / (high - low)
    left = lib.xp.sqrt(lib.xp.where(is_left, u * (high - low) * (mode - low), 1.0))
    right = lib.xp.sqrt(lib.xp.where(is_left, 1.0, (1 - u) * (high - low) * (high - mode)))
    return lib.xp.clip(lib.xp.where(is_left, low + left, high - right), low, high)


def exponential(lib: Library, u: Any, mean: Any) -> Any:
    """Inverse CDF."""
    return -mean * lib.xp.log1p(-u)


def lognormal(lib: Library, u: Any, median: Any, log_std: Any) -> Any:
    """Inverse CDF."""
    return median * lib.xp.exp(log_std * lib.ndtri(u))


def weibull(lib: Library, u: Any, k: Any, scale: Any) -> Any:
    """Inverse CDF."""
    return scale * (-lib.xp.log1p(-u)) ** (1 / k)


def choice(lib: Library, u: Any, values: Any, edges: Any = None) -> Any:
    """The entry of `values` in whose cell `u` lies; each as wide as the others, unless the ends of the cells are given.

    A cell has its lower end and not its upper one, so that one without width is never met.
    """
    if edges is None:
        count = len(values)
        return lib.xp.asarray(values)[lib.xp.minimum((u * count).astype(int), count - 1)]
    return lib.xp.asarray(values)[_count_below(u, edges)]


def tabulated(lib: Library, u: Any, table: Tabulated, low: Any, high: Any, shift: Any = 0.0, scale: Any = 1.0) -> Any:
    """Inverse CDF by a table, within its support; see tabulated.py."""
    u = lib.xp.clip(u, LEAST, 1 - LEAST)
    w = lib.xp.log(u) - lib.xp.log1p(-u)
    edges, coefficients = lib.xp.asarray(table.edges), lib.xp.asarray(table.coefficients)
    piece = _count_below(w, table.edges[1:-1])
    start, end = edges[piece], edges[piece + 1]
    x = (2 * w - start - end) / (end - start)
    # Clenshaw's recurrence.
    terms = coefficients[piece]
    later, latest = lib.xp.zeros_like(x), lib.xp.zeros_like(x)
    for i in range(terms.shape[-1] - 1, 0, -1):
        later, latest = terms[..., i] + 2 * x * later - latest, later
    return shift + scale * lib.xp.clip(terms[..., 0] + x * later - latest, low, high)


def _count_below(x: Any, edges: np.ndarray) -> Any:
    """How many of the edges lie at or below each number."""
    return (x[..., None] >= edges.reshape((1,) * x.ndim + (-1,))).sum(axis=-1)


def score(u: Any) -> Any:
    """The standard normal number that is not exceeded with probability `u`."""
    return evaluate(normal, u, 0.0, 1.0)


def probability(z: Any) -> Any:
    """That a standard normal number does not exceed `z`."""
    return (_JAX if is_traced(z) else _NUMPY).ndtr(z)


def inverse(quantile: Callable[..., Any], value: np.ndarray, *arguments: Any) -> np.ndarray:
    """The coordinates of given values: where `quantile` comes as near to them as it can.

    Args:
        quantile: One of the above.
        value: Values, of the shape that `quantile` gives them.
        *arguments: Its other arguments, numbers.
    """
    return (_cell if quantile is choice else _bisected)(quantile, value, *arguments)


def _cell(_: Any, value: np.ndarray, rows: np.ndarray, edges: np.ndarray | None = None) -> np.ndarray:
    """The middle of the first cell that holds each value; that of the cube where none does."""
    rows = np.asarray(rows)
    ends = np.linspace(0.0, 1.0, len(rows) + 1) if edges is None else np.array([0.0, *edges, 1.0])
    flat = value.reshape(-1, *rows.shape[1:])
    is_met = (flat[:, None] == rows).reshape(len(flat), len(rows), -1).all(axis=2) & (ends[1:] > ends[:-1])
    found = np.where(is_met.any(axis=1), ((ends[1:] + ends[:-1]) / 2)[is_met.argmax(axis=1)], 0.5)
    return found.reshape(value.shape[: value.ndim - rows.ndim + 1])


def _bisected(quantile: Callable[..., Any], value: np.ndarray, *arguments: Any) -> np.ndarray:
    """By search among all numbers of (0, 1) in the order of their bits, cut into 64 parts each time."""
    limits = np.finfo(np.float64)
    low, high = (np.full((*value.shape, 1), end).view(np.int64) for end in (limits.tiny, 1 - limits.epsneg))
    while np.any(high - low > 1):
        tried = np.minimum(low + np.maximum((high - low) // _PARTS, 1) * np.arange(_PARTS), high)
        is_below = evaluate(quantile, tried.view(np.float64), *arguments) < value[..., None]
        last = np.maximum(is_below.sum(axis=-1, keepdims=True) - 1, 0)
        ends = np.concatenate([tried, high], axis=-1)
        low, high = (np.take_along_axis(ends, each, axis=-1) for each in (last, last + 1))
    both = np.concatenate([low, high], axis=-1).view(np.float64)
    distance = abs(evaluate(quantile, both, *arguments) - value[..., None])
    return np.take_along_axis(both, distance.argmin(axis=-1)[..., None], axis=-1)[..., 0]

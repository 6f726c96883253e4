"""Inverse CDFs, written once for NumPy and for JAX: what takes a coordinate of the unit cube to a drawn number."""

from collections.abc import Callable
from types import ModuleType
from typing import Any, NamedTuple

import jax.numpy as jnp
import jax.scipy.special
import numpy as np
import scipy.special

from qsmc_jax.base.checks import is_traced


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


def choice(lib: Library, u: Any, values: Any) -> Any:
    """The entry of `values` that `u` falls on, each as wide as the others."""
    count = len(values)
    return lib.xp.asarray(values)[lib.xp.minimum((u * count).astype(int), count - 1)]

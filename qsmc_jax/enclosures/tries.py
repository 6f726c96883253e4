"""Points of a box at which an operation is tried that has no interval rule."""

import math
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.enclosures.intervals import Enclosed, Interval, Truth, is_point

# Points of the box at which a primitive without a rule is tried: two ends, the middle, corners, and others within.
_CORNERS, TRIES = 6, 33
_GOLDEN = 0.5 * (math.sqrt(5.0) - 1.0)


def within(value: Enclosed, operand: int, k: int) -> Any:
    """The k-th point of an operand's box at which a primitive is tried: its ends, its middle, a corner, or within."""
    if is_point(value):
        return value
    is_truth = isinstance(value, Truth)
    low, high = (jnp.logical_not(value.may_not), value.may) if is_truth else value
    places = (np.arange(np.size(low)).reshape(np.shape(low)) + 1.0 + _GOLDEN * operand) * (k * _GOLDEN)
    shares = np.full(np.shape(low), (0.0, 1.0, 0.5)[k]) if k < 3 else places % 1.0
    if k >= 3 and k < _CORNERS or not jnp.issubdtype(jnp.result_type(low), jnp.inexact):
        return jnp.where(shares < 0.5, low, high)
    inner = low + jnp.asarray(shares, low.dtype) * (high - low)
    return jnp.where(shares == 0.0, low, jnp.where(shares == 1.0, high, inner))


def hull_of_points(points: Any) -> Enclosed:
    """The least enclosure of the rows of an array; of complex numbers by real and imaginary parts."""
    if points.dtype == bool:
        return Truth(jnp.any(points, axis=0), ~jnp.all(points, axis=0))
    if jnp.issubdtype(points.dtype, jnp.complexfloating):
        real, imaginary = hull_of_points(points.real), hull_of_points(points.imag)
        return Interval(*(jax.lax.complex(*ends) for ends in zip(real, imaginary, strict=True)))
    return Interval(jnp.min(points, axis=0), jnp.max(points, axis=0))

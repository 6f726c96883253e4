"""The last step in which something was the case, as accumulators of both loops keep it."""

import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.numerics.hermite import Cubic


class OutsideStep(AbstractModule):
    """A step in which something was at least a level somewhere, such as |sigma| the bandwidth, and its course in it."""

    start: RealScalarLike
    length: RealScalarLike
    cubic: Cubic


class Span(AbstractModule):
    """A step by the times [s] at which it starts and ends; both are 0 if there is none."""

    start: RealScalarLike
    end: RealScalarLike


def is_since(last: Span, time: RealScalarLike) -> Bool[Array, ""]:
    """Whether there is such a step at all, and it starts at the given time or later."""
    return jnp.asarray((last.end > 0.0) & (last.start >= time))


def last_outside(outside: OutsideStep, level: RealScalarLike, end_time: RealScalarLike) -> Float[Array, ""]:
    """The last time at which |p| is at least `level`, given the last step in which it is: 0 if none, inf at the end."""
    ends_outside = (jnp.abs(outside.cubic.y1) >= level) & (outside.start + outside.length >= end_time)
    crossed = outside.start + outside.cubic.last_descent(level) * outside.length
    return jnp.where(outside.length > 0.0, jnp.where(ends_outside, jnp.inf, crossed), 0.0)

"""How the ends of a computed interval are rounded."""

import enum
from typing import Any

import jax.numpy as jnp


class Rounding(enum.Enum):
    """To the nearest number, as the machine does, or outward, so that the computed interval holds the exact one.

    Outward takes each rounded operation of IEEE arithmetic to be right to half a unit in the last place, and elementary
    functions to a few units, which the tests of the elementary functions measure.
    """

    NEAREST = "nearest"
    OUTWARD = "outward"

    def __call__(self, ends: Any, units: int = 1) -> Any:
        """The interval, widened if need be by so many units in the last place.

        Args:
            ends: An interval, lower and upper end.
            units: Units in the last place by which either may be wrong.
        """
        if self is Rounding.NEAREST or not jnp.issubdtype(jnp.result_type(ends[0]), jnp.inexact):
            return ends
        low, high = ends
        # The machine takes numbers below the smallest normal one for zero.
        relative, absolute = (units - 1) * jnp.finfo(low.dtype).eps, jnp.finfo(low.dtype).tiny
        down = jnp.nextafter(low - relative * jnp.abs(low) - absolute, -jnp.inf)
        up = jnp.nextafter(high + relative * jnp.abs(high) + absolute, jnp.inf)
        return type(ends)(jnp.where(jnp.isinf(low), low, down), jnp.where(jnp.isinf(high), high, up))

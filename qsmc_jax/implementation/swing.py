"""What an input does over a stretch of time."""

from typing import NamedTuple

import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike


class Swing(NamedTuple):
    """What an input does over a stretch of time.

    Attributes:
        variation: Its total variation.
        low: Its least value, both ends included.
        high: Its largest.
        area: Its integral.
        energy: The integral of its square.
    """

    variation: RealScalarLike
    low: RealScalarLike
    high: RealScalarLike
    area: RealScalarLike
    energy: RealScalarLike


def held_swing(command: RealScalarLike, dt: RealScalarLike) -> Swing:
    """That of an input that stands still.

    Args:
        command: The command that is held.
        dt: Time [s] that passes.
    """
    return Swing(jnp.zeros_like(dt), command, command, dt * command, dt * command**2)

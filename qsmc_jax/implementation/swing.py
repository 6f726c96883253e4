"""What an input does over a stretch of time."""

from typing import NamedTuple

import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike


class Swing(NamedTuple):
    """What an input does over a stretch of time: its total variation, its largest size, the integral of its square."""

    variation: RealScalarLike
    peak: RealScalarLike
    energy: RealScalarLike


def held_swing(command: RealScalarLike, dt: RealScalarLike) -> Swing:
    """That of an input that stands still.

    Args:
        command: The command that is held.
        dt: Time [s] that passes.
    """
    return Swing(jnp.zeros_like(dt), jnp.abs(command), dt * command**2)

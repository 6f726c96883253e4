"""What drives the plant between two events: the command that is held, through the actuator if there is one."""

from typing import NamedTuple

import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.implementation.actuators import AbstractActuator
from qsmc_jax.implementation.swing import Swing, held_swing
from qsmc_jax.simulation.settings import INSTANT


class Drive(NamedTuple):
    """An actuator, or none, its state at the time `now` [s], and the command that it has."""

    actuator: AbstractActuator | None
    state: Scalars
    held: RealScalarLike
    now: RealScalarLike

    def state_at(self, t: RealScalarLike) -> Scalars:
        """The actuator's state at time t."""
        return () if self.actuator is None else self.actuator.move(self.state, self.held, t - self.now)

    def input_at(self, t: RealScalarLike) -> RealScalarLike:
        """The plant's input at time t."""
        return self.held if self.actuator is None else self.state_at(t)[0]

    def swing(self, dt: RealScalarLike) -> Swing:
        """What the plant's input does in a time `dt` [s] from now."""
        return held_swing(self.held, dt) if self.actuator is None else self.actuator.swing(self.state, self.held, dt)

    def kinks(self) -> Scalars:
        """When the input has a kink; one within an instant is past, or a cell up to it would be followed by another."""
        kinks = () if self.actuator is None else self.actuator.kinks(self.state_at(self.now), self.held)
        return tuple(jnp.where(after > INSTANT * self.now, self.now + after, jnp.inf) for after in kinks)

"""What every actuator can do, and what those can that never pass their command."""

import abc

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.implementation.swing import Swing

# How near, in parts of the numbers that it is a difference of, an actuator is where it was going: there, but for
# rounding. A kink that it has been brought to must not be found again.
THERE = 1e-13


class AbstractActuator(AbstractModule):
    """What is between command and input. It is at rest, with input 0, at time 0.

    Examples:
        >>> import qsmc_jax as qj
        >>> actuator = qj.actuators.FirstOrderLag(time_constant=0.0)
        >>> isinstance(actuator, qj.actuators.AbstractActuator)
        True
        >>> [float(u) for u in actuator.move(actuator.rest(), command=2.0, dt=0.1)]
        [2.0]
    """

    @abc.abstractmethod
    def rest(self) -> Scalars:
        """Its state at rest; the first component is the input."""

    @abc.abstractmethod
    def move(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Scalars:
        """Its state a time `dt` [s] later, under a constant command.

        Args:
            state: What `rest` or an earlier `move` gave.
            command: The command that is held.
            dt: Time [s] that passes, not negative.
        """

    @abc.abstractmethod
    def swing(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Swing:
        """What the input does meanwhile, exactly: however fast it is, nothing of it is read off a grid.

        Args:
            state: What `rest` or an earlier `move` gave.
            command: The command that is held.
            dt: Time [s] that passes, not negative.
        """

    @abc.abstractmethod
    def kinks(self, state: Scalars, command: RealScalarLike) -> Scalars:
        """Times [s] until the input's motion has a kink, in any order, under a constant command: `inf` if it has none.

        The plant is integrated up to each kink and on from there, never across one. One at which the actuator is, but
        for rounding, is past.

        Args:
            state: What `move` gave for this command.
            command: The command that is held.
        """

    @abc.abstractmethod
    def is_valid(self) -> BoolScalarLike:
        """Whether its numbers are in range: what the constructor checks, for traced ones."""


class AbstractMonotoneActuator(AbstractActuator):
    """An actuator of one state, its input, which moves straight to where the command sends it, never beyond.

    Examples:
        >>> import qsmc_jax as qj
        >>> isinstance(qj.actuators.RateLimited(0.1, 5.0), qj.actuators.AbstractMonotoneActuator)
        True
        >>> isinstance(qj.actuators.SecondOrderLag(10.0), qj.actuators.AbstractMonotoneActuator)
        False
    """

    @abc.abstractmethod
    def passing_time(self, state: Scalars, command: RealScalarLike, level: RealScalarLike) -> RealScalarLike:
        """Time [s] until the input passes a level, under a constant command: `inf` if it never will.

        Args:
            state: What `move` gave for this command.
            command: The command that is held.
            level: The level. One at which the input is, but for rounding, has been passed.
        """

"""An actuator that is no faster than it is."""

from typing import NamedTuple

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_nonnegative, require_positive, require_range
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.implementation.actuators.actuator import THERE, AbstractMonotoneActuator
from qsmc_jax.implementation.actuators.lags import relaxing_swing
from qsmc_jax.implementation.swing import Swing, held_swing


class _Way(NamedTuple):
    """The way from an input to its command: first at full speed, then, `knee` before the command, slower and slower.

    Attributes:
        u: Where it begins.
        command: Where it leads to.
        side: 1 upwards, -1 downwards, 0 if there is none.
        length: How long it is.
        far: Of this, what is done at full speed.
        full: Time [s] that it takes.
        last: Of the rest, the signed length.
        room: How much of it there is before the stop.
        near: Lengths up to this are rounding.
    """

    u: RealScalarLike
    command: RealScalarLike
    side: RealScalarLike
    length: RealScalarLike
    far: RealScalarLike
    full: RealScalarLike
    last: RealScalarLike
    room: RealScalarLike
    near: RealScalarLike


class RateLimited(AbstractMonotoneActuator):
    r"""First-order lag whose rate saturates, $T \dot u_a = \operatorname{clip}(u - u_a, -T R, T R)$, between stops.

    A rudder, a valve or a landing flap: far from its command it moves at its full rate R. With T = 0 it does so until
    it is there. At a stop it rests as long as the command is beyond. `Implementation.rate_limit` limits the command
    instead, from sample to sample.

    Attributes:
        time_constant: T [s], not negative.
        rate: R, units of the input per second, positive.
        travel: Positions of the lower and the upper stop, in units of the input; none if None. One may be infinite.

    Source: Fossen, Handbook of Marine Craft Hydrodynamics and Motion Control, 2011, section 9.5 (rudder servo).

    Examples:
        A rudder that moves at 5 degrees a second, as far as 35:

        >>> import qsmc_jax as qj
        >>> rudder = qj.actuators.RateLimited(time_constant=0.5, rate=5.0, travel=(-35.0, 35.0))
        >>> [round(float(rudder.move(rudder.rest(), command=40.0, dt=dt)[0]), 3) for dt in (1.0, 6.0, 60.0)]
        [5.0, 30.0, 35.0]
    """

    time_constant: Float[Array, ""] = float_field()
    rate: Float[Array, ""] = float_field()
    travel: Float[Array, " 2"] | None = float_field(default=None)

    def __check_init__(self):
        require_nonnegative("time_constant", self.time_constant)
        require_positive("rate", self.rate)
        if self.travel is not None:
            require_range("travel", self.travel)

    def rest(self) -> Scalars:
        return (self._stopped(jnp.zeros(())),)

    def move(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Scalars:
        return (self._stopped(self._freely(self._way(state, command), dt)),)

    def swing(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Swing:
        # notation: `moving` ends at the stop, `full` before that at the latest
        way = self._way(state, command)
        moving = jnp.minimum(dt, jnp.where(way.room > way.near, self._stop_time(way), 0.0))
        full = jnp.minimum(moving, way.full)
        u0, u1, step = state[0], self.move(state, command, dt)[0], way.side * self.rate * full
        slow = relaxing_swing(self.time_constant, -way.last, command, jnp.maximum(moving - way.full, 0.0))
        held = held_swing(u1, dt - moving)
        area = full * (u0 + 0.5 * step) + slow.area + held.area
        energy = full * (u0 * u0 + step * (u0 + step / 3.0)) + slow.energy + held.energy
        return Swing(jnp.abs(u1 - u0), jnp.minimum(u0, u1), jnp.maximum(u0, u1), area, energy)

    def kinks(self, state: Scalars, command: RealScalarLike) -> Scalars:
        """The end of full speed, and the stop."""
        way = self._way(state, command)
        slows = (way.far > way.near) & (way.far <= way.room)
        return jnp.where(slows, way.full, jnp.inf), self._stop_time(way)

    def passing_time(self, state: Scalars, command: RealScalarLike, level: RealScalarLike) -> RealScalarLike:
        way = self._way(state, command)
        moved = way.side * (level - state[0])
        passes = (moved > way.near) & (moved < way.room)
        return jnp.where(passes, self._time_for(way, jnp.where(passes, moved, 0.0)), jnp.inf)

    def is_valid(self) -> BoolScalarLike:
        is_valid = (self.time_constant >= 0.0) & (self.rate > 0.0)
        return is_valid if self.travel is None else is_valid & (self.travel[0] < self.travel[1])

    def _stopped(self, u: RealScalarLike) -> RealScalarLike:
        """The same position, or the stop before it."""
        return u if self.travel is None else jnp.clip(u, self.travel[0], self.travel[1])

    def _way(self, state: Scalars, command: RealScalarLike) -> _Way:
        u, knee = state[0], self.time_constant * self.rate
        gap = command - u
        side, length = jnp.sign(gap), jnp.abs(gap)
        far = jnp.maximum(length - knee, 0.0)
        room, near = side * (self._stopped(command) - u), THERE * (jnp.abs(u) + jnp.abs(command))
        return _Way(u, command, side, length, far, far / self.rate, jnp.clip(gap, -knee, knee), room, near)

    def _freely(self, way: _Way, dt: RealScalarLike) -> RealScalarLike:
        """Where it is a time `dt` later if there are no stops."""
        time_constant = jnp.where(self.time_constant > 0.0, self.time_constant, 1.0)
        slow = way.command - way.last * jnp.exp(-jnp.maximum(dt - way.full, 0.0) / time_constant)
        return jnp.where(dt < way.full, way.u + way.side * self.rate * dt, slow)

    def _time_for(self, way: _Way, moved: RealScalarLike) -> RealScalarLike:
        """How long the first part of the way takes, which is not all of it, or 0."""
        is_slow = (moved > way.far) & (moved < way.length)
        part = jnp.where(is_slow, moved - way.far, 0.0) / jnp.where(is_slow, way.length - way.far, 1.0)
        return jnp.where(is_slow, way.full - self.time_constant * jnp.log1p(-part), moved / self.rate)

    def _stop_time(self, way: _Way) -> RealScalarLike:
        """Time until it is at a stop: `inf` if it never is, or is there."""
        stops = (way.room < way.length) & (way.room > way.near)
        return jnp.where(stops, self._time_for(way, way.room), jnp.inf)

"""A dead zone between an actuator and the plant."""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_kind, require_nonnegative
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.implementation.actuators.actuator import AbstractActuator, AbstractMonotoneActuator
from qsmc_jax.implementation.actuators.lags import FirstOrderLag
from qsmc_jax.implementation.swing import Swing


class DeadZone(AbstractActuator):
    r"""An actuator whose position v reaches the plant as 0 for |v| <= w, and less w beyond.

    $u = v - \operatorname{clip}(v, -w, w)$: play, or a valve that overlaps. The order is: the command is rounded, kept
    in its range and limited in its rate; it arrives and is held; the actuator follows it; what is in the zone is lost
    last. So `saturation` and `input_range` limit what the actuator is told, not the input, which is less by w.

    The instants at which the actuator enters and leaves the zone must be known in closed form, so it has to move
    straight to its command: `FirstOrderLag` or `RateLimited`, but not `SecondOrderLag`, which swings.

    Attributes:
        half_width: w, units of the input, not negative.
        actuator: What moves the position; without, it is the command.

    Raises:
        InputError: The half-width is negative, or the actuator of another kind.

    Source: Tao and Kokotovic, Adaptive Control of Systems with Actuator and Sensor Nonlinearities, 1996, chapter 2.

    Examples:
        >>> import qsmc_jax as qj
        >>> valve = qj.actuators.DeadZone(0.25, qj.actuators.RateLimited(0.0, 1.0))
        >>> [float(valve.move(valve.rest(), command=-2.0, dt=dt)[0]) for dt in (0.125, 0.5, 3.0)]
        [0.0, -0.25, -1.75]
    """

    half_width: Float[Array, ""] = float_field()
    actuator: AbstractMonotoneActuator = eqx.field(default_factory=lambda: FirstOrderLag(0.0))

    def __check_init__(self):
        require_nonnegative("half_width", self.half_width)
        require_kind("actuator", self.actuator, AbstractMonotoneActuator, "Give `FirstOrderLag` or `RateLimited`.")

    def rest(self) -> Scalars:
        return self._with_input(self.actuator.rest())

    def move(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Scalars:
        return self._with_input(self.actuator.move(state[1:], command, dt))

    def swing(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Swing:
        # notation: position v, from v0 to v1; it is beyond the zone up to `entry`, and again from `leave` on
        w, first = self.half_width, self.actuator.move(state[1:], command, 0.0)
        v0, v1 = first[0], self.actuator.move(first, command, dt)[0]
        side0, side1 = jnp.sign(v0), jnp.sign(v1)
        enters, leaves = (self.actuator.passing_time(first, command, side * w) for side in (side0, side1))
        # An edge that is not passed may have been before, but for rounding: where it ends tells on which side it was.
        entry = jnp.where(enters < jnp.inf, enters, jnp.where(side0 * v1 >= w, dt, 0.0))
        entry = jnp.where(jnp.abs(v0) > w, jnp.minimum(entry, dt), 0.0)
        leave = jnp.where(jnp.abs(v1) > w, jnp.where(leaves < jnp.inf, leaves, 0.0), dt)
        leave = jnp.clip(leave, entry, dt)
        before = self.actuator.swing(first, command, entry)
        after = self.actuator.swing(self.actuator.move(first, command, leave), command, dt - leave)
        area, energy = (
            a + b for a, b in zip(_less(before, side0 * w, entry), _less(after, side1 * w, dt - leave), strict=True)
        )
        u0, u1 = self._input(v0), self._input(v1)
        return Swing(jnp.abs(u1 - u0), jnp.minimum(u0, u1), jnp.maximum(u0, u1), area, energy)

    def kinks(self, state: Scalars, command: RealScalarLike) -> Scalars:
        """Those of the actuator, and the edges of the zone."""
        edges = (self.actuator.passing_time(state[1:], command, edge) for edge in (-self.half_width, self.half_width))
        return (*self.actuator.kinks(state[1:], command), *edges)

    def is_valid(self) -> BoolScalarLike:
        return (self.half_width >= 0.0) & self.actuator.is_valid()

    def _input(self, position: RealScalarLike) -> RealScalarLike:
        return position - jnp.clip(position, -self.half_width, self.half_width)

    def _with_input(self, position: Scalars) -> Scalars:
        return (self._input(position[0]), *position)


def _less(swing: Swing, edge: RealScalarLike, dt: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
    """The integrals of a position less a constant, and of its square."""
    return swing.area - edge * dt, swing.energy - 2.0 * edge * swing.area + edge**2 * dt

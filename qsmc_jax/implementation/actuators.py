"""Actuators: what stands between the command that is held and the input that the plant gets.

Between two changes of the command their motion is known in closed form, so that none is too fast to be followed.
"""

import abc

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_nonnegative, require_positive
from qsmc_jax.base.module import AbstractModule, float_field
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars


class AbstractActuator(AbstractModule):
    """A linear lag between command and input, with unit gain at rest. It is at rest, with input 0, at time 0.

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
    def is_valid(self) -> BoolScalarLike:
        """Whether its numbers are in range: what the constructor checks, for traced ones."""


class FirstOrderLag(AbstractActuator):
    r"""First-order lag, $T_a \dot u_a + u_a = u$.

    Attributes:
        time_constant: $T_a$ [s], not negative; 0 for none.

    Examples:
        After one time constant it is 1 - 1/e of the way:

        >>> import qsmc_jax as qj
        >>> lag = qj.actuators.FirstOrderLag(time_constant=0.1)
        >>> [round(float(u), 3) for u in lag.move(lag.rest(), command=1.0, dt=0.1)]
        [0.632]
    """

    time_constant: Float[Array, ""] = float_field()

    def __check_init__(self):
        require_nonnegative("time_constant", self.time_constant)

    def rest(self) -> Scalars:
        return (jnp.zeros(()),)

    def move(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Scalars:
        has_lag = self.time_constant > 0.0
        decay = jnp.exp(-dt / jnp.where(has_lag, self.time_constant, 1.0))
        return (command + (state[0] - command) * jnp.where(has_lag, decay, 0.0),)

    def is_valid(self) -> BoolScalarLike:
        return self.time_constant >= 0.0


class SecondOrderLag(AbstractActuator):
    r"""Second-order lag, $\ddot u_a + 2 \zeta \omega \dot u_a + \omega^2 u_a = \omega^2 u$.

    Attributes:
        frequency: Natural frequency $\omega$ [rad/s], positive.
        damping: Damping ratio $\zeta$ [-], positive; below 1 it overshoots.

    Examples:
        Critically damped, it is 1 - 2/e of the way after a time of 1 / frequency:

        >>> import qsmc_jax as qj
        >>> lag = qj.actuators.SecondOrderLag(frequency=10.0)
        >>> round(float(lag.move(lag.rest(), command=1.0, dt=0.1)[0]), 3)
        0.264
    """

    frequency: Float[Array, ""] = float_field()
    damping: Float[Array, ""] = float_field(default=1.0)

    def __check_init__(self):
        require_positive("frequency", self.frequency)
        require_positive("damping", self.damping)

    def rest(self) -> Scalars:
        return (jnp.zeros(()), jnp.zeros(()))

    def move(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Scalars:
        # notation: y = u_a - u, its rate over omega v, and the two solutions of the homogeneous equation
        phase, y, v = self.frequency * dt, state[0] - command, state[1]
        cosine, sine = _damped_pair(self.damping, phase)
        drive = v + self.damping * y
        # The rate follows from y'' + 2 zeta y' + y = 0, in units of time of 1 / omega.
        rate = v * cosine - (y + self.damping * v) * sine
        return command + y * cosine + drive * sine, rate

    def is_valid(self) -> BoolScalarLike:
        return (self.frequency > 0.0) & (self.damping > 0.0)


def _damped_pair(damping: RealScalarLike, phase: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
    r"""$e^{-\zeta\phi}\cos q\phi$ and $e^{-\zeta\phi}\frac{\sin q\phi}{q}$ with $q = \sqrt{1 - \zeta^2}$.

    And what they become for a damping ratio of 1 or more.
    """
    discriminant = 1.0 - damping * damping
    oscillates, is_critical = discriminant > 0.0, jnp.abs(discriminant) < 1e-12
    q = jnp.sqrt(jnp.where(is_critical, 1.0, jnp.abs(discriminant)))
    decay = jnp.exp(-damping * phase)
    slow, fast = jnp.exp((q - damping) * phase), jnp.exp(-(q + damping) * phase)
    cosine = jnp.where(oscillates, decay * jnp.cos(q * phase), 0.5 * (slow + fast))
    sine = jnp.where(oscillates, decay * jnp.sin(q * phase), 0.5 * (slow - fast)) / q
    return jnp.where(is_critical, decay, cosine), jnp.where(is_critical, decay * phase, sine)

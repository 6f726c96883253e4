"""Linear lags, with unit gain at rest."""

import functools as ft

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_nonnegative, require_positive
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike, Scalars
from qsmc_jax.implementation.actuators.actuator import THERE, AbstractActuator, AbstractMonotoneActuator
from qsmc_jax.implementation.swing import Swing


class FirstOrderLag(AbstractMonotoneActuator):
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

    def swing(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Swing:
        y = jnp.where(self.time_constant > 0.0, state[0] - command, 0.0)
        return relaxing_swing(self.time_constant, y, command, dt)

    def kinks(self, state: Scalars, command: RealScalarLike) -> Scalars:
        return ()

    def passing_time(self, state: Scalars, command: RealScalarLike, level: RealScalarLike) -> RealScalarLike:
        way, moved = command - state[0], level - state[0]
        near = THERE * (jnp.abs(state[0]) + jnp.abs(command))
        passes = (way * moved > 0.0) & (jnp.abs(moved) < jnp.abs(way)) & (jnp.abs(moved) > near)
        part = jnp.where(passes, moved, 0.0) / jnp.where(passes, way, 1.0)
        return jnp.where(passes, -self.time_constant * jnp.log1p(-part), jnp.inf)

    def is_valid(self) -> BoolScalarLike:
        return self.time_constant >= 0.0


def relaxing_swing(
    time_constant: RealScalarLike, y: RealScalarLike, command: RealScalarLike, dt: RealScalarLike
) -> Swing:
    r"""That of an input $u = c + y e^{-t / T}$, with the command c; T may be 0 if y is.

    Args:
        time_constant: T [s].
        y: Distance from the command at the beginning.
        command: The command that is held.
        dt: Time [s] that passes.
    """
    has_lag = time_constant > 0.0
    lost = -jnp.expm1(-dt / jnp.where(has_lag, time_constant, 1.0))
    ends = command + y, command + y * (1.0 - lost)
    # The integral of u - c is T (y - y(end)).
    area = command * dt + time_constant * y * lost
    energy = command**2 * dt + time_constant * y * lost * (2.0 * command + 0.5 * y * (2.0 - lost))
    return Swing(jnp.abs(y * lost), jnp.minimum(*ends), jnp.maximum(*ends), area, energy)


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

    def swing(self, state: Scalars, command: RealScalarLike, dt: RealScalarLike) -> Swing:
        # notation: as in `move`; an index 1 is for the first turn, 2 for the second, `end` for the end
        zeta, y, v = self.damping, state[0] - command, state[1]
        u_end, v_end = self.move(state, command, dt)
        y_end, phase = u_end - command, self.frequency * dt
        first, period = _turns(zeta, y, v)
        turns_left = jnp.where(first <= phase, jnp.floor((phase - first) / period), 0.0)  # after the first one
        cosine, sine = _damped_pair(zeta, jnp.where(first <= phase, first, 0.0))
        y1 = y * cosine + (v + zeta * y) * sine
        shrinks = jnp.exp(-zeta * period)  # from turn to turn, where the sign changes too
        full = (1.0 + shrinks) * (1.0 - shrinks**turns_left) / (1.0 - shrinks)
        y_last = y1 * (-shrinks) ** turns_left
        variation = jnp.abs(y1 - y) + jnp.abs(y1) * full + jnp.abs(y_end - y_last)
        y2 = jnp.where(turns_left > 0.0, -shrinks * y1, y1)
        low, high = (command + ft.reduce(extreme, (y, y1, y2, y_end)) for extreme in (jnp.minimum, jnp.maximum))
        # From y'' + 2 zeta y' + y = 0: the integrals over the phase of y and of its square, by what changes.
        once = (v - v_end) + 2.0 * zeta * (y - y_end)
        squared = y * y - y_end * y_end
        twice = (squared + v * v - v_end * v_end) / (4.0 * zeta) + zeta * squared + (y * v - y_end * v_end)
        area = command * dt + once / self.frequency
        energy = command**2 * dt + (2.0 * command * once + twice) / self.frequency
        return Swing(variation, low, high, area, energy)

    def kinks(self, state: Scalars, command: RealScalarLike) -> Scalars:
        return ()

    def is_valid(self) -> BoolScalarLike:
        return (self.frequency > 0.0) & (self.damping > 0.0)


def _turns(damping: RealScalarLike, y: RealScalarLike, v: RealScalarLike) -> tuple[RealScalarLike, RealScalarLike]:
    r"""The phase of the first turn, and that between one and the next; `inf` where there is none.

    The rate is $v \cos q\phi - b \sin q\phi / q$ with $b = y + \zeta v$, but for the decay.
    """
    discriminant = 1.0 - damping * damping
    oscillates, is_critical = discriminant > 0.0, jnp.abs(discriminant) < 1e-12
    q = jnp.sqrt(jnp.where(is_critical, 1.0, jnp.abs(discriminant)))
    b = y + damping * v
    ratio = jnp.where(b == 0.0, jnp.inf, v / jnp.where(b == 0.0, 1.0, b))
    angle = jnp.arctan(q * ratio)
    oscillating = jnp.where(angle < 0.0, angle + jnp.pi, angle) / q
    turns_once = (ratio >= 0.0) & (q * ratio < 1.0)
    creeping = jnp.where(turns_once, jnp.arctanh(jnp.where(turns_once, q * ratio, 0.0)) / q, jnp.inf)
    critical = jnp.where((ratio >= 0.0) & (ratio < jnp.inf), ratio, jnp.inf)
    first = jnp.where(is_critical, critical, jnp.where(oscillates, oscillating, creeping))
    first, period = jax.lax.stop_gradient((first, jnp.where(oscillates & ~is_critical, jnp.pi / q, jnp.inf)))
    return first, period


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

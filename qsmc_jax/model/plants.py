"""Plants in strict-feedback form, and the two of the paper."""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require_nonnegative, require_positive
from qsmc_jax.base.module import AbstractModule, float_field, require_fields
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.model.kinks import as_times
from qsmc_jax.tracing.traceable import once_per_structure, require_number, trace


class AbstractPlant(AbstractModule):
    r"""A plant $\dot x_i = x_{i+1}$ ($i < n$), $\dot x_n = f(t, x) + g(t, x) u + d(t)$, $y = x_1$.

    Subclass it with a class attribute `order` (n >= 1) and the two methods; write them with `jax.numpy`. The controller
    never sees them: it knows the sign of g only. Both may jump in time. In the state they must be continuous, and are
    refused where they are seen to jump, for a loop may stick there: `qj.smoothed` has friction that does not jump.

    Examples:
        A motor with friction, as you may write it:

        >>> import qsmc_jax as qj
        >>> class Motor(qj.AbstractPlant):
        ...     order = 2
        ...     def drift(self, t, x):
        ...         return -x[1]
        ...     def gain(self, t, x):
        ...         return 4.0
        >>> Motor().drift(0.0, (0.5, 3.0))
        -3.0

    Source: paper, eq. (1); the paper has f(x) and g(x), time is added for drifting parameters.
    """

    hint: ClassVar[str] = "Derive from `qj.AbstractPlant` or `qj.AbstractStateSpace`, or use one of `qj.plants`."

    order: eqx.AbstractClassVar[int]

    def __check_init__(self):
        require_fields(self)
        _require_plant(self)

    @property
    def states(self) -> int:
        """The number of states, n."""
        return self.order

    def outputs(self, t: RealScalarLike, x: State) -> Scalars:
        """The output and its derivatives, n scalars: the state itself.

        Args:
            t: Time [s].
            x: State, a tuple of n scalars.
        """
        return tuple(x)

    def outputs_in_motion(self, t: RealScalarLike, x: State, rates: Scalars) -> tuple[Scalars, Scalars]:
        """`outputs` with their rates, n scalars each: the state's own.

        Args:
            t: Time [s].
            x: State, a tuple of n scalars.
            rates: Rates of the state, n scalars.
        """
        return tuple(x), tuple(rates)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] at which drift or gain jumps or kinks as a function of time; the solver steps to them.

        A hint that saves steps: what is not declared is found by the solver. None here; a plant that changes at some
        time may have its own. Their number is fixed when traced.
        """
        return jnp.zeros((0,))

    @abc.abstractmethod
    def drift(self, t: RealScalarLike, x: State) -> RealScalarLike:
        """The drift f(t, x), in units of the last state per second.

        Args:
            t: Time [s].
            x: State, a tuple of n scalars `x[0] ... x[n - 1]`.

        Returns:
            A scalar.
        """

    @abc.abstractmethod
    def gain(self, t: RealScalarLike, x: State) -> RealScalarLike:
        """The control gain g(t, x), in units of the last state per second and unit of input.

        Theorem 1 needs it away from zero with a known sign; `QuasiSlidingControl(gain_sign=...)` says which.

        Args:
            t: Time [s].
            x: State, a tuple of n scalars `x[0] ... x[n - 1]`.

        Returns:
            A scalar.
        """


@once_per_structure
def _require_plant(plant: AbstractPlant) -> None:
    """Raises unless drift and gain can be traced and are one number each."""
    number, order = jax.ShapeDtypeStruct((), float), plant.order
    takes = f"a time and a state of {order} numbers x[0] ... x[{order - 1}]"
    for method in ("drift", "gain"):
        name = f"`{method}` of `{type(plant).__name__}`"

        def call(plant: AbstractPlant, t: RealScalarLike, *x: RealScalarLike, method: str = method) -> Any:
            return getattr(plant, method)(t, x)

        _, value = trace(name, takes, plant, call, number, *(number,) * order)
        require_number(name, value, f"Index the state: x[0] ... x[{order - 1}].")
    trace(f"`break_times` of `{type(plant).__name__}`", "nothing", plant, lambda plant: as_times(plant.break_times))


class InvertedPendulum(AbstractPlant):
    r"""Inverted pendulum, $f = -\frac{G}{l}\sin x_1 - \frac{k}{m} x_2 + \sin x_2$, $g = \frac{1}{m l^2}$.

    State: angle [rad], angular velocity [rad/s]. Input: torque [N m].

    Attributes:
        mass: End mass m [kg], positive.
        length: Length of the rod l [m], positive.
        friction: Friction coefficient k [kg/s], not negative.
        gravity: Acceleration due to gravity G [m/s^2].

    Examples:
        >>> import qsmc_jax as qj
        >>> pendulum = qj.plants.InvertedPendulum(mass=0.5, length=2.0)
        >>> float(pendulum.gain(0.0, (0.0, 0.0))), float(pendulum.drift(0.0, (0.0, 0.0)))
        (0.5, 0.0)

    Source: paper, Example 1.
    """

    mass: Float[Array, ""] = float_field(default=0.01)
    length: Float[Array, ""] = float_field(default=9.8)
    friction: Float[Array, ""] = float_field(default=0.01)
    gravity: Float[Array, ""] = float_field(default=9.8)

    order: ClassVar[int] = 2

    def __check_init__(self):
        require_positive("mass", self.mass)
        require_positive("length", self.length)
        require_nonnegative("friction", self.friction)

    def drift(self, t: RealScalarLike, x: State) -> RealScalarLike:
        return -self.gravity / self.length * jnp.sin(x[0]) - self.friction / self.mass * x[1] + jnp.sin(x[1])

    def gain(self, t: RealScalarLike, x: State) -> RealScalarLike:
        return 1.0 / (self.mass * self.length**2)


class FourthOrderExample(AbstractPlant):
    r"""Fourth-order numerical system, $f = x_3 \sin 2x_2 + x_1 \cos x_4$, $g = 2 - \sin x_4$.

    Attributes:
        drift_scale: Factor on the drift f [-]; 1 in the paper.
        gain_scale: Factor on the gain g [-], positive; 1 in the paper.

    Examples:
        >>> import qsmc_jax as qj
        >>> plant = qj.plants.FourthOrderExample(gain_scale=0.5)
        >>> plant.order, float(plant.gain(0.0, (0.0, 0.0, 0.0, 0.0)))
        (4, 1.0)

    Source: paper, eq. (13), Example 2. The factors are ours: they let a study disperse the plant.
    """

    drift_scale: Float[Array, ""] = float_field(default=1.0)
    gain_scale: Float[Array, ""] = float_field(default=1.0)

    order: ClassVar[int] = 4

    def __check_init__(self):
        require_positive("gain_scale", self.gain_scale)

    def drift(self, t: RealScalarLike, x: State) -> RealScalarLike:
        return self.drift_scale * (x[2] * jnp.sin(2.0 * x[1]) + x[0] * jnp.cos(x[3]))

    def gain(self, t: RealScalarLike, x: State) -> RealScalarLike:
        return self.gain_scale * (2.0 - jnp.sin(x[3]))

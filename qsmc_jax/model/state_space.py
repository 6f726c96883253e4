"""Plants in their own coordinates: any states, internal ones among them, and disturbances wherever they enter."""

import abc
from collections.abc import Callable
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require
from qsmc_jax.base.module import require_fields
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.model.kinks import as_times
from qsmc_jax.model.own_coordinates import AbstractOwnCoordinates
from qsmc_jax.tracing.traceable import described, is_number, once_per_structure, require_number, trace

# States around the start at which a relative degree is looked at, how far around, and what counts as nothing.
_STATES, _AROUND, _NOTHING = 8, 0.1, 1e-12

_Output = Callable[[RealScalarLike, Scalars], RealScalarLike]
_Rates = Callable[[RealScalarLike, Scalars], Scalars]


class AbstractStateSpace(AbstractOwnCoordinates):
    r"""A plant in its own coordinates, $\dot x = f(t, x, d) + G(t, x) u$, $y = h(t, x)$.

    Subclass it with class attributes `states` (the number of states) and `relative_degrees` (a number r for each
    output: how often it is differentiated until an input shows), and the three methods; write them with `jax.numpy`.
    There are as many inputs as outputs; with several, y and d are tuples of as many numbers, and so is each row of G:
    see `MultivariableLoop`. The errors are $e^{(k)} =
    L_f^k h - x_{des}^{(k)}$, k = 0..r-1, derivatives along f without disturbance: what a controller works out from the
    state. Where d enters before u does (unmatched), they are not the derivatives of the tracking error. States beyond
    these r, the internal dynamics, are simulated, recorded and required about, but nothing keeps them bounded: that is
    the plant's own affair.

    Examples:
        A pendulum on a flexible joint would have r = 4; here is a motor with a tank that it fills:

        >>> import qsmc_jax as qj
        >>> class Motor(qj.AbstractStateSpace):
        ...     states, relative_degrees = 3, (2,)
        ...     def vector_field(self, t, x, d):
        ...         return x[1], -x[1] + d, x[0] - x[2]
        ...     def input_matrix(self, t, x):
        ...         return 0.0, 4.0, 0.0
        ...     def output(self, t, x):
        ...         return x[0]
        >>> [float(each) for each in Motor().outputs(0.0, (0.5, 3.0, 0.1))]
        [0.5, 3.0]
    """

    hint: ClassVar[str] = "Derive from `qj.AbstractStateSpace`, or from `qj.AbstractPlant` for a chain of integrators."

    states: eqx.AbstractClassVar[int]
    relative_degrees: eqx.AbstractClassVar[tuple[int, ...]]

    def __check_init__(self):
        require_fields(self)
        _require_state_space(self)

    @property
    def order(self) -> int:
        """The relative degree r: the number of errors."""
        return self.relative_degrees[0]

    @property
    def calm(self) -> Any:
        """The value of the disturbance where there is none: 0, or with several inputs a tuple of so many."""
        inputs = len(self.relative_degrees)
        return 0.0 if inputs == 1 else (0.0,) * inputs

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] at which a method jumps or kinks as a function of time; see `AbstractPlant.break_times`."""
        return jnp.zeros((0,))

    @abc.abstractmethod
    def vector_field(self, t: RealScalarLike, x: State, d: Any) -> Scalars:
        """The states' rates without input, f(t, x, d), continuous in x.

        Args:
            t: Time [s].
            x: State, a tuple of N scalars.
            d: Value of the loop's disturbance, which enters where you put it.

        Returns:
            N scalars.
        """

    @abc.abstractmethod
    def input_matrix(self, t: RealScalarLike, x: State) -> Any:
        """What a unit of input adds to each rate, G(t, x), continuous in x.

        Args:
            t: Time [s].
            x: State, a tuple of N scalars.

        Returns:
            N scalars; with several inputs N rows, each a tuple of a scalar for each input.
        """

    @abc.abstractmethod
    def output(self, t: RealScalarLike, x: State) -> Any:
        """The output y = h(t, x), which the reference is for: r times differentiable.

        Args:
            t: Time [s].
            x: State, a tuple of N scalars.

        Returns:
            A scalar; with several outputs a tuple of as many.
        """

    def column(self, t: RealScalarLike, x: State, channel: int) -> Scalars:
        """What a unit of one input adds to each rate, N scalars.

        Args:
            t: Time [s].
            x: State, a tuple of N scalars.
            channel: Index of the input.
        """
        rows = self.input_matrix(t, x)
        return tuple(rows) if len(self.relative_degrees) == 1 else tuple(row[channel] for row in rows)

    def outputs(self, t: RealScalarLike, x: State, channel: int = 0) -> Scalars:
        """The output and its derivatives along f without disturbance, r scalars.

        Args:
            t: Time [s].
            x: State, a tuple of N scalars.
            channel: Index of the output, if there are several.
        """
        is_one = len(self.relative_degrees) == 1
        output = self.output if is_one else lambda t, x: self.output(t, x)[channel]
        rates = lambda t, x: self.vector_field(t, x, self.calm)  # noqa: E731
        return derivatives_along(output, rates, t, x, self.relative_degrees[channel])

    def outputs_in_motion(
        self, t: RealScalarLike, x: State, rates: Scalars, time: float = 1.0, channel: int = 0
    ) -> tuple[Scalars, Scalars]:
        """`outputs` with their rates, r scalars each.

        Args:
            t: Time [s].
            x: State, a tuple of N scalars.
            rates: Rates of the state, N scalars.
            time: The rate of time: 0 if it stands still.
            channel: Index of the output, if there are several.
        """
        outputs = lambda t, x: self.outputs(t, x, channel)  # noqa: E731
        return jax.jvp(outputs, *_primals_and_tangents(t, x, rates, time))

    def gains(self, t: RealScalarLike, x: State, channel: int = 0, by: int = 0) -> Scalars:
        """What a unit of input adds to the rates of `outputs`, r scalars: 0 but for the last, if r is the right one.

        Args:
            t: Time [s].
            x: State, a tuple of N scalars.
            channel: Index of the output, if there are several.
            by: Index of the input.
        """
        return self.outputs_in_motion(t, x, self.column(t, x, by), 0.0, channel)[1]


def derivatives_along(function: _Output, rates: _Rates, t: RealScalarLike, x: State, count: int) -> Scalars:
    """A function of time and state, and its derivatives in time where the state has the given rates.

    Args:
        function: The function.
        rates: The rates, another one.
        t: Time [s].
        x: State.
        count: How many are wanted, the function itself counted.
    """
    found = []
    for _ in range(count):
        found.append(jnp.asarray(function(t, x), float))
        function = _along(function, rates)
    return tuple(found)


def _along(function: _Output, rates: _Rates) -> _Output:
    """The derivative in time of a function of time and state."""

    def derivative(t: RealScalarLike, x: State) -> RealScalarLike:
        as_number = lambda t, x: jnp.asarray(function(t, x), float)  # noqa: E731
        return jax.jvp(as_number, *_primals_and_tangents(t, x, rates(t, x), 1.0))[1]

    return derivative


def _primals_and_tangents(t: RealScalarLike, x: State, rates: Scalars, time: float) -> tuple[Any, Any]:
    """What `jvp` is given of a time and a state, and of their rates."""
    as_floats = lambda values: tuple(jnp.asarray(value, float) for value in values)  # noqa: E731
    return (jnp.asarray(t, float), as_floats(x)), (jnp.asarray(time, float), as_floats(rates))


@once_per_structure
def _require_state_space(plant: AbstractStateSpace) -> None:
    """Raises unless the methods can be traced and return what they should."""
    owner, states, degrees = f"`{type(plant).__name__}`", plant.states, plant.relative_degrees
    is_list = isinstance(degrees, tuple) and len(degrees) > 0
    require(is_list, f"Attribute `relative_degrees` of {owner} must hold numbers, such as (2,), but is {degrees!r}.")
    fits = all(isinstance(each, int) and each >= 1 for each in degrees) and sum(degrees) <= states
    require(
        fits,
        f"The relative degree of {owner} must lie in 1 ... {states}, its `states`, and so must the sum of several, but "
        f"is {', '.join(map(str, degrees))}.",
    )
    number, inputs = jax.ShapeDtypeStruct((), float), len(degrees)
    takes = f"a time and a state of {states} numbers x[0] ... x[{states - 1}]"
    state, calm = (number,) * states, jax.tree.map(lambda _: number, plant.calm)
    given = "a disturbance" if inputs == 1 else f"{inputs} disturbances"
    calls: dict[str, tuple[Callable[..., Any], str, tuple[Any, ...]]] = {
        "vector_field": (lambda plant, t, d, *x: plant.vector_field(t, x, d), f"{takes} and {given}", (calm,)),
        "input_matrix": (lambda plant, t, *x: plant.input_matrix(t, x), takes, ()),
        "output": (lambda plant, t, *x: plant.output(t, x), takes, ()),
    }
    rows = f"{states} rows of {inputs} numbers, one a state" if inputs > 1 else f"{states} numbers, one a state"
    wanted = {
        "vector_field": (f"{states} numbers, one a state", (states,)),
        "input_matrix": (rows, (states, inputs) if inputs > 1 else (states,)),
        "output": (f"{inputs} numbers, one a channel", (inputs,)),
    }
    for method, (call, what, more) in calls.items():
        name = f"`{method}` of {owner}"
        _, result = trace(name, what, plant, call, number, *more, *state)
        if method == "output" and inputs == 1:
            require_number(name, result, f"Index the state: x[0] ... x[{states - 1}].")
            continue
        meant, shape = wanted[method]
        require(is_list_of(result, *shape), f"{name} must return {meant}, but returns {described(result)}.")
    for channel in range(inputs):
        what = f"The derivatives of `output` of {owner}"
        trace(what, takes, plant, lambda plant, t, *x, channel=channel: plant.gains(t, x, channel), number, *state)
    trace(f"`break_times` of {owner}", "nothing", plant, lambda plant: as_times(plant.break_times))


def is_list_of(result: Any, count: int, *inner: int) -> bool:
    """Whether something is a list of so many numbers, or of lists of them.

    Args:
        result: What a traced function returned.
        count: How many.
        *inner: How many there are in each of them.
    """
    if not isinstance(result, tuple | list) or len(result) != count:
        return False
    return all(
        is_list_of(each, *inner) if inner else is_number(each) or isinstance(each, int | float) for each in result
    )


def require_relative_degree(plant: AbstractStateSpace, x0: Any) -> None:
    """Raises unless an input shows in the r-th derivative of each output and in none before; traced numbers pass.

    It is looked at where the run starts, and at states around.

    Args:
        plant: The plant.
        x0: The start, N numbers.

    Raises:
        InputError: The relative degree is another one.
    """
    if is_traced(plant, x0):
        return
    x0 = np.asarray(x0, float)
    around = np.random.default_rng(0).uniform(-_AROUND, _AROUND, (_STATES, len(x0))) * (1.0 + np.abs(x0))
    points, owner = (
        np.concatenate([x0[None, :], x0 + around]),
        f"Attribute `relative_degrees` of `{type(plant).__name__}`",
    )
    for channel, degree in enumerate(plant.relative_degrees):
        of = f" for output {channel}" if len(plant.relative_degrees) > 1 else ""
        gains = np.asarray(_gains_at(plant, points, channel))
        gains = gains[np.isfinite(gains).all(axis=1)]
        shows = np.flatnonzero((np.abs(gains) > _NOTHING * np.abs(gains).max(initial=0.0)).any(axis=0))
        require(
            len(shows) > 0,
            f"{owner} must say in which derivative of the output the input shows, but in the first {degree} it does "
            f"not{of}: say {degree + 1}, or more.",
        )
        require(
            int(shows[0]) == degree - 1,
            f"{owner} must be the first derivative of the output in which the input shows, but is {degree}{of}, and it "
            f"shows in derivative {shows[0] + 1}: say {shows[0] + 1}.",
        )


@entry_point
def _gains_at(
    plant: AbstractStateSpace, points: Float[np.ndarray, "states n"], channel: int
) -> Float[Array, "states r"]:
    """For each of the output's derivatives the largest gain by any input."""

    def at(x: Float[Array, " n"]) -> Float[Array, " r"]:
        state = tuple(x[i] for i in range(plant.states))
        found = [jnp.stack(plant.gains(0.0, state, channel, by)) for by in range(len(plant.relative_degrees))]
        return jnp.max(jnp.abs(jnp.stack(found)), axis=0)

    return jax.vmap(at)(jnp.asarray(points))

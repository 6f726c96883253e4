"""What a loop asks of a plant that is not a chain of integrators: rates, and the errors they make of an output."""

import abc
from typing import Any

from jaxtyping import Array, Float

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars, State


class AbstractOwnCoordinates(AbstractModule):
    """A plant in its own coordinates with one input, or one channel of such a plant with several."""

    @property
    @abc.abstractmethod
    def order(self) -> int:
        """The relative degree r: the number of errors."""

    @property
    @abc.abstractmethod
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] at which a method jumps or kinks as a function of time."""

    @abc.abstractmethod
    def vector_field(self, t: RealScalarLike, x: State, d: Any) -> Scalars:
        """The states' rates without the input, which in a channel the other inputs are part of."""

    @abc.abstractmethod
    def input_matrix(self, t: RealScalarLike, x: State) -> Scalars:
        """What a unit of the input adds to each rate."""

    @abc.abstractmethod
    def outputs(self, t: RealScalarLike, x: State) -> Scalars:
        """The output and its derivatives along the rates without input and disturbance, r scalars."""

    @abc.abstractmethod
    def outputs_in_motion(
        self, t: RealScalarLike, x: State, rates: Scalars, time: float = 1.0
    ) -> tuple[Scalars, Scalars]:
        """`outputs` with their rates, r scalars each; `time` is the rate of time."""

    @abc.abstractmethod
    def gains(self, t: RealScalarLike, x: State) -> Scalars:
        """What a unit of the input adds to the rates of `outputs`, r scalars."""

"""One channel of a plant with several inputs, as a plant with one: the others' inputs are part of its rates."""

import equinox as eqx
from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.model.disturbances import AbstractDisturbance
from qsmc_jax.model.own_coordinates import AbstractOwnCoordinates
from qsmc_jax.model.state_space import AbstractStateSpace


class Channel(AbstractOwnCoordinates):
    """A channel: the states are the plant's N and beside them the funnel coordinates of all m channels.

    The latter are there to tell the other inputs by; they have no rates here, and no output depends on them. In a loop
    with an implementation inputs are held, and there are no laws here, nor their coordinates.

    Attributes:
        plant: The plant.
        laws: The laws of all channels; none if inputs are held.
        disturbances: The disturbances, one for each channel.
        index: Which channel it is.
    """

    plant: AbstractStateSpace
    laws: tuple[QuasiSlidingControl, ...]
    disturbances: tuple[AbstractDisturbance, ...]
    index: int = eqx.field(static=True)

    @property
    def order(self) -> int:
        return self.plant.relative_degrees[self.index]

    @property
    def states(self) -> int:
        """Numbers that its state has."""
        return self.plant.states + len(self.laws)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return self.plant.break_times

    def disturbed(self, t: RealScalarLike) -> Scalars:
        """The values of the disturbances, m scalars.

        Args:
            t: Time [s].
        """
        return tuple(disturbance(t) for disturbance in self.disturbances)

    def inputs(self, t: RealScalarLike, x: State) -> Scalars:
        """The inputs of all channels, m scalars.

        Args:
            t: Time [s].
            x: State, N + m scalars.
        """
        coordinates = x[self.plant.states :]
        return tuple(law.at(s, t) for law, s in zip(self.laws, coordinates, strict=True))

    def vector_field(self, t: RealScalarLike, x: State, d: Scalars) -> Scalars:
        own, rates = self._own(x), tuple(self.plant.vector_field(t, self._own(x), d))
        for j, u in enumerate(self.inputs(t, x)):
            if j != self.index:
                rates = tuple(a + b * u for a, b in zip(rates, self.plant.column(t, own, j), strict=True))
        return self._widened(rates)

    def input_matrix(self, t: RealScalarLike, x: State) -> Scalars:
        return self._widened(self.plant.column(t, self._own(x), self.index))

    def outputs(self, t: RealScalarLike, x: State) -> Scalars:
        return self.plant.outputs(t, self._own(x), self.index)

    def outputs_in_motion(
        self, t: RealScalarLike, x: State, rates: Scalars, time: float = 1.0
    ) -> tuple[Scalars, Scalars]:
        return self.plant.outputs_in_motion(t, self._own(x), self._own(rates), time, self.index)

    def gains(self, t: RealScalarLike, x: State) -> Scalars:
        return self.plant.gains(t, self._own(x), self.index, self.index)

    def _own(self, x: State) -> Scalars:
        return tuple(x[: self.plant.states])

    def _widened(self, rates: Scalars) -> Scalars:
        """Rates of the plant's states, with those of the funnel coordinates."""
        return (*rates, *(0.0,) * len(self.laws))

"""One channel of a plant with several inputs, as a plant with one: the others' inputs are part of its rates."""

import equinox as eqx
from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.dynamic_control import exact_command, memory_at_start, memory_rates
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.model.disturbances import AbstractDisturbance
from qsmc_jax.model.own_coordinates import AbstractOwnCoordinates
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.model.state_space import AbstractStateSpace
from qsmc_jax.numerics.gudermann import ratio


class Channel(AbstractOwnCoordinates):
    """A channel: the states are the plant's N, then what all m laws keep, then the funnel coordinates of all channels.

    Those beside the plant's are there to tell the inputs by; they have no rates here, and no output depends on them. In
    a loop with an implementation inputs are held, and there are no laws here, nor what they need.

    Attributes:
        plant: The plant.
        laws: The laws of all channels; none if inputs are held.
        references: What each of them follows.
        disturbances: The disturbances, one for each channel.
        index: Which channel it is.
    """

    plant: AbstractStateSpace
    laws: tuple[AbstractControl, ...]
    references: tuple[AbstractReference, ...]
    disturbances: tuple[AbstractDisturbance, ...]
    index: int = eqx.field(static=True)

    @property
    def order(self) -> int:
        return self.plant.relative_degrees[self.index]

    @property
    def states(self) -> int:
        """Numbers that its state has."""
        return self.plant.states + sum(self._kept) + len(self.laws)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return self.plant.break_times

    def disturbed(self, t: RealScalarLike) -> Scalars:
        """The values of the disturbances, m scalars.

        Args:
            t: Time [s].
        """
        return tuple(disturbance(t) for disturbance in self.disturbances)

    def start(self, x0: State) -> Scalars:
        """The start of the plant's states and of what the laws keep.

        Args:
            x0: That of the plant's, N scalars.
        """
        samples = (self._sample(0.0, x0, j) for j, count in enumerate(self._kept) if count)
        laws = (law for law, count in zip(self.laws, self._kept, strict=True) if count)
        return (*x0, *(each for pair in zip(laws, samples, strict=True) for each in memory_at_start(*pair)))

    def memory(self, x: State) -> Scalars:
        """What the channel's law keeps; nothing if it has no memory.

        Args:
            x: State.
        """
        return self._memory(x, self.index)

    def memory_rates(self, t: RealScalarLike, x: State) -> Scalars:
        """The rates of what the laws keep.

        Args:
            t: Time [s].
            x: State.
        """
        with_memory = [j for j, count in enumerate(self._kept) if count]
        found = (memory_rates(self.laws[j], self._sample(t, x, j), self._memory(x, j)) for j in with_memory)
        return tuple(rate for rates in found for rate in rates)

    def inputs(self, t: RealScalarLike, x: State) -> Scalars:
        """The inputs of all channels, m scalars.

        Args:
            t: Time [s].
            x: State.
        """
        return tuple(self.input(t, x, j) for j in range(len(self.laws)))

    def input(self, t: RealScalarLike, x: State, channel: int) -> RealScalarLike:
        """The input of a channel, as `ClosedLoop.input_at` has it.

        Args:
            t: Time [s].
            x: State.
            channel: Which.
        """
        law, s = self.laws[channel], x[self.plant.states + sum(self._kept) + channel]
        if isinstance(law, QuasiSlidingControl):
            return law.at(s, t)
        errors, desired = self._tracked(t, x, channel)
        return exact_command(law, t, errors, desired, law.funnel(t) * ratio(s), self._memory(x, channel))

    def vector_field(self, t: RealScalarLike, x: State, d: Scalars) -> Scalars:
        own, rates = self._own(x), tuple(self.plant.vector_field(t, self._own(x), d))
        for j in range(len(self.laws)):
            if j != self.index:
                u = self.input(t, x, j)
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

    @property
    def _kept(self) -> tuple[int, ...]:
        """How many numbers each law keeps."""
        return tuple(len(law.first_memory()) for law in self.laws)

    def _memory(self, x: State, channel: int) -> Scalars:
        """What the law of a channel keeps."""
        first = self.plant.states + sum(self._kept[:channel])
        return tuple(x[first : first + self._kept[channel]])

    def _own(self, x: State) -> Scalars:
        return tuple(x[: self.plant.states])

    def _widened(self, rates: Scalars) -> Scalars:
        """Rates of the plant's states, with those of the states beside them."""
        return (*rates, *(0.0,) * (self.states - self.plant.states))

    def _tracked(self, t: RealScalarLike, x: State, channel: int) -> tuple[Scalars, Scalars]:
        """The errors of a channel, and its desired output with its derivatives."""
        desired = self.references[channel].derivatives(t, self.plant.relative_degrees[channel])
        outputs = self.plant.outputs(t, self._own(x), channel)
        return tuple(yi - di for yi, di in zip(outputs, desired, strict=False)), tuple(desired)

    def _sample(self, t: RealScalarLike, x: State, channel: int) -> Sample:
        """What the law of a channel is given of exact errors."""
        law, (errors, desired) = self.laws[channel], self._tracked(t, x, channel)
        return law.exact_sample(t, errors, desired, law.surface(errors))

"""A plant with what runs beside it, as one plant: a reference model's states, and a law's."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.control.control import AbstractControl, Sample
from qsmc_jax.control.dynamic_control import memory_at_start, memory_rates
from qsmc_jax.model.kinks import as_times
from qsmc_jax.model.own_coordinates import AbstractOwnCoordinates
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.model.reference_model import AbstractReferenceModel
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.model.state_space import AbstractStateSpace


class Accompanied(AbstractOwnCoordinates):
    """A plant whose states are its own, those of the reference model, and the memory of the law, in this order.

    Attributes:
        plant: The plant.
        reference: The reference; a model has states here.
        law: The law; None if it has no memory, or keeps it from sample to sample.
    """

    plant: AbstractPlant | AbstractStateSpace
    reference: AbstractReference | AbstractReferenceModel
    law: AbstractControl | None

    @property
    def order(self) -> int:
        return self.plant.order

    @property
    def states(self) -> int:
        """The number of states, with those beside it."""
        return self.plant.states + self._of_model + (0 if self.law is None else len(self.law.first_memory()))

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return as_times(self.plant.break_times)

    def desired(self, t: RealScalarLike, x: State) -> Scalars:
        """The desired output and its first r derivatives, r + 1 scalars.

        Args:
            t: Time [s].
            x: State.
        """
        if not isinstance(self.reference, AbstractReferenceModel):
            return self.reference.derivatives(t, self.order)
        return self.reference.derivatives(t, self._split(x)[1], self.order)

    def memory(self, x: State) -> Scalars:
        """What the law keeps; nothing if it has no memory here.

        Args:
            x: State.
        """
        return self._split(x)[2]

    def start(self, x0: State) -> Scalars:
        """The start of all states, from that of the plant's.

        Args:
            x0: That of the plant.
        """
        model = self.reference.start if isinstance(self.reference, AbstractReferenceModel) else ()
        known = (*x0, *(jnp.asarray(each, float) for each in model))
        if self.law is None:
            return known
        return (*known, *(jnp.asarray(each, float) for each in memory_at_start(self.law, self._sample(0.0, known))))

    def vector_field(self, t: RealScalarLike, x: State, d: RealScalarLike) -> Scalars:
        own, model, memory = self._split(x)
        if isinstance(self.plant, AbstractPlant):
            rates = (*own[1:], self.plant.drift(t, own) + d)
        else:
            rates = tuple(self.plant.vector_field(t, own, d))
        if isinstance(self.reference, AbstractReferenceModel):
            rates += tuple(self.reference.vector_field(t, model))
        if self.law is not None:
            rates += tuple(memory_rates(self.law, self._sample(t, x), memory))
        return rates

    def input_matrix(self, t: RealScalarLike, x: State) -> Scalars:
        own = self._split(x)[0]
        if isinstance(self.plant, AbstractPlant):
            column = (*(0.0,) * (self.order - 1), self.plant.gain(t, own))
        else:
            column = tuple(self.plant.input_matrix(t, own))
        return (*column, *(0.0,) * (self.states - self.plant.states))

    def outputs(self, t: RealScalarLike, x: State) -> Scalars:
        return self.plant.outputs(t, self._split(x)[0])

    def outputs_in_motion(
        self, t: RealScalarLike, x: State, rates: Scalars, time: float = 1.0
    ) -> tuple[Scalars, Scalars]:
        own, own_rates = self._split(x)[0], self._split(rates)[0]
        if isinstance(self.plant, AbstractPlant):
            return own, own_rates
        return self.plant.outputs_in_motion(t, own, own_rates, time)

    def gains(self, t: RealScalarLike, x: State) -> Scalars:
        own = self._split(x)[0]
        if isinstance(self.plant, AbstractPlant):
            return (*(0.0,) * (self.order - 1), self.plant.gain(t, own))
        return self.plant.gains(t, own)

    @property
    def _of_model(self) -> int:
        return self.reference.states if isinstance(self.reference, AbstractReferenceModel) else 0

    def _split(self, x: State) -> tuple[Scalars, Scalars, Scalars]:
        """The states of the plant, of the model, and of the law."""
        first, last = self.plant.states, self.plant.states + self._of_model
        return tuple(x[:first]), tuple(x[first:last]), tuple(x[last:])

    def _sample(self, t: RealScalarLike, x: State) -> Sample:
        """What the law is given of exact errors."""
        assert self.law is not None
        desired = self.desired(t, x)
        errors = tuple(yi - di for yi, di in zip(self.outputs(t, x), desired, strict=False))
        return self.law.exact_sample(t, errors, desired, self.law.surface(errors))

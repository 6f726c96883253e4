"""The closed loop as pure functions: plant, reference, disturbance and control, at one instant."""

import dataclasses
from typing import Any, ClassVar

from jaxtyping import Array

from qsmc_jax.accompanied import Accompanied
from qsmc_jax.base.checks import require
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import AbstractModule, require_fields
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.channel import Channel
from qsmc_jax.control.control import AbstractControl
from qsmc_jax.control.dynamic_control import exact_command, is_continuous, require_memory
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.implementation.implementation import Implementation, require_one_input
from qsmc_jax.model.consistency import require_derivatives
from qsmc_jax.model.disturbances import AbstractDisturbance
from qsmc_jax.model.kinks import as_times
from qsmc_jax.model.own_coordinates import AbstractOwnCoordinates
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.model.reference_model import AbstractReferenceModel
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.model.state_space import AbstractStateSpace
from qsmc_jax.model.terms import Balance, OwnTerms, Terms
from qsmc_jax.numerics.gudermann import ratio


class ClosedLoop(AbstractModule):
    r"""A plant under a controller: $\dot x_n = f + g u + d$ with $u$ from `control`, or a plant in own coordinates.

    Without an `implementation` it is the loop of the paper, in continuous time, under its law or any other that is
    smooth, and whose memory, if it has one, follows a differential equation (`AbstractDynamicControl`).

    Attributes:
        plant: The plant, of order n: a chain of integrators, or in its own coordinates (`AbstractStateSpace`; n is its
            relative degree then).
        reference: The desired output $x_{des}(t)$, at least n times differentiable, or a model that makes it
            (`AbstractReferenceModel`).
        disturbance: The disturbance $d(t)$, matched in a chain.
        control: The controller with its surface (n - 1 coefficients) and funnel.
        implementation: How the controller is implemented; None for the ideal loop.

    Raises:
        InputError: The surface does not have n - 1 coefficients, or the reference has not n derivatives, or a law that
            switches or has a memory has no implementation. Whether an implementation fits the order and the
            horizon is checked where there is one: by `Scenario` and `simulate`.

    Examples:
        The sliding variable of a pendulum at 0.5 rad and 1 rad/s, c_1 x_1 + x_2:

        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> rest, calm = qj.references.Constant(0.0), qj.disturbances.Zero()
        >>> loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), rest, calm, control)
        >>> loop.order, float(loop.sliding_variable(0.0, (0.5, 1.0)))
        (2, 2.0)

    Source: paper, eqs. (1), (2), (4).
    """

    hint: ClassVar[str] = "Make one: `qj.ClosedLoop(plant, reference, disturbance, control)`."

    plant: AbstractPlant | AbstractStateSpace | Channel | Accompanied
    reference: AbstractReference | AbstractReferenceModel
    disturbance: AbstractDisturbance
    control: AbstractControl
    implementation: Implementation | None = None

    def __check_init__(self):
        require_fields(self)
        require(
            not isinstance(self.plant, AbstractStateSpace) or len(self.plant.relative_degrees) == 1,
            f"Argument `plant` must have one input, but `{type(self.plant).__name__}` has several: make a "
            "`qj.MultivariableLoop`.",
        )
        order, has = self.plant.order, self.control.surface.order
        require(
            order == has,
            f"Argument `c` of the sliding surface must have {order - 1} coefficients for a plant of order {order}, but "
            f"has {has - 1}. `SlidingSurface.binomial(a, {order})` makes a fitting one.",
        )
        if isinstance(self.reference, AbstractReference):
            require_derivatives(self.reference, order)
        require(
            self.implementation is not None or is_continuous(self.control),
            f"Argument `implementation` must be given for a `{type(self.control).__name__}`: a law that switches or "
            "has a memory without rates can't be solved without one. `Implementation(sample_period=1e-3)` will do.",
        )
        if self.implementation is None and len(self.control.first_memory()):
            require_memory(self.control)
        self._require_fitting_implementation()

    def _require_fitting_implementation(self) -> None:
        made, told = self.implementation, "of the implementation must be left out"
        has_model = isinstance(self.reference, AbstractReferenceModel)
        require_one_input(made)
        require(
            made is None or not made.unmatched or (isinstance(self.plant, AbstractPlant) and not has_model),
            f"Argument `unmatched` {told} for a plant in its own coordinates, where `d` enters where `vector_field` "
            "has it, and with a reference model.",
        )
        require(
            made is None or made.measurement_delay is None or not has_model,
            f"Argument `measurement_delay` {told} with a reference model: its state is not known ahead. Use `delay`.",
        )

    @property
    def channels(self) -> "tuple[ClosedLoop, ...]":
        """The loop itself: it has one input. See `MultivariableLoop`."""
        return (self,)

    @property
    def order(self) -> int:
        """The order n of the plant; of one in its own coordinates its relative degree: the number of errors."""
        return self.plant.order

    @property
    def whole(self) -> "ClosedLoop":
        """The loop as it is solved: with a reference model, or a law with states, these are part of its plant."""
        law = self.control if self.implementation is None and len(self.control.first_memory()) else None
        is_whole = isinstance(self.plant, Accompanied | Channel) or (
            law is None and isinstance(self.reference, AbstractReference)
        )
        if is_whole:
            return self
        assert isinstance(self.plant, AbstractPlant | AbstractStateSpace)
        return dataclasses.replace(self, plant=Accompanied(self.plant, self.reference, law))

    @property
    def bodies(self) -> tuple[AbstractPlant | AbstractStateSpace | AbstractReferenceModel, ...]:
        """What has states and is the user's: the plant, and a reference model."""
        assert isinstance(self.plant, AbstractPlant | AbstractStateSpace)
        return (self.plant,) if isinstance(self.reference, AbstractReference) else (self.plant, self.reference)

    def start(self, x0: Any) -> Scalars:
        """The start of all its states, from that of the plant's.

        Args:
            x0: The start of the plant, a number for each of its states.
        """
        plant, own = self.whole.plant, tuple(x0[i] for i in range(self.plant.states))
        return plant.start(own) if isinstance(plant, Accompanied) else own

    @property
    def states(self) -> int:
        """The number of states: those of the plant, of a reference model, and of a law in continuous time."""
        return self.whole.plant.states

    @property
    def measured(self) -> int:
        """How many states are measured: those of the plant itself."""
        return self.plant.plant.states if isinstance(self.plant, Accompanied) else self.plant.states

    @property
    def sizes(self) -> tuple[int, int]:
        """Numbers of states and of errors."""
        return self.states, self.order

    @property
    def axis(self) -> str:
        """What a state is numbered by: derivatives of the output, unless the plant has coordinates of its own."""
        return "derivative" if isinstance(self.whole.plant, AbstractPlant) else "state"

    def widths(self, bandwidth: RealScalarLike | None) -> Scalars:
        """The bandwidth of each channel, of which there is one; twice where the funnel ends if none is given.

        Args:
            bandwidth: Bandwidth of quasi-sliding mode, in units of the sliding variable.
        """
        return (2.0 * self.control.funnel.bandwidths[0] if bandwidth is None else bandwidth,)

    def desired(self, t: RealScalarLike, x: State = ()) -> tuple[RealScalarLike, ...]:
        """The desired output and its first n derivatives at time t [s]: n + 1 scalars.

        Args:
            t: Time [s].
            x: State, which matters to a reference model alone.

        Raises:
            InputError: The reference is a model, and the loop not the `whole` one, which has its states.
        """
        if isinstance(self.plant, Accompanied):
            return self.plant.desired(t, x)
        if isinstance(self.reference, AbstractReference):
            return self.reference.derivatives(t, self.order)
        raise InputError(f"A reference model has states of its own: ask `loop.whole`, at a state of {self.states}.")

    def state(self, errors: State, desired: State) -> tuple[RealScalarLike, ...]:
        r"""The state $x_{i+1} = x_{des}^{(i)} + e^{(i)}$; `desired` is `self.desired(t)`, which callers have.

        Args:
            errors: Errors, n scalars.
            desired: Desired output and its first n derivatives.
        """
        return tuple(ei + di for ei, di in zip(errors, desired, strict=False))

    def errors(self, t: RealScalarLike, x: State) -> tuple[RealScalarLike, ...]:
        r"""The errors $e^{(i)} = x_{i+1} - x_{des}^{(i)}$, i = 0..n-1.

        Args:
            t: Time [s].
            x: State, n scalars.
        """
        return tuple(yi - di for yi, di in zip(self.plant.outputs(t, x), self.desired(t, x), strict=False))

    def errors_in_motion(self, t: RealScalarLike, x: State, rates: Scalars) -> tuple[Scalars, Scalars]:
        """The errors with their rates where the state has the given ones, n scalars each.

        Args:
            t: Time [s].
            x: State.
            rates: Its rates.
        """
        desired, (outputs, moving) = self.desired(t, x), self.plant.outputs_in_motion(t, x, rates)
        errors = tuple(yi - di for yi, di in zip(outputs, desired, strict=False))
        return errors, tuple(yi - di for yi, di in zip(moving, desired[1:], strict=True))

    def sliding_variable(self, t: RealScalarLike, x: State) -> RealScalarLike:
        r"""The sliding variable $\sigma$, paper eq. (2).

        Args:
            t: Time [s].
            x: State, n scalars.
        """
        return self.control.surface(self.errors(t, x))

    def ratio(self, t: RealScalarLike, x: State) -> RealScalarLike:
        r"""Where in the funnel the sliding variable is, $z = (\sigma - m) / \rho$, inside for $|z| < 1$.

        Args:
            t: Time [s].
            x: State, n scalars.
        """
        return (self.sliding_variable(t, x) - self.control.funnel.centre(t)) / self.control.funnel(t)

    def input(self, t: RealScalarLike, x: State) -> RealScalarLike:
        """The input u of the ideal loop, paper eq. (4); NaN outside the funnel, where that law is not defined.

        Args:
            t: Time [s].
            x: State, n scalars.
        """
        law, errors = self.control, self.errors(t, x)
        deviation = law.surface(errors) - law.funnel.centre(t)
        if isinstance(law, QuasiSlidingControl):
            return law(deviation, law.funnel(t))
        return self.command(t, x, errors, self.desired(t, x), deviation)

    def command(
        self, t: RealScalarLike, x: State, errors: State, desired: State, deviation: RealScalarLike
    ) -> RealScalarLike:
        """What a law makes of exact errors.

        Args:
            t: Time [s].
            x: State, of which the law's memory is part; nothing else of it matters.
            errors: Errors, n scalars.
            desired: Desired output and its first n derivatives.
            deviation: The sliding variable, from the funnel's centre.
        """
        memory = self.plant.memory(x) if isinstance(self.plant, Accompanied | Channel) else ()
        return exact_command(self.control, t, errors, desired, deviation, memory)

    def input_at(self, t: RealScalarLike, x: State, errors: State, desired: State, s: RealScalarLike) -> RealScalarLike:
        """The input u of the ideal loop where the funnel coordinate is known too.

        Args:
            t: Time [s].
            x: As for `command`.
            errors: Errors, n scalars.
            desired: Desired output and its first n derivatives.
            s: Funnel coordinate [-].
        """
        if isinstance(self.control, QuasiSlidingControl):
            return self.control.at(s, t)
        return self.command(t, x, errors, desired, self.control.funnel(t) * ratio(s))

    def balance(self, t: RealScalarLike, x: State, errors: State, desired: State) -> Balance:
        """The terms of the sliding variable's derivative; callers have `self.errors(t, x)` and `self.desired(t)`.

        Args:
            t: Time [s].
            x: State.
            errors: Errors, n scalars.
            desired: Desired output and its first n derivatives.
        """
        d = self.disturbed(t)
        if isinstance(self.plant, AbstractOwnCoordinates):
            _, rates = self.errors_in_motion(t, x, self.plant.vector_field(t, x, d))
            return Balance(self.control.surface(rates), self.gain(t, x), d)
        residual = self.plant.drift(t, x) - desired[self.order] + d + self.control.surface((*errors[1:], 0.0))
        return Balance(residual, self.plant.gain(t, x), d)

    def disturbed(self, t: RealScalarLike) -> Any:
        """The value of the disturbance; in a channel of several inputs those of all disturbances.

        Args:
            t: Time [s].
        """
        return self.plant.disturbed(t) if isinstance(self.plant, Channel) else self.disturbance(t)

    def plain(self, t: RealScalarLike, balance: Balance) -> Balance:
        """The balance as the plain tangent sees it: as if gain and offset of the paper's law were the plant's.

        Args:
            t: Time [s].
            balance: The balance then.
        """
        law = self.control
        if not isinstance(law, QuasiSlidingControl):
            return balance
        return balance._replace(
            residual=balance.residual + balance.gain * law.offset, gain=balance.gain * law.gain_at(t)
        )

    def gain(self, t: RealScalarLike, x: State) -> RealScalarLike:
        """The gain g of the sliding variable's derivative.

        Args:
            t: Time [s].
            x: State.
        """
        if isinstance(self.plant, AbstractPlant):
            return self.plant.gain(t, x)
        return self.control.surface(self.plant.gains(t, x))

    def driven(self, t: RealScalarLike, x: State, u: RealScalarLike) -> Scalars:
        """The state's derivative in the ideal loop under the input u.

        Args:
            t: Time [s].
            x: State.
            u: Input.
        """
        if isinstance(self.plant, AbstractPlant):
            return self.rates(self.terms(t, x), x, u)
        free, reach = self.plant.vector_field(t, x, self.disturbed(t)), self.plant.input_matrix(t, x)
        return tuple(fi + gi * u for fi, gi in zip(free, reach, strict=True))

    def coasted(self, t: RealScalarLike, x: State, dt: RealScalarLike) -> Scalars:
        """The state a moment later without input; in a chain of integrators but for the last, which no other shows.

        Args:
            t: Time [s].
            x: State.
            dt: How much later [s].
        """
        rates = (*x[1:], 0.0) if isinstance(self.plant, AbstractPlant) else self.driven(t, x, 0.0)
        return tuple(xi + dt * rate for xi, rate in zip(x, rates, strict=True))

    def terms(self, t: RealScalarLike, x: State) -> Terms | OwnTerms:
        """What moves the plant at time t and state x, apart from the input.

        Args:
            t: Time [s].
            x: State, n scalars.
        """
        implementation, plant = self.implementation, self.plant
        fault = None if implementation is None else implementation.gain_fault
        if isinstance(plant, AbstractOwnCoordinates):
            d, part = self.disturbed(t), 1.0 if fault is None else fault(t)
            reach = tuple(gi * part for gi in plant.input_matrix(t, x))
            return OwnTerms(tuple(plant.vector_field(t, x, d)), reach, self.gain(t, x) * part, d)
        gain = plant.gain(t, x)
        if fault is not None:
            gain = gain * fault(t)
        unmatched = () if implementation is None else tuple(signal(t) for signal in implementation.unmatched)
        return Terms(plant.drift(t, x), gain, self.disturbance(t), unmatched or (0.0,) * (self.order - 1))

    def rates(self, terms: Terms | OwnTerms, x: State, u: RealScalarLike) -> Scalars:
        """The state's derivative under the input u, paper eq. (1); `terms` is `self.terms(t, x)`.

        Args:
            terms: What moves the plant, apart from the input.
            x: State, n scalars.
            u: Input.
        """
        if isinstance(terms, OwnTerms):
            return tuple(fi + gi * u for fi, gi in zip(terms.free, terms.reach, strict=True))
        chain = (xi + di for xi, di in zip(x[1:], terms.unmatched, strict=True))
        return (*chain, terms.drift + terms.gain * u + terms.disturbance)

    def vector_field(self, t: RealScalarLike, x: State) -> Scalars:
        """The state's derivative in the ideal loop, paper eq. (1) under eq. (4); NaN outside the funnel.

        Args:
            t: Time [s].
            x: State, n scalars.
        """
        return self.driven(t, x, self.input(t, x))

    @property
    def breaks_by_part(self) -> list[Array]:
        """Times [s] at which the right-hand side jumps or kinks, other than at samples, for each of its parts."""
        parts = [self.plant, self.reference, self.disturbance, self.control.funnel, self.implementation]
        return [as_times(part.break_times) for part in parts if part is not None]

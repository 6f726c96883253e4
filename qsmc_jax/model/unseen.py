r"""What the functions of a loop can hide within a step, by kind: closed forms for the library's own.

The others are enclosed (`enclosures/unseen.py`), whatever they are made of. A library signal that jumps or kinks says
so in its `break_times`, at which steps end; between these it is smooth, and bounds of its derivatives do.
"""

import functools as ft
import math
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.enclosures.unseen import Step, Unseen, unseen
from qsmc_jax.model import references
from qsmc_jax.model.disturbances import (
    AbstractDisturbance,
    BandLimitedNoise,
    Constant,
    Piecewise,
    Recorded,
    Scaled,
    Sine,
    SmoothSteps,
    Sum,
    SumOfSines,
    Telegraph,
    Zero,
)
from qsmc_jax.model.plants import AbstractPlant, FourthOrderExample, InvertedPendulum
from qsmc_jax.model.recording import Recording
from qsmc_jax.model.reference_model import AbstractReferenceModel
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.model.state_space import AbstractStateSpace

# Largest values of the first derivatives of the quintic smoothstep, by order.
_STEEPEST_RAMP = {1: 1.875, 2: 5.7735, 3: 60.0, 4: 360.0, 5: 720.0}


@ft.singledispatch
def unseen_in_signal(signal: AbstractDisturbance, step: Step) -> Unseen:
    """What a disturbance can hide in a step."""
    return unseen(signal, step)


@unseen_in_signal.register(Zero)
@unseen_in_signal.register(Constant)
@unseen_in_signal.register(Telegraph)
def _(signal: AbstractDisturbance, step: Step) -> Unseen:
    return _amount(0.0)


@unseen_in_signal.register
def _(signal: Sine, step: Step) -> Unseen:
    waves = step.beyond_polynomial(lambda m: jnp.abs(signal.amplitude) * jnp.abs(signal.frequency) ** m)
    return _amount(jnp.minimum(waves, 2.0 * jnp.abs(signal.amplitude)))


@unseen_in_signal.register
def _(signal: SumOfSines, step: Step) -> Unseen:
    sizes = jnp.abs(signal.amplitudes)
    waves = step.beyond_polynomial(lambda m: jnp.sum(sizes * jnp.abs(signal.frequencies) ** m))
    return _amount(jnp.minimum(waves, 2.0 * jnp.sum(sizes)))


@unseen_in_signal.register
def _(signal: BandLimitedNoise, step: Step) -> Unseen:
    r"""By $|(\bar d \tanh(v / \bar d))''| \le |v''| + 0.77 v'^2 / \bar d$."""
    sizes = jnp.abs(signal.amplitudes)
    slope, bend = (jnp.sum(sizes * jnp.abs(signal.frequencies) ** m) for m in (1, 2))
    chords = step.beyond_chords(bend + 0.77 * slope**2 / signal.limit)
    return _amount(jnp.minimum(chords, 2.0 * signal.limit))


@unseen_in_signal.register
def _(signal: SmoothSteps, step: Step) -> Unseen:
    """A polynomial of degree 5 between its break times."""
    jumps = jnp.sum(jnp.abs(jnp.diff(signal.levels)))
    steepest = lambda m: _STEEPEST_RAMP.get(m, 0.0) * jumps / signal.rise_time**m  # noqa: E731
    return _amount(step.beyond_polynomial(steepest)) if step.nodes.order in _STEEPEST_RAMP else _amount(0.0)


@unseen_in_signal.register
def _(signal: Recorded, step: Step) -> Unseen:
    return _between_samples(signal.recording, 0, step)


@unseen_in_signal.register
def _(signal: Sum, step: Step) -> Unseen:
    return joined([unseen_in_signal(term, step) for term in signal.terms])


@unseen_in_signal.register
def _(signal: Scaled, step: Step) -> Unseen:
    inner = unseen_in_signal(signal.disturbance, step)
    return inner if is_nothing(inner.amount) else _amount(jnp.abs(signal.scale) * inner.amount, inner.probed)


@unseen_in_signal.register
def _(signal: Piecewise, step: Step) -> Unseen:
    return joined([unseen_in_signal(piece, step) for piece in signal.pieces])


@ft.singledispatch
def within(signal: AbstractDisturbance, t: RealScalarLike) -> Callable[[RealScalarLike], RealScalarLike]:
    """A disturbance as it is around a time, from one break time to the next: what is enclosed need not hold a record.

    Args:
        signal: The disturbance.
        t: Time [s].
    """
    return signal


@within.register
def _(signal: Recorded, t: RealScalarLike) -> Callable[[RealScalarLike], RealScalarLike]:
    return signal.recording.piece(t)


@within.register
def _(signal: Scaled, t: RealScalarLike) -> Callable[[RealScalarLike], RealScalarLike]:
    inner = within(signal.disturbance, t)
    return lambda s: signal.scale * inner(s)


@within.register
def _(signal: Sum, t: RealScalarLike) -> Callable[[RealScalarLike], RealScalarLike]:
    parts = [within(term, t) for term in signal.terms]
    return lambda s: sum(part(s) for part in parts)


@ft.singledispatch
def unseen_in_reference(reference: Any, order: int, step: Step) -> Unseen:
    """What a derivative of a reference can hide in a step; `order` 0 is the reference itself."""
    return unseen(lambda t: reference.derivatives(t, order)[order], step)


@unseen_in_reference.register
def _(reference: references.Constant, order: int, step: Step) -> Unseen:
    return _amount(0.0)


@unseen_in_reference.register
def _(reference: references.SumOfSines, order: int, step: Step) -> Unseen:
    sizes = jnp.abs(reference.amplitudes) * jnp.abs(reference.frequencies) ** order
    waves = step.beyond_polynomial(lambda m: jnp.sum(sizes * jnp.abs(reference.frequencies) ** m))
    return _amount(jnp.minimum(waves, 2.0 * jnp.sum(sizes)))


@unseen_in_reference.register
def _(reference: references.Recorded, order: int, step: Step) -> Unseen:
    return _between_samples(reference.recording, order, step)


@unseen_in_reference.register(AbstractReferenceModel)
def _(reference: AbstractReferenceModel, order: int, step: Step) -> Unseen:
    """Nothing as a function of time: it is part of what moves the state."""
    return _amount(0.0)


def is_consistent(reference: AbstractReference | AbstractReferenceModel) -> bool:
    """Whether a reference is continuous and its derivatives are its own by construction."""
    return isinstance(
        reference, references.Constant | references.SumOfSines | references.Recorded | AbstractReferenceModel
    )


@ft.singledispatch
def gain_range(plant: AbstractPlant | AbstractStateSpace) -> tuple[RealScalarLike, RealScalarLike]:
    """Bounds of the gain over all times and states; NaN where none are known."""
    return math.nan, math.nan


@gain_range.register
def _(plant: InvertedPendulum) -> tuple[RealScalarLike, RealScalarLike]:
    gain = 1.0 / (plant.mass * plant.length**2)
    return gain, gain


@gain_range.register
def _(plant: FourthOrderExample) -> tuple[RealScalarLike, RealScalarLike]:
    r"""By $1 \le 2 - \sin x_4 \le 3$."""
    return plant.gain_scale, 3.0 * plant.gain_scale


def is_known(plant: AbstractPlant | AbstractStateSpace | AbstractReferenceModel) -> bool:
    """Whether a plant is one of the library's: its drift, sines of the state, hides nothing within a step."""
    return gain_range.dispatch(type(plant)) is not gain_range.dispatch(object)


def is_own(signal: AbstractDisturbance) -> bool:
    """Whether a disturbance is one of the library's, down to its parts."""
    parts = [part for value in vars(signal).values() for part in (value if isinstance(value, tuple) else (value,))]
    inner = [part for part in parts if isinstance(part, AbstractDisturbance)]
    is_closed = unseen_in_signal.dispatch(type(signal)) is not unseen_in_signal.dispatch(object)
    return is_closed and all(map(is_own, inner))


def _between_samples(recording: Recording, order: int, step: Step) -> Unseen:
    """A polynomial between samples, at which steps end."""
    is_shown = recording.degree - order < step.nodes.order
    return _amount(0.0 if is_shown else step.beyond_polynomial(lambda m: recording.steepest(order + m)))


def joined(parts: list[Unseen]) -> Unseen:
    """What a sum can hide, from what its terms can."""
    amounts = [part.amount for part in parts if not is_nothing(part.amount)]
    probed = tuple(sorted({name for part in parts for name in part.probed}))
    return _amount(sum(amounts) if amounts else 0.0, probed)


def _amount(amount: RealScalarLike, probed: tuple[str, ...] = ()) -> Unseen:
    return Unseen(amount, math.nan, math.nan, probed)


def is_nothing(amount: RealScalarLike) -> bool:
    """Whether an amount is zero whatever the numbers are, so that nothing need be computed."""
    return isinstance(amount, float) and amount == 0.0

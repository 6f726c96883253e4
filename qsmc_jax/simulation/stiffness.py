"""How stiff a loop will be, from its numbers alone, and the method for it."""

import dataclasses
import functools as ft
import math
from collections.abc import Hashable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from qsmc_jax.base.checks import is_traced
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.channel import Channel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.numerics.gudermann import ratio
from qsmc_jax.simulation.settings import Method, SolverSettings

# Up to this stiffness an explicit method's steps are short for accuracy, not for stability, and half as dear. Measured
# at rtol 1e-6: the two methods take the same time at some 1000 in Example 1 of the paper, 2500 in Example 2.
EXPLICIT_UP_TO = 2000.0
# Instants at which the rate is looked at, more of them early.
_INSTANTS = 48
# Between which funnel coordinates the balance of a law is looked for, and by how many halvings.
_NEAR_EDGE, _HALVINGS = 20.0, 20

# Methods that stand for one of two, by the stiffness of each run.
BY_STIFFNESS = ("auto", "other")

# The method that shares no step with a given one: an explicit one against an implicit one.
OTHER: dict[str, Method] = {
    "auto": "other",
    "other": "auto",
    "tsit5": "rodas5p",
    "rodas4": "tsit5",
    "rodas5p": "tsit5",
}


@entry_point
def stiffness(
    loop: ClosedLoop | MultivariableLoop, x0: Any, t1: RealScalarLike, made_of: Hashable = ()
) -> RealScalarLike:
    r"""Decay times of the sliding variable in a run to `t1`, $\int_0^{t_1} |g| \frac{\pi}{2 \rho} (1 + u^2) dt$ [-].

    Along the reference, with the input that holds the sliding variable there and drives it in with the funnel. An
    explicit method needs about a third as many steps at the least. A loop with an implementation is open between
    samples: 0. Of several channels the stiffest counts, with the others' inputs as they are at rest; with none where
    laws are others than the quasi-sliding one.
    """
    if loop.implementation is not None:
        return 0.0
    return _decays(loop, jnp.asarray(x0), jnp.asarray(t1), made_of)


@eqx.filter_jit
def _decays(loop: ClosedLoop | MultivariableLoop, x0: Array, t1: Array, made_of: Hashable) -> Array:
    del made_of  # by which the program is kept
    loop, x0 = loop.whole, jnp.stack(loop.start(x0))
    if isinstance(loop, MultivariableLoop):
        x0 = jnp.concatenate([x0, jnp.zeros(len(loop.controls))])  # the funnel coordinates of `Channel`, at rest
    return ft.reduce(jnp.maximum, [_of_channel(each, x0, t1) for each in loop.channels])


def _of_channel(loop: ClosedLoop, x0: Array, t1: Array) -> Array:
    fractions = (np.arange(_INSTANTS) + 0.5) / _INSTANTS
    rates = jax.vmap(lambda t: _decay_rate(loop, x0, t))(t1 * fractions**3)
    return t1 * jnp.sum(rates * 3.0 * fractions**2) / _INSTANTS


def _decay_rate(loop: ClosedLoop, x0: Array, t: Array) -> Array:
    """The rate at which a deviation of the sliding variable decays at time t, where the errors are zero [1/s].

    In a plant in its own coordinates nobody knows where that is: at the start's state.
    """
    rest, desired = (0.0,) * loop.order, loop.desired(t, tuple(x0))
    is_chain = isinstance(loop.plant, AbstractPlant)
    balance = _at_rest(loop).balance(t, loop.state(rest, desired) if is_chain else tuple(x0), rest, desired)
    law, balance = loop.control, loop.plain(t, balance)
    gain, load = jnp.abs(balance.gain), law.funnel.load(t, balance.residual)
    if not isinstance(law, QuasiSlidingControl):
        centre, centre_rate = law.funnel.centre_and_rate(t)
        there = _balanced(loop, t, tuple(x0), desired, jnp.sign(balance.residual - centre_rate) * load, balance.gain)
        return gain * steepness(loop, t, tuple(x0), (*rest[:-1], there + centre), desired, there)
    input_ = load / jnp.where(gain > 0.0, gain, 1.0)
    return gain * (0.5 * math.pi) / law.funnel(t) * (1.0 + input_**2)


def _at_rest(loop: ClosedLoop) -> ClosedLoop:
    """A loop as it is where the others' inputs are at rest, if it is a channel of several."""
    plant = loop.plant
    if not isinstance(plant, Channel) or all(isinstance(law, QuasiSlidingControl) for law in plant.laws):
        return loop
    return dataclasses.replace(loop, plant=dataclasses.replace(plant, laws=(), references=()))


def steepness(
    loop: ClosedLoop, t: RealScalarLike, x: State, errors: State, desired: State, deviation: RealScalarLike
) -> RealScalarLike:
    """The size of the input's derivative in the sliding variable, with the law's memory as it is.

    Args:
        loop: The loop.
        t: Time [s].
        x: As for `ClosedLoop.command`.
        errors: Errors, n scalars.
        desired: Desired output and its first n derivatives.
        deviation: The sliding variable, from the funnel's centre.
    """

    def along(step: RealScalarLike) -> RealScalarLike:
        return jnp.asarray(loop.command(t, x, (*errors[:-1], errors[-1] + step), desired, deviation + step))

    return jnp.abs(jax.jvp(along, (jnp.zeros(()),), (jnp.ones(()),))[1])


def _balanced(
    loop: ClosedLoop, t: Array, x0: Scalars, desired: Scalars, load: RealScalarLike, gain: RealScalarLike
) -> RealScalarLike:
    """Where in the funnel a law of the user's balances a load, from the centre; at an edge if nowhere."""
    funnel, rest = loop.control.funnel, (0.0,) * (loop.order - 1)

    def halved(_: Any, ends: tuple[Array, Array]) -> tuple[Array, Array]:
        middle = 0.5 * (ends[0] + ends[1])
        deviation = funnel(t) * ratio(middle)
        u = loop.command(t, x0, (*rest, deviation + funnel.centre(t)), desired, deviation)
        is_below = load + gain * u > 0.0
        return jnp.where(is_below, middle, ends[0]), jnp.where(is_below, ends[1], middle)

    ends = jnp.full((), -_NEAR_EDGE), jnp.full((), _NEAR_EDGE)
    low, high = jax.lax.fori_loop(0, _HALVINGS, halved, ends)
    return funnel(t) * ratio(0.5 * (low + high))


def method_for(stiffness: float, nominal: float, asked_for: Method = "auto") -> Method:
    """The method for a run of the given stiffness, in a study whose nominal run has the other.

    A second method is a second program to compile: only runs that are much stiffer than the nominal one are worth it.
    """
    if asked_for not in BY_STIFFNESS:
        return asked_for
    return _of_two(is_stiff(stiffness, nominal), asked_for)


def is_stiff(stiffness: Any, nominal: float) -> Any:
    """Whether a run is stiff, or each of several: by its stiffness, and that of the nominal run of its study."""
    return (nominal > EXPLICIT_UP_TO) | (stiffness > 3.0 * EXPLICIT_UP_TO)


def rows_by_method(
    stiffness: Float[np.ndarray, " runs"], nominal: float, asked_for: Method
) -> list[tuple[str, Int[np.ndarray, " rows"]]]:
    """The runs for each method, as `method_for` has it one by one, of all runs of a window at once."""
    if asked_for not in BY_STIFFNESS:
        return [(asked_for, np.arange(len(stiffness)))]
    stiff = is_stiff(stiffness, nominal)
    parts = [(_of_two(each, asked_for), np.flatnonzero(stiff == each)) for each in (True, False)]
    return sorted((method, rows) for method, rows in parts if len(rows))


def _of_two(stiff: Any, asked_for: Method) -> Method:
    return "rodas5p" if stiff == (asked_for == "auto") else "tsit5"


def with_method(
    settings: SolverSettings, loop: ClosedLoop | MultivariableLoop, x0: Any, t1: RealScalarLike, made_of: Hashable = ()
) -> SolverSettings:
    """The settings with a method in place of `"auto"` or `"other"`; as for a loop that is not stiff while it is traced.

    Args:
        settings: The settings.
        loop: The loop.
        x0: Its start, n numbers.
        t1: The horizon [s].
        made_of: As for `pose`.
    """
    if settings.method not in BY_STIFFNESS:
        return settings
    own = 0.0 if is_traced(loop, x0, t1) else float(stiffness(loop, x0, t1, made_of))
    return settings.replace(method=method_for(own, own, settings.method))

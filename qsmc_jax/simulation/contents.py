"""What the functions of a loop compute, by hashes."""

from collections.abc import Callable
from typing import Any, TypeAlias

import jax
import numpy as np

from qsmc_jax.base.types import Scalars
from qsmc_jax.control.control import AbstractControl, Beyond, Sample
from qsmc_jax.control.dynamic_control import memory_at_start, memory_rates
from qsmc_jax.control.funnel import Funnel
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.implementation.actuators import AbstractActuator
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.components import components
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.simulation.finite import is_ours
from qsmc_jax.tracing.digest import digest
from qsmc_jax.tracing.traceable import trace

# Hashes by part: "drift of `Mine`", ...
Contents: TypeAlias = tuple[tuple[str, str], ...]
# A module, what it does, and the shapes of what that is given.
_Part: TypeAlias = tuple[Any, Callable[..., Any], tuple[Any, ...]]


def brought(loop: ClosedLoop | MultivariableLoop) -> Contents:
    """The same, but nothing for a loop in which all is the library's."""
    is_papers = all(isinstance(channel.control, QuasiSlidingControl) for channel in loop.channels)
    is_plain = loop.implementation is None and not any(map(callable, jax.tree.leaves(loop)))
    return () if is_ours(loop) and is_papers and is_plain else functions_of(loop)


def functions_of(loop: ClosedLoop | MultivariableLoop) -> Contents:
    """Hashes of the programs of what the user may have written, for numbers of the loop that are not known yet.

    Whatever such a function reads from outside, a global say, is in them: JAX keeps programs by what a loop looks like.
    """
    number = jax.ShapeDtypeStruct((), np.float64)
    parts: dict[str, _Part] = {
        f"{name} of `{type(body).__name__}`": (body, each, (number, (number,) * body.states, number))
        for body in loop.bodies
        for name, each in components(body).items()
    }
    for i, channel in enumerate(loop.channels):
        of = f" of channel {i}" if len(loop.channels) > 1 else ""
        found = _signals(channel)
        if channel.implementation is not None:
            found |= _law(channel, channel.implementation.beyond) | _implemented(channel.implementation)
        elif not isinstance(channel.control, QuasiSlidingControl):
            found |= _law(channel, "wrap")
        parts |= {f"{name}{of}": part for name, part in found.items()}
    return tuple((name, digest(trace(name, "its arguments", *part[:2], *part[2])[0])) for name, part in parts.items())


def _signals(loop: ClosedLoop) -> dict[str, _Part]:
    """The same of disturbance, reference and funnel."""
    number = jax.ShapeDtypeStruct((), np.float64)
    parts: dict[str, _Part] = {
        f"disturbance `{type(loop.disturbance).__name__}`": (loop.disturbance, lambda d, t: d(t), (number,))
    }
    if isinstance(loop.reference, AbstractReference):
        name = f"reference `{type(loop.reference).__name__}`"
        parts[name] = loop.reference, lambda reference, t: reference.derivatives(t, loop.order), (number,)
    if not isinstance(loop.control.funnel, Funnel):
        name = f"funnel `{type(loop.control.funnel).__name__}`"
        parts[name] = loop.control.funnel, lambda f, t: (f.width_and_rate(t), f.centre_and_rate(t)), (number,)
    return parts


def _law(loop: ClosedLoop, beyond: Beyond) -> dict[str, _Part]:
    """The same of a controller, whose law may be anybody's."""
    number, control = jax.ShapeDtypeStruct((), np.float64), loop.control

    def command(control: AbstractControl, t: Any, period: Any, sigma: Any, rho: Any, *known: Scalars) -> Any:
        desired, memory, errors = known
        sample = Sample(t, period, sigma, rho, desired, beyond, control.funnel.centre(t), errors)
        at_start = memory_at_start(control, sample), memory_rates(control, sample, memory)
        return control.first_memory(), control.command(sample, memory), at_start

    memory = (number,) * len(control.first_memory())
    given = number, number, number, number, (number,) * (loop.order + 1), memory, (number,) * loop.order
    return {f"command of `{type(control).__name__}`": (control, command, given)}


def _implemented(made: Implementation) -> dict[str, _Part]:
    """The same of what is between the plant and its controller."""
    number, actuator = jax.ShapeDtypeStruct((), np.float64), made.actuator

    def move(actuator: AbstractActuator, state: Scalars, *rest: Any) -> Any:
        motion = actuator.move(state, *rest), actuator.swing(state, *rest)
        return actuator.rest(), motion, actuator.kinks(state, rest[0])

    parts: dict[str, _Part] = {}
    for i, signal in enumerate(made.unmatched):
        parts[f"unmatched disturbance {i} `{type(signal).__name__}`"] = (signal, lambda d, t: d(t), (number,))
    if made.noise is not None:
        count = jax.ShapeDtypeStruct((), np.int64)
        parts[f"noise `{type(made.noise).__name__}`"] = (made.noise, lambda noise, t, k: noise(t, k), (number, count))
    if actuator is not None:
        state = (number,) * len(actuator.rest())
        parts[f"actuator `{type(actuator).__name__}`"] = (actuator, move, (state, number, number))
    return parts

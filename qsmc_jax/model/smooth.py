"""The check that a function of time is smooth.

Smooth is what has no kinks or jumps, in any derivative up to the third. A function passes

- if neither its traced program nor that of its derivative has an operation that makes kinks or jumps (kinks.py has
  them) on a number that depends on time. Tests for equality are none: they guard single points, as in `jnp.sinc`;
- or if all such operations can be followed (crossings.py does), and its values show none of what they might make: where
  the function switches from one piece to another, between 0 and 1e6 s, all derivatives continue. So
  `jax.nn.logsumexp` passes, and a `jnp.where` that only guards. Where a derivative is stopped (`jax.lax.stop_gradient`)
  the others must still be those of the function, by differences.

In a loop (`jax.lax.scan`, also inside `jnp.interp`) a smooth function may be refused needlessly. A function that holds
a traced number is followed when the number is known, as it is in the nominal scenario of a study.
"""

import functools as ft
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.checks import is_traced, require, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import entry_point
from qsmc_jax.model.crossings import UNDERSTOOD, in_batches, jumps, switches, with_decisions
from qsmc_jax.model.derivatives import scalar, tower
from qsmc_jax.model.kinks import kinks, uses
from qsmc_jax.tracing.programs import Program, UnknownProgramError, parts, shape_of
from qsmc_jax.tracing.traceable import traceable

_HIGHEST = 3  # derivative that is compared: the errors of a plant of order 4 have three
_MOST = 512  # switches looked at
# A guard such as `where(t > 1e-3, sin(t) / t, ...)` leaves some rounding, more with each derivative: a jump below this
# share of what a derivative usually is in the first seconds is none.
_NEGLIGIBLE, _USUAL = 1e-7 * 10.0 ** np.arange(_HIGHEST + 1), np.linspace(0.1, 10.0, 100)[:, None]
_DIFFERENCE = 1e-5  # relative step in time at which a difference is right to some ten digits, were it exact
_AGREEMENT = 1e-4


def require_smooth(fn: Callable[..., Any]) -> None:
    """Raises unless `fn` is a smooth function of time, by the rule of this file, that returns one number."""
    try:
        _require_smooth(fn)
    except UnknownProgramError as error:
        raise InputError(
            "Argument `fn` of `Smooth` must be smooth, but with this version of JAX nobody can tell: "
            f"{error}. Install an older one, or subclass the abstract class with derivatives of your own."
        ) from error


def _require_smooth(fn: Callable[..., Any]) -> None:
    number = ft.partial(scalar, fn)
    program = _traced(number)
    shape = shape_of(parts(program).outputs[0])
    require(shape == (), f"Argument `fn` of `Smooth` must return a single number, but has shape {shape}.")
    _require_no_hidden_tracer(fn, program)
    _require_forward_derivative(program)
    found = kinks(program) + kinks(_traced(tower(number, 1)))
    names = {use.eqn.name for use in found}
    can_be_followed = names <= UNDERSTOOD and not any(use.is_looped for use in found)
    require(not found or can_be_followed, _refusal(names, "in a way that can't be followed"))
    if is_traced(fn):
        return
    if found:
        why = _kink(fn) or ("stop_gradient" in names and _false_derivative(fn))
        require(not why, _refusal(names, f"and {why}"))
    _require_finite_start(number)


def _traced(fn: Callable[..., Any]) -> Program:
    try:
        with traceable("Argument `fn` of `Smooth`", "the time"):
            return jax.make_jaxpr(fn)(jnp.zeros(()))
    except TypeError as error:
        raise InputError(
            f"Argument `fn` of `Smooth` must be a function of time, but calling it says: {error}."
        ) from error


def _require_no_hidden_tracer(fn: Callable[..., Any], program: Program) -> None:
    visible = {id(leaf) for leaf in jax.tree.leaves(fn)}
    hidden = [value for value in parts(program).constants.values() if is_traced(value) and id(value) not in visible]
    require(
        not hidden,
        "Argument `fn` of `Smooth` must show the numbers it depends on, but has a traced number in its "
        "closure. Write `Smooth(eqx.Partial(fn, number))` with `fn(number, t)`, or make it an `eqx.Module` that holds "
        "the number.",
    )


def _require_forward_derivative(program: Program) -> None:
    # Tracing would let it pass, and compiling the solve would then fail.
    names = {use.eqn.name for use in uses(program)}
    require(
        "custom_vjp_call" not in names,
        "Argument `fn` of `Smooth` must have a forward derivative, but uses a `jax.custom_vjp`, which has "
        "only a reverse one. Use `jax.custom_jvp`.",
    )


def _refusal(names: set[str], why: str) -> str:
    used = ", ".join(f"`{name}`" for name in sorted(names))
    return (
        f"Argument `fn` of `Smooth` must be smooth, but uses {used} on a number that depends on time, "
        f"{why}. Use a smooth function in its place (`jnp.tanh` for a switch, `jnp.logaddexp` for a maximum), or "
        "subclass the abstract class with derivatives of your own, and `break_times` for what the highest one does."
    )


@entry_point
def _kink(fn: Callable[..., Any]) -> str:
    """What a function does at a kink or jump, in words; empty if it has none."""
    # Sizes from 1e-6 to 1e6 s, and evenly spaced times for what repeats itself, by a step that is no round one.
    ts = np.sort(np.concatenate([[0.0], np.logspace(-6.0, 6.0, 200), np.arange(1, 600) * 0.12618034]))[:, None]
    a, b = switches(ft.partial(in_batches, ft.partial(_decided, fn)), ts[:-1], ts[1:], _MOST)
    if len(a) == 0:
        return ""
    differentiated = ft.partial(in_batches, ft.partial(_differentiated, fn))
    with np.errstate(invalid="ignore"):
        usual = np.nanmedian(np.abs(differentiated(_USUAL)), axis=0)
    is_jump, before, after = jumps(differentiated, a, b, _NEGLIGIBLE * np.nan_to_num(usual))
    places, orders = np.nonzero(is_jump)
    if len(places) == 0:
        return ""
    place, k = places[0], orders[0]
    at = 0.0 if abs(b[place, 0]) < 1e-12 else b[place, 0]  # the halving of zero ends in 1e-30
    what = f"derivative {k}" if k else "it"
    return f"{what} jumps from {show(before[place, k])} to {show(after[place, k])} at t = {show(at)}"


@entry_point
def _false_derivative(fn: Callable[..., Any]) -> str:
    """Which derivative is not that of the one before, in words; empty if all are."""
    ts = np.logspace(-2.0, 2.0, 64)[:, None]
    step = _DIFFERENCE * (1.0 + ts)
    before, given, after = (in_batches(ft.partial(_differentiated, fn), t) for t in (ts - step, ts, ts + step))
    differences = ((after - before) / (2.0 * step))[:, :-1]
    wrong = np.abs(differences - given[:, 1:]) > _AGREEMENT * np.max(np.abs(given[:, 1:]), axis=0, initial=1e-300)
    wrong &= np.abs(differences - given[:, 1:]) > 1e-9 * np.max(np.abs(given[:, :-1]), axis=0) / step
    orders = np.nonzero(np.any(wrong, axis=0))[0]
    return f"derivative {orders[0] + 1} is not that of the function" if len(orders) else ""


@eqx.filter_jit
def _decided(fn: Callable[..., Any], points: Any) -> Any:
    """The decisions on the way to value and derivative, a row a time."""

    def lowest(t: Any) -> Any:
        return jnp.stack(tower(ft.partial(scalar, fn), 1)(t))

    return jax.vmap(lambda t: with_decisions(lowest, (t,))[1])(points[:, 0])


@eqx.filter_jit
def _differentiated(fn: Callable[..., Any], points: Any) -> Any:
    """Value and derivatives, a row a time."""
    return jax.vmap(lambda t: jnp.stack(tower(ft.partial(scalar, fn), _HIGHEST)(t)))(points[:, 0])


def _require_finite_start(fn: Callable[..., Any]) -> None:
    with jax.ensure_compile_time_eval():
        start = np.asarray(jnp.stack(tower(fn, 1)(jnp.zeros(()))))
    require(
        bool(np.all(np.isfinite(start))),
        "Argument `fn` of `Smooth` must be finite with a finite derivative at t = 0, but these are "
        f"{show(start)}. Shift or rewrite it: runs start there.",
    )

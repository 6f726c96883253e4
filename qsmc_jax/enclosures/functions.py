"""Interval rules of the elementary functions: those that grow, and those that turn."""

import functools as ft
import math
from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from qsmc_jax.enclosures.intervals import RULES, Enclosed, Interval, absolute, interval, rule
from qsmc_jax.enclosures.rounding import Rounding

_GROWING: dict[str, tuple[Callable[[Any], Any], float, float]] = {
    "exp": (jnp.exp, -math.inf, math.inf),
    "exp2": (jnp.exp2, -math.inf, math.inf),
    "expm1": (jnp.expm1, -math.inf, math.inf),
    "log": (jnp.log, 0.0, math.inf),
    "log1p": (jnp.log1p, -1.0, math.inf),
    "sqrt": (jnp.sqrt, 0.0, math.inf),
    "cbrt": (jnp.cbrt, -math.inf, math.inf),
    "tanh": (jnp.tanh, -math.inf, math.inf),
    "sinh": (jnp.sinh, -math.inf, math.inf),
    "asinh": (jnp.arcsinh, -math.inf, math.inf),
    "acosh": (jnp.arccosh, 1.0, math.inf),
    "atanh": (jnp.arctanh, -1.0, 1.0),
    "asin": (jnp.arcsin, -1.0, 1.0),
    "atan": (jnp.arctan, -math.inf, math.inf),
    "logistic": (jax.nn.sigmoid, -math.inf, math.inf),
    "erf": (jax.lax.erf, -math.inf, math.inf),
    "erf_inv": (jax.lax.erf_inv, -1.0, 1.0),
}


def _grow(
    function: Callable[[Any], Any], low: float, high: float, rounding: Rounding, a: Interval, **_: Any
) -> Interval:
    inside = Interval(jnp.clip(a.lo, low, high), jnp.clip(a.hi, low, high))
    return rounding(Interval(function(inside.lo), function(inside.hi)), units=8)


for _name, _entry in _GROWING.items():
    RULES[_name] = ft.partial(_grow, *_entry)


@rule("acos")
def _acos(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    low, high = jnp.clip(a.lo, -1.0, 1.0), jnp.clip(a.hi, -1.0, 1.0)
    return rounding(Interval(jnp.arccos(high), jnp.arccos(low)), units=8)


@rule("erfc")
def _erfc(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    return rounding(Interval(jax.lax.erfc(a.hi), jax.lax.erfc(a.lo)), units=16)


@rule("rsqrt")
def _rsqrt(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    low, high = jnp.maximum(a.lo, 0.0), jnp.maximum(a.hi, 0.0)
    return rounding(Interval(jax.lax.rsqrt(high), jax.lax.rsqrt(low)), units=8)


@rule("cosh")
def _cosh(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    size = absolute(rounding, a)
    return rounding(Interval(jnp.cosh(size.lo), jnp.cosh(size.hi)), units=8)


@rule("sin")
def _sin(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    return _wave(rounding, a, jnp.sin, 0.25)


@rule("cos")
def _cos(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    return _wave(rounding, a, jnp.cos, 0.0)


def _wave(rounding: Rounding, a: Interval, function: Callable[[Any], Any], crest: float) -> Interval:
    """Sine or cosine, whose crests lie at `crest` turns: the ends, and the extremes between them."""
    ends = function(a.lo), function(a.hi)
    known = rounding(Interval(jnp.minimum(*ends), jnp.maximum(*ends)), units=8)
    has_crest, has_trough = _meets(a, crest), _meets(a, crest + 0.5)
    low = jnp.where(has_trough, -1.0, jnp.maximum(known.lo, -1.0))
    return Interval(low, jnp.where(has_crest, 1.0, jnp.minimum(known.hi, 1.0)))


def _meets(a: Interval, turns: float) -> Any:
    """Whether an angle equal to `turns` full turns, and any number more, lies in the interval; yes in doubt."""
    low, high = (end / (2.0 * math.pi) - turns for end in a)
    slack = 1e-15 * (1.0 + jnp.abs(low) + jnp.abs(high))  # some four units in the last place
    return ~(jnp.floor(high + slack) < jnp.ceil(low - slack))


@rule("tan")
def _tan(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    has_pole = _meets(a, 0.25) | _meets(a, 0.75)
    low, high = jnp.where(has_pole, 0.0, a.lo), jnp.where(has_pole, 0.0, a.hi)
    known = rounding(Interval(jnp.tan(low), jnp.tan(high)), units=8)
    return Interval(jnp.where(has_pole, -jnp.inf, known.lo), jnp.where(has_pole, jnp.inf, known.hi))


@rule("atan2")
def _atan2(rounding: Rounding, y: Enclosed, x: Enclosed, **_: Any) -> Interval:
    y, x = interval(y), interval(x)
    corners = [jnp.arctan2(p, q) for p in y for q in x]
    known = rounding(Interval(ft.reduce(jnp.minimum, corners), ft.reduce(jnp.maximum, corners)), units=8)
    meets_cut = (x.lo <= 0.0) & (y.lo <= 0.0) & (y.hi >= 0.0)  # the origin included
    return Interval(jnp.where(meets_cut, -math.pi, known.lo), jnp.where(meets_cut, math.pi, known.hi))

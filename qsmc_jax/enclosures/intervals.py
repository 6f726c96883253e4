r"""Interval arithmetic on JAX arrays, one rule for each primitive of a traced program.

A rule takes the operands of the primitive, each a plain array (a point), an `Interval` or a `Truth`, and encloses every
value that the primitive takes on them. Rules for partial functions clip to the domain: the square root of [-1, 4] is
[0, 2], since a narrower enclosure of the operand would not have left it.

Source: Moore, Kearfott and Cloud, Introduction to Interval Analysis (2009), chapters 2 and 5.
"""

import functools as ft
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax
import jax.numpy as jnp

from qsmc_jax.enclosures.rounding import Rounding


class Interval(NamedTuple):
    """All arrays that lie between two, entry by entry."""

    lo: Any
    hi: Any


class Truth(NamedTuple):
    """What a comparison of intervals can be, entry by entry."""

    may: Any
    may_not: Any


Enclosed: TypeAlias = Any  # an array, an Interval or a Truth
Rule: TypeAlias = Callable[..., Enclosed]

RULES: dict[str, Rule] = {}


def rule(*names: str) -> Callable[[Rule], Rule]:
    """Makes a function the rule of the primitives with these names: `rule(rounding, *operands, **params)`."""

    def register(function: Rule) -> Rule:
        RULES.update(dict.fromkeys(names, function))
        return function

    return register


def is_point(value: Enclosed) -> bool:
    """Whether it is a plain array."""
    return not isinstance(value, Interval | Truth)


def interval(value: Enclosed) -> Interval:
    """A point as an interval of no width; a truth as one between 0 and 1."""
    if isinstance(value, Interval):
        return value
    if isinstance(value, Truth):
        return Interval(jnp.logical_not(value.may_not).astype(int), value.may.astype(int))
    point = jnp.asarray(value)
    point = point.astype(int) if point.dtype == bool else point
    return Interval(point, point)


def truth(value: Enclosed) -> Truth:
    """A plain truth value as one that is certain."""
    return value if isinstance(value, Truth) else Truth(jnp.asarray(value), jnp.logical_not(value))


def hull(values: list[Enclosed]) -> Enclosed:
    """The least enclosure of several."""
    if any(isinstance(value, Truth) for value in values):
        truths = [truth(value) for value in values]
        return Truth(ft.reduce(jnp.logical_or, [t.may for t in truths]), _any([t.may_not for t in truths]))
    ends = [interval(value) for value in values]
    return Interval(ft.reduce(jnp.minimum, [e.lo for e in ends]), ft.reduce(jnp.maximum, [e.hi for e in ends]))


def _any(values: list[Any]) -> Any:
    return ft.reduce(jnp.logical_or, values)


# Arithmetic


@rule("add", "add_any")
def _add(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    a, b = interval(a), interval(b)
    return rounding(Interval(a.lo + b.lo, a.hi + b.hi))


@rule("sub")
def _sub(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    a, b = interval(a), interval(b)
    return rounding(Interval(a.lo - b.hi, a.hi - b.lo))


@rule("neg")
def _neg(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    return Interval(-a.hi, -a.lo)


@rule("mul")
def multiply(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    """The product. Nothing times something without bound is nothing."""
    if is_point(a):
        a, b = b, a
    ends = [_times(p, q) for p in interval(a) for q in ((b,) if is_point(b) else interval(b))]
    return rounding(Interval(ft.reduce(jnp.minimum, ends), ft.reduce(jnp.maximum, ends)))


def _times(a: Any, b: Any) -> Any:
    if not jnp.issubdtype(jnp.result_type(a), jnp.inexact):
        return a * b
    product = a * b
    return jnp.where(jnp.isnan(product) & ((a == 0.0) | (b == 0.0)), 0.0, product)


@rule("div")
def divide(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    """The quotient; everything where the denominator can be zero. Integers are divided by positive points only."""
    if not jnp.issubdtype(jnp.result_type(interval(a).lo), jnp.inexact):
        a, b = interval(a), interval(b)
        ends = [jax.lax.div(p, q) for p in a for q in b]
        return Interval(ft.reduce(jnp.minimum, ends), ft.reduce(jnp.maximum, ends))
    b = interval(b)
    has_zero = (b.lo <= 0.0) & (b.hi >= 0.0)
    safe = Interval(jnp.where(has_zero, 1.0, b.lo), jnp.where(has_zero, 1.0, b.hi))
    a = interval(a)
    ends = [p / q for p in a for q in safe]
    low, high = ft.reduce(jnp.minimum, ends), ft.reduce(jnp.maximum, ends)
    return rounding(Interval(jnp.where(has_zero, -jnp.inf, low), jnp.where(has_zero, jnp.inf, high)))


@rule("abs")
def absolute(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    """The absolute value."""
    p, q = jnp.abs(a.lo), jnp.abs(a.hi)
    touches = (a.lo <= 0) & (a.hi >= 0)
    return Interval(jnp.where(touches, jnp.zeros_like(p), jnp.minimum(p, q)), jnp.maximum(p, q))


@rule("integer_pow")
def _integer_pow(rounding: Rounding, a: Interval, *, y: int, **_: Any) -> Interval:
    if y < 0:
        return divide(rounding, jnp.ones_like(a.lo), _integer_pow(rounding, a, y=-y))
    base = absolute(rounding, a) if y % 2 == 0 else a
    return rounding(Interval(base.lo**y, base.hi**y), units=max(y, 1))


@rule("square")
def _square(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    return _integer_pow(rounding, a, y=2)


@rule("one_minus_square")
def _one_minus_square(rounding: Rounding, a: Interval, **_: Any) -> Interval:
    return _sub(rounding, jnp.ones_like(a.lo), _square(rounding, a))


@rule("polynomial")
def _polynomial(rounding: Rounding, a: Enclosed, *coefficients: Enclosed, **_: Any) -> Interval:
    """A polynomial by its coefficients, the constant first."""
    *lower, result = coefficients
    for coefficient in reversed(lower):
        result = _add(rounding, multiply(rounding, result, a), coefficient)
    return interval(result)


@rule("pow")
def _pow(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    """A real power: monotone in each operand on either side of base 1 and power 0. A negative base has whole ones."""
    if is_point(b) and not jnp.issubdtype(jnp.result_type(b), jnp.inexact):
        b = jnp.asarray(b, float)
    a, b = interval(a), interval(b)
    is_whole = (b.lo == b.hi) & (b.lo == jnp.floor(b.lo))
    is_even = is_whole & (b.lo == 2.0 * jnp.floor(0.5 * b.lo))
    size = absolute(rounding, a)
    # Of an odd power of both signs the ends have theirs; one that has a pole between them is not known.
    base = Interval(
        *(jnp.where(is_even, s, jnp.where(is_whole, e, jnp.maximum(e, 0.0))) for s, e in zip(size, a, strict=True))
    )
    ends = [jnp.power(p, q) for p in base for q in b]
    known = rounding(Interval(ft.reduce(jnp.minimum, ends), ft.reduce(jnp.maximum, ends)), units=32)
    is_known = (a.lo >= 0.0) | is_even | (is_whole & ((b.lo >= 0.0) | (a.hi < 0.0)))
    return Interval(jnp.where(is_known, known.lo, -jnp.inf), jnp.where(is_known, known.hi, jnp.inf))


# Steps


def _step(function: Callable[[Any], Any], rounding: Rounding, a: Interval, **params: Any) -> Interval:
    return Interval(function(a.lo), function(a.hi))


RULES["sign"] = ft.partial(_step, jnp.sign)
RULES["floor"] = ft.partial(_step, jnp.floor)
RULES["ceil"] = ft.partial(_step, jnp.ceil)


@rule("round")
def _round(rounding: Rounding, a: Interval, **params: Any) -> Interval:
    return Interval(jax.lax.round(a.lo, **params), jax.lax.round(a.hi, **params))


@rule("rem")
def _rem(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    """The remainder, with the sign of the numerator; as a whole period where the quotient can pass an integer."""
    is_same, a, b = has_one_quotient(a, b), interval(a), interval(b)
    ends = [jax.lax.rem(p, b.lo) for p in a]
    largest = absolute(rounding, b).hi
    none = jnp.zeros_like(largest)
    whole = Interval(jnp.where(a.lo < 0, -largest, none), jnp.where(a.hi > 0, largest, none))
    known = rounding(Interval(jnp.minimum(*ends), jnp.maximum(*ends)))
    return Interval(jnp.where(is_same, known.lo, whole.lo), jnp.where(is_same, known.hi, whole.hi))


def has_one_quotient(a: Enclosed, b: Enclosed) -> Any:
    """Whether the whole part of a quotient is the same all over, so that the remainder does not jump."""
    a, b = interval(a), interval(b)
    low, high = (jnp.trunc(jnp.asarray(p, float) / jnp.asarray(b.lo, float)) for p in a)
    return (b.lo == b.hi) & (low == high) & ((a.lo >= 0) | (a.hi <= 0))


@rule("nextafter")
def _nextafter(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    a = interval(a)
    return Interval(jnp.nextafter(a.lo, -jnp.inf), jnp.nextafter(a.hi, jnp.inf))


# Choices


@rule("max")
def _max(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    a, b = interval(a), interval(b)
    return Interval(jnp.maximum(a.lo, b.lo), jnp.maximum(a.hi, b.hi))


@rule("min")
def _min(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Interval:
    a, b = interval(a), interval(b)
    return Interval(jnp.minimum(a.lo, b.lo), jnp.minimum(a.hi, b.hi))


@rule("clamp")
def _clamp(rounding: Rounding, low: Enclosed, a: Enclosed, high: Enclosed, **_: Any) -> Interval:
    return _min(rounding, _max(rounding, a, low), high)


@rule("lt", "lt_to")
def _lt(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    a, b = interval(a), interval(b)
    return Truth(~(a.lo >= b.hi), ~(a.hi < b.lo))  # either, where an end is not known


@rule("le", "le_to")
def _le(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    a, b = interval(a), interval(b)
    return Truth(~(a.lo > b.hi), ~(a.hi <= b.lo))


@rule("gt")
def _gt(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    return _lt(rounding, b, a)


@rule("ge")
def _ge(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    return _le(rounding, b, a)


@rule("eq")
def _eq(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    if _is_true_or_not(a) or _is_true_or_not(b):
        return _not(rounding, _xor(rounding, a, b))
    a, b = interval(a), interval(b)
    return Truth(~((a.lo > b.hi) | (a.hi < b.lo)), ~((a.lo == a.hi) & (b.lo == b.hi) & (a.lo == b.lo)))


def _is_true_or_not(value: Enclosed) -> bool:
    return isinstance(value, Truth) or (is_point(value) and jnp.issubdtype(jnp.result_type(value), jnp.bool_))


@rule("ne")
def _ne(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    return _not(rounding, _eq(rounding, a, b))


@rule("is_finite")
def _is_finite(rounding: Rounding, a: Interval, **_: Any) -> Truth:
    """Certain: an enclosure without bound is a loose one, not a value."""
    return Truth(jnp.ones(a.lo.shape, bool), jnp.zeros(a.lo.shape, bool))


@rule("and")
def _and(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    a, b = truth(a), truth(b)
    return Truth(a.may & b.may, a.may_not | b.may_not)


@rule("or")
def _or(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    a, b = truth(a), truth(b)
    return Truth(a.may | b.may, a.may_not & b.may_not)


@rule("xor")
def _xor(rounding: Rounding, a: Enclosed, b: Enclosed, **_: Any) -> Truth:
    a, b = truth(a), truth(b)
    return Truth((a.may & b.may_not) | (a.may_not & b.may), (a.may & b.may) | (a.may_not & b.may_not))


@rule("not")
def _not(rounding: Rounding, a: Truth, **_: Any) -> Truth:
    return Truth(a.may_not, a.may)

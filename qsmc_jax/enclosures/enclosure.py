"""Enclosures of traced functions: a program is walked with intervals in place of numbers.

What depends on points alone is computed as it stands, so that a function of time costs only what depends on time. The
walk enters `jit`, custom derivatives, `checkpoint`, `cond` and loops of fixed length. What it has no rule for is tried
in corners of its operands' box and within, which is no proof, and is named.
"""

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.enclosures import functions as functions  # whose rules register themselves
from qsmc_jax.enclosures import intervals
from qsmc_jax.enclosures.intervals import RULES, Enclosed, Interval, Truth, hull, interval, is_point, truth
from qsmc_jax.enclosures.rounding import Rounding
from qsmc_jax.enclosures.tries import TRIES, hull_of_points, within
from qsmc_jax.tracing.programs import (
    CALLS,
    CUSTOM_CALLS,
    Equation,
    UnknownProgramError,
    branches,
    called,
    computed,
    dtype_of,
    evaluated,
    has_many_results,
    loop,
    parts,
    shape_of,
)

# Operations that a loop of fixed length may unroll to.
_LONGEST = 4096


# Parameters that rules know, or that do not matter to values. One that is new may change what an operation does.
_KNOWN = {"accuracy", "axes", "axis", "dimension_numbers", "fill_value", "index_dtype", "indices_are_sorted", "mode"}
_KNOWN |= {"new_dtype", "out_dtype", "out_sharding", "precision", "preferred_element_type", "reverse", "sharding"}
_KNOWN |= {"rounding_method", "slice_sizes", "unique_indices", "unroll", "weak_type", "y"}

# Monotone in every operand, so that the ends of the result are the results of the ends.
_SHAPING = {"broadcast_in_dim", "reshape", "squeeze", "expand_dims", "transpose", "slice", "concatenate", "pad", "rev"}
_SHAPING |= {"copy", "copy_p", "stack", "split", "stop_gradient", "optimization_barrier", "reduce_precision"}
_GROWING = {"reduce_max", "reduce_min", "cummax", "cummin"}

_LOGIC = {"and", "or", "xor", "not"}
_JUMPING = {"sign", "floor", "ceil", "round"}
_POLES = {"div", "tan"}


class Enclosure(NamedTuple):
    """What is known of a function over a box.

    Attributes:
        values: Its results, flat: points where they do not depend on an interval, else intervals or truths.
        jumps: Whether it may jump in the box.
        unknown: Primitives without a rule that it uses, which were tried at some points of the box.
    """

    values: tuple[Enclosed, ...]
    jumps: Any
    unknown: tuple[str, ...]


def enclose(fn: Callable[..., Any], *box: Enclosed, rounding: Rounding = Rounding.NEAREST) -> Enclosure:
    """Encloses a function of scalars over a box.

    Args:
        fn: A function that JAX can trace; its results are numbers, or pytrees of them.
        *box: Its arguments, each a point or an `Interval`.
        rounding: How the ends are rounded.
    """
    points = [jnp.asarray(side) if is_point(side) else side.lo for side in box]
    program = jax.make_jaxpr(fn)(*points)
    walk = Walk(rounding)
    try:
        values = evaluated(program, box, walk.results)
    except UnknownProgramError as error:
        raise CannotEncloseError("a program of this version of JAX") from error
    return Enclosure(tuple(values), walk.jumps, tuple(sorted(walk.unknown)))


class CannotEncloseError(Exception):
    """A primitive without a rule has results that are no numbers, such as random keys; or nothing can be read."""


class Walk:
    """One pass through a program; what it finds on the way.

    Attributes:
        rounding: How the ends are rounded.
        jumps: Whether any operation so far may jump.
        unknown: Primitives without a rule so far.
    """

    def __init__(self, rounding: Rounding):
        self.rounding, self.jumps = rounding, jnp.zeros((), bool)
        self.unknown: set[str] = set()

    def results(self, eqn: Equation, operands: list[Enclosed]) -> Sequence[Enclosed]:
        """The results of one operation, points where its operands are.

        Args:
            eqn: The operation.
            operands: What it is given.
        """
        name = eqn.name
        if name in CALLS | CUSTOM_CALLS:
            return self._call(eqn, operands)
        if all(map(is_point, operands)):
            return computed(eqn, operands)
        if _is_complex(eqn):
            return self._tried(eqn, operands)
        if name in ("eq", "ne") and eqn.inputs[0] is eqn.inputs[1]:  # so NaNs are looked for; a box holds numbers
            is_same = jnp.full(np.shape(interval(operands[0]).lo), name == "eq")
            return [Truth(is_same, ~is_same)]
        if name in ("cond", "scan"):
            return (self._cond if name == "cond" else self._scan)(eqn, operands)
        try:
            result = self._result(name, eqn, operands)
        except UnknownProgramError:  # a parameter that its rule reads is not there
            result = None
        if result is None:
            return self._tried(eqn, operands)
        return result if has_many_results(eqn) else [result]

    def _result(self, name: str, eqn: Equation, operands: list[Enclosed]) -> Any:
        """The result of one operation, None if there is no rule for it."""
        if name in _SHAPING | _GROWING or (name == "sort" and len(operands) == 1):
            if name == "stop_gradient":
                self._note(jnp.ones((), bool))  # not a jump, but its derivative says as little of it
            return _by_ends(eqn, operands)
        if not eqn.params.keys() <= _KNOWN or eqn.params.get("out_dtype") is not None:
            return None
        is_of_bits = name in _LOGIC and not jnp.issubdtype(dtype_of(eqn.outputs[0]), jnp.bool_)
        if name in RULES and not is_of_bits:
            result = RULES[name](self.rounding, *operands, **eqn.params)
            if name in _JUMPING:
                self._note(result.lo != result.hi)
            if name in _POLES:
                self._note(jnp.isinf(result.lo) & jnp.isinf(result.hi))
            if name == "atan2":
                self._note((result.lo <= -math.pi) & (result.hi >= math.pi))
            if name == "rem":
                self._note(~intervals.has_one_quotient(*operands))
            return result
        if name == "select_n":
            return self._select(operands[0], operands[1:])
        structural = {
            "convert_element_type": self._convert,
            "reduce_sum": self._sum,
            "cumsum": self._sum,
            "dot_general": self._dot,
            "reduce_and": _reduced_truth,
            "reduce_or": _reduced_truth,
            "argmax": self._argmax,
            "argmin": self._argmin,
            "gather": self._gather,
            "dynamic_slice": self._gather,
        }
        return structural[name](eqn, operands) if name in structural else None

    def _tried(self, eqn: Equation, operands: list[Enclosed]) -> list[Enclosed]:
        """The hull of its results at some points of the box."""
        if not eqn.outputs:  # it is there for what it does, such as printing
            return []
        self.unknown.add(eqn.name)
        self._note(jnp.ones((), bool))
        if any(jnp.issubdtype(dtype_of(var) or float, jax.dtypes.extended) for var in eqn.outputs):
            raise CannotEncloseError(eqn.name)
        tries = [computed(eqn, [within(value, i, k) for i, value in enumerate(operands)]) for k in range(TRIES)]
        return [hull_of_points(jnp.stack(results)) for results in zip(*tries, strict=True)]

    def _note(self, jumps: Any) -> None:
        self.jumps = self.jumps | jnp.any(jumps)

    def _call(self, eqn: Equation, operands: list[Enclosed]) -> Sequence[Enclosed]:
        named = {"_interp": self._interpolated, "searchsorted": self._searched}.get(eqn.params.get("name", ""))
        result = named(eqn, operands) if named is not None else None
        if result is not None:
            return [result]
        program = called(eqn)
        return self._tried(eqn, operands) if program is None else evaluated(program, operands, self.results)

    def _interpolated(self, eqn: Equation, operands: list[Enclosed]) -> Interval | None:
        """`jnp.interp`: the values at the ends, and at the knots between them. Its derivative has two results."""
        at, *table = operands
        knots, values, *others = table
        is_usual = all(map(is_point, table)) and np.ndim(knots) == 1 and len(eqn.outputs) == 1
        program = called(eqn)
        if is_point(at) or np.ndim(at.lo) or not is_usual or program is None:
            return None
        value = lambda end: evaluated(program, [end, *table], computed)[0]  # noqa: E731
        ends = list(map(value, at))
        is_between = (knots >= at.lo) & (knots <= at.hi)
        if any(inner.name == "sort" for inner in parts(program).equations):  # it has a period
            first, last = (jnp.floor((end - knots) / jnp.abs(others[-1])) for end in at)
            is_between = is_between | (last > first)
        else:  # beyond the last knot, on either side, it may jump
            self._note((at.lo <= knots[0]) & (knots[0] <= at.hi) & (value(at.lo) != values[0]))
            self._note((at.lo <= knots[-1]) & (knots[-1] <= at.hi) & (value(at.hi) != values[-1]))
        low = jnp.min(jnp.where(is_between, values, jnp.inf), initial=jnp.inf)
        high = jnp.max(jnp.where(is_between, values, -jnp.inf), initial=-jnp.inf)
        known = Interval(jnp.minimum(low, jnp.minimum(*ends)), jnp.maximum(high, jnp.maximum(*ends)))
        return self.rounding(known, units=8)

    def _searched(self, eqn: Equation, operands: list[Enclosed]) -> Interval | None:
        """`jnp.searchsorted`: its place grows with what is looked for; what stands behind that is its derivative."""
        table, sought, *others = operands
        program, others = called(eqn), [interval(other).lo for other in others]
        if not is_point(table) or is_point(sought) or program is None:
            return None
        return Interval(*(evaluated(program, [table, end, *others], computed)[0] for end in _without_nan(sought)))

    def _select(self, which: Enclosed, cases: Sequence[Enclosed]) -> Enclosed:
        if is_point(which):
            return _mapped(lambda *ends: jax.lax.select_n(which, *ends), cases)
        if isinstance(which, Truth):
            possible = [which.may_not, which.may]
        else:
            possible = [(which.lo <= k) & (k <= which.hi) for k in range(len(cases))]
        self._note(sum(jnp.asarray(p, int) for p in possible) > 1)
        return hull([_where_possible(p, case) for p, case in zip(possible, cases, strict=True)])

    def _cond(self, eqn: Equation, operands: list[Enclosed]) -> list[Enclosed]:
        chosen = branches(eqn)
        if chosen is None:
            return self._tried(eqn, operands)
        which, *arguments = operands
        outcomes = [evaluated(branch, arguments, self.results) for branch in chosen]
        return [self._branched(which, cases) for cases in zip(*outcomes, strict=True)]

    def _branched(self, which: Enclosed, cases: Sequence[Enclosed]) -> Enclosed:
        shape = np.shape(interval(cases[0]).lo)
        spread = lambda end: jnp.broadcast_to(jnp.clip(end, 0, len(cases) - 1), shape)  # noqa: E731
        index = interval(which)
        return self._select(Interval(spread(index.lo), spread(index.hi)), cases)

    def _scan(self, eqn: Equation, operands: list[Enclosed]) -> Sequence[Enclosed]:
        """A loop of fixed length, unrolled."""
        found = loop(eqn)
        if found is None or found.length * len(parts(found.body).equations) > _LONGEST:
            return self._tried(eqn, operands)
        consts, carry = found.constants, found.carried
        state, rows = list(operands[consts : consts + carry]), operands[consts + carry :]
        stacked: list[list[Enclosed]] = []
        order = range(found.length)
        for k in reversed(order) if found.is_reversed else order:
            row = [_mapped(lambda end, k=k: end[k], [values]) for values in rows]
            results = evaluated(found.body, [*operands[:consts], *state, *row], self.results)
            state = results[:carry]
            stacked.append(results[carry:])
        stacked = stacked[::-1] if found.is_reversed else stacked
        return [*state, *(_mapped(lambda *ends: jnp.stack(ends), column) for column in zip(*stacked, strict=True))]

    def _convert(self, eqn: Equation, operands: list[Enclosed]) -> Enclosed:
        (value,), new = operands, eqn.param("new_dtype")
        if jnp.issubdtype(new, jnp.bool_):
            return value if isinstance(value, Truth) else RULES["ne"](self.rounding, value, 0)
        ends = interval(value)
        if jnp.issubdtype(new, jnp.integer):
            largest, ends = jnp.iinfo(new), _without_nan(ends)
            fits = [jnp.clip(end, max(largest.min, _least(end)), min(largest.max, _most(end))) for end in ends]
            ends = Interval(*fits)
        result = Interval(ends.lo.astype(new), ends.hi.astype(new))
        if isinstance(value, Truth) or (_is_real(ends.lo) and not _is_real(result.lo)):
            self._note(result.lo != result.hi)
        return result

    def _sum(self, eqn: Equation, operands: list[Enclosed]) -> Interval:
        (low, high), terms = _by_ends(eqn, operands), max(np.size(operands[0].lo), 1)
        if self.rounding is Rounding.NEAREST or not _is_real(low):
            return Interval(low, high)
        (size,) = computed(eqn, [intervals.absolute(self.rounding, operands[0]).hi])
        slack = 2.0 * terms * jnp.finfo(low.dtype).eps * jnp.abs(size)
        return self.rounding(Interval(low - slack, high + slack))

    def _argmax(self, eqn: Equation, operands: list[Enclosed]) -> Interval:
        """From the first place that can be highest, to the first that is sure to be, or the last that can."""
        low, high = _without_nan(interval(operands[0]))
        (axis,), kind = eqn.param("axes"), dtype_of(eqn.outputs[0])
        can = high >= jnp.max(low, axis=axis, keepdims=True)
        is_sure = low >= jnp.max(high, axis=axis, keepdims=True)
        last = low.shape[axis] - 1 - jnp.argmax(jnp.flip(can, axis), axis=axis)
        last = jnp.where(jnp.any(is_sure, axis=axis), jnp.argmax(is_sure, axis=axis), last)
        return Interval(jnp.argmax(can, axis=axis).astype(kind), last.astype(kind))

    def _argmin(self, eqn: Equation, operands: list[Enclosed]) -> Interval:
        return self._argmax(eqn, [RULES["neg"](self.rounding, interval(operands[0]))])

    def _dot(self, eqn: Equation, operands: list[Enclosed]) -> Interval:
        """By middles and radii, which is exact where one operand is a point."""
        a, b = map(interval, operands)
        (mid_a, rad_a), (mid_b, rad_b) = ((0.5 * (e.lo + e.hi), 0.5 * (e.hi - e.lo)) for e in (a, b))
        dot = lambda p, q: computed(eqn, [p, q])[0]  # noqa: E731
        size_a, size_b = jnp.abs(mid_a), jnp.abs(mid_b)
        middle, radius = dot(mid_a, mid_b), dot(size_a, rad_b) + dot(rad_a, size_b) + dot(rad_a, rad_b)
        if self.rounding is Rounding.OUTWARD:
            terms = np.size(a.lo) + np.size(b.lo)
            radius = radius + 4.0 * terms * jnp.finfo(middle.dtype).eps * (dot(size_a, size_b) + radius)
        return self.rounding(Interval(middle - radius, middle + radius))

    def _gather(self, eqn: Equation, operands: list[Enclosed]) -> Enclosed:
        """Entries of an array: of the places that the index can have where they are known, else of all."""
        table, *places = operands
        if all(map(is_point, places)):
            return _mapped(lambda end: computed(eqn, [end, *places])[0], [table])
        self._note(jnp.any(jnp.stack([jnp.any(interval(place).lo != interval(place).hi) for place in places])))
        shape, table = shape_of(eqn.outputs[0]), interval(table)
        is_reached = jnp.ones(table.lo.shape, bool)
        if np.ndim(table.lo) == 1 and len(places) == 1 and np.prod(shape) == np.size(interval(places[0]).lo) == 1:
            size = table.lo.shape[0]
            low, high = (jnp.clip(jnp.reshape(end, ()), 0, size - 1) for end in interval(places[0]))
            order = jnp.arange(size, dtype=low.dtype)
            is_reached = (order >= low) & (order <= high)
        low = jnp.min(jnp.where(is_reached, table.lo, _extreme(table.lo, 1)))
        high = jnp.max(jnp.where(is_reached, table.hi, _extreme(table.hi, -1)))
        return Interval(jnp.full(shape, low), jnp.full(shape, high))


def _by_ends(eqn: Equation, operands: Sequence[Enclosed]) -> Any:
    """The operation on the lower ends, and on the upper ones."""
    is_many = has_many_results(eqn)
    parts = [computed(eqn, [end[k] for end in _as_pairs(operands)]) for k in (0, 1)]
    kind = Truth if any(isinstance(value, Truth) for value in operands) else Interval
    results = [kind(low, high) for low, high in zip(*parts, strict=True)]
    return results if is_many else results[0]


def _mapped(fn: Callable[..., Any], values: Sequence[Enclosed]) -> Enclosed:
    """A function of structure alone, such as indexing, on each end."""
    if all(map(is_point, values)):
        return fn(*values)
    pairs = _as_pairs(values)
    kind = Truth if any(isinstance(value, Truth) for value in values) else Interval
    return kind(*(fn(*(pair[k] for pair in pairs)) for k in (0, 1)))


def _as_pairs(values: Sequence[Enclosed]) -> list[Any]:
    is_truth = any(isinstance(value, Truth) for value in values)
    return [truth(value) if is_truth else interval(value) for value in values]


def _where_possible(possible: Any, case: Enclosed) -> Enclosed:
    """The case, or what adds nothing to a hull where it is not possible."""
    if isinstance(case, Truth) or (is_point(case) and jnp.issubdtype(jnp.result_type(case), jnp.bool_)):
        case = truth(case)
        return Truth(case.may & possible, case.may_not & possible)
    case = interval(case)
    low = jnp.where(possible, case.lo, _extreme(case.lo, 1))
    return Interval(low, jnp.where(possible, case.hi, _extreme(case.hi, -1)))


def _without_nan(ends: Interval) -> Interval:
    """The interval, without bound where an end is not known."""
    if not _is_real(ends.lo):
        return ends
    return Interval(*(jnp.where(jnp.isnan(end), far, end) for end, far in zip(ends, (-jnp.inf, jnp.inf), strict=True)))


def _reduced_truth(eqn: Equation, operands: list[Truth]) -> Truth:
    (value,), axes = operands, eqn.param("axes")
    some, every = (jnp.any, jnp.all) if eqn.name == "reduce_or" else (jnp.all, jnp.any)
    return Truth(some(value.may, axis=axes), every(value.may_not, axis=axes))


def _most(like: Any) -> Any:
    return math.inf if _is_real(like) else jnp.iinfo(jnp.result_type(like)).max


def _least(like: Any) -> Any:
    return -math.inf if _is_real(like) else jnp.iinfo(jnp.result_type(like)).min


def _extreme(like: Any, sign: int) -> Any:
    """The largest number of an array's type, or the least."""
    if _is_real(like):
        return sign * jnp.inf
    ends = jnp.iinfo(jnp.result_type(like))
    return jnp.asarray(ends.max if sign > 0 else ends.min, jnp.result_type(like))


def _is_real(value: Any) -> bool:
    return bool(jnp.issubdtype(jnp.result_type(value), jnp.inexact))


def _is_complex(eqn: Equation) -> bool:
    types = [dtype_of(var) or float for var in (*eqn.inputs, *eqn.outputs)]
    return any(jnp.issubdtype(kind, jnp.complexfloating) for kind in types)

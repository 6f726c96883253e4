"""Traced programs as lists of operations on single numbers, for a checker that knows no JAX.

Arrays become arrays of places in the list, on which whatever only moves entries works as it stands; numbers that are
known stay numbers. What is not among some forty operations becomes an operation `unknown` with its name: a program has
an enclosure if none of these is left once results that nobody asks for are dropped.
"""

import functools as ft
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from qsmc_jax.tracing.programs import (
    Equation,
    Program,
    branches,
    called,
    computed,
    dtype_of,
    evaluated,
    has_many_results,
    shape_of,
)

Operation = list[Any]

# What only moves entries; its results are those of the places.
_MOVES = frozenset(
    [
        "broadcast_in_dim",
        "reshape",
        "squeeze",
        "slice",
        "dynamic_slice",
        "transpose",
        "rev",
        "concatenate",
        "gather",
        "expand_dims",
        "copy",
        "copy_p",
        "select_n",
        "split",
        "stack",
    ]
)
_SAME = frozenset({"stop_gradient", "optimization_barrier"})
_BASE = {"add": "add", "add_any": "add", "sub": "sub", "mul": "mul", "div": "div", "max": "max", "min": "min"}
_UNARY = frozenset(["neg", "abs", "sqrt", "exp", "log", "sin", "cos", "tan", "atan"])

_NEUTRAL = {"add": (["const", (0.0).hex()], ["const", (-0.0).hex()]), "mul": (["const", (1.0).hex()],)}


class Places(np.ndarray):
    """Places of numbers in the list."""


class Flattener:
    """Makes the list."""

    def __init__(self):
        self.operations: list[Operation] = []
        self._known: dict[tuple[Any, ...], int] = {}

    def place(self, *operation: Any) -> int:
        """The place of an operation, which is made if it is not there yet; adding 0 and multiplying by 1 are none."""
        if (neutral := _NEUTRAL.get(operation[0])) is not None:
            rest = [each for each in operation[1:] if self.operations[each] not in neutral]
            if len(rest) < len(operation) - 1:
                return rest[0] if rest else operation[1]
        if operation not in self._known:
            self._known[operation] = len(self.operations)
            self.operations.append(list(operation))
        return self._known[operation]

    def inputs(self, names: Sequence[str], shape: tuple[int, ...] = ()) -> Places:
        """Inputs by their names, in an array."""
        return _places([self.place("input", name) for name in names], shape)

    def run(self, program: Program, arguments: Sequence[Any]) -> list[Places]:
        """The places of a program's results, as arrays."""
        return [self._spread(each) for each in evaluated(program, arguments, self._equation)]

    def _spread(self, value: Any) -> Places:
        """Numbers that are known as places too."""
        if isinstance(value, Places):
            return value
        array = np.asarray(value, float)
        return _places([self.place("const", float(each).hex()) for each in array.ravel()], array.shape)

    def _equation(self, equation: Equation, operands: list[Any]) -> Sequence[Any]:
        operands = [each if isinstance(each, Places) else np.asarray(each) for each in operands]
        name, is_known = equation.name, not any(isinstance(each, Places) for each in operands)
        is_float = any(np.issubdtype(each.dtype, np.floating) for each in operands if not isinstance(each, Places))
        # Numbers of which the result is exact are worked out; of others, operations of reals are kept.
        if is_known and (name in _MOVES | {"convert_element_type", "eq", "ne", "lt", "le", "gt", "ge"} or not is_float):
            return [np.asarray(each) for each in computed(equation, operands)]
        inner = called(equation)
        if inner is not None:
            return evaluated(inner, operands, self._equation)
        if name == "cond" and not isinstance(operands[0], Places) and (chosen := branches(equation)) is not None:
            return evaluated(chosen[int(np.clip(operands[0], 0, len(chosen) - 1))], operands[1:], self._equation)
        made = (
            self._made(equation, operands) if all(dtype_of(each) == np.float64 for each in equation.outputs) else None
        )
        if made is None:
            return [self._unknown(equation, shape_of(each) if dtype_of(each) else ()) for each in equation.outputs]
        return made if has_many_results(equation) else [made]

    def _unknown(self, equation: Equation, shape: tuple[int, ...]) -> Places:
        return _places([self.place("unknown", equation.name)] * int(np.prod(shape)), shape)

    def _made(self, equation: Equation, operands: list[Any]) -> Any:
        """What an operation on float64 numbers makes; None if there is no rule for it."""
        name, params = equation.name, equation.params
        if name in _MOVES:
            return self._moved(equation, operands)
        if name in _SAME or (name == "convert_element_type" and dtype_of(equation.inputs[0]) == np.float64):
            return operands if has_many_results(equation) else operands[0]
        arrays = [self._spread(each) for each in operands]
        if name.startswith("reduce_") and (join := name.removeprefix("reduce_")) in ("sum", "max", "min", "prod"):
            return self._reduced({"sum": "add", "prod": "mul"}.get(join, join), arrays[0], params["axes"])
        if name == "dot_general" and params.get("out_sharding") is None:
            return self._dot(arrays[0], arrays[1], params["dimension_numbers"])
        if name in _BASE or name in _UNARY:
            return _each(ft.partial(self.place, _BASE.get(name, name)), *arrays)
        if name in ("integer_pow", "square", "pow"):
            exponent = 2 if name == "square" else params["y"] if name == "integer_pow" else operands[1]
            return None if isinstance(exponent, Places) else self._power(arrays[0], np.asarray(exponent))
        rule = _RULES.get(name)
        return None if rule is None else _each(ft.partial(rule, self), *arrays)

    def _moved(self, equation: Equation, operands: list[Any]) -> Any:
        """Entries moved; None if it depends on numbers that are not known where to."""
        moving = {"gather": [0], "dynamic_slice": [0], "select_n": range(1, len(operands))}
        moves = set(moving.get(equation.name, range(len(operands))))
        if any(isinstance(each, Places) for i, each in enumerate(operands) if i not in moves):
            return None
        given = [np.asarray(self._spread(each)) if i in moves else each for i, each in enumerate(operands)]
        results = [np.asarray(each) for each in computed(equation, given)]
        # A place out of range is what `gather` fills in beyond an array's end.
        if any(each.size and not (each.min() >= 0 and each.max() < len(self.operations)) for each in results):
            return None
        results = [each.view(Places) for each in results]
        return results if has_many_results(equation) else results[0]

    def _reduced(self, name: str, array: Places, axes: Sequence[int]) -> Places:
        rest = [axis for axis in range(array.ndim) if axis not in axes]
        rows = np.transpose(array, [*rest, *axes]).reshape(*(array.shape[axis] for axis in rest), -1)
        return _places([self._joined(name, row) for row in rows.reshape(-1, rows.shape[-1])], rows.shape[:-1])

    def _joined(self, name: str, row: Any) -> int:
        if not len(row):
            return self.place("const", float({"add": 0.0, "mul": 1.0}[name]).hex())
        return ft.reduce(lambda a, b: self.place(name, a, int(b)), row[1:], int(row[0]))

    def _dot(self, a: Places, b: Places, dimensions: Any) -> Any:
        """A product of vectors or matrices, without batches."""
        (over_a, over_b), (batch, _) = dimensions
        if batch:
            return None
        free_a, free_b = ([i for i in range(x.ndim) if i not in over] for x, over in ((a, over_a), (b, over_b)))
        shape = (*(a.shape[i] for i in free_a), *(b.shape[i] for i in free_b))
        count = int(np.prod([a.shape[i] for i in over_a]))
        rows = np.transpose(a, [*free_a, *over_a]).reshape(-1, count)
        columns = np.transpose(b, [*free_b, *over_b]).reshape(-1, count)
        dot = lambda p, q: self._joined("add", [self.place("mul", int(x), int(y)) for x, y in zip(p, q, strict=True)])  # noqa: E731
        return _places([dot(row, column) for row in rows for column in columns], shape)

    def _power(self, array: Places, exponents: np.ndarray) -> Places:
        bases, exponents = np.broadcast_arrays(np.asarray(array), exponents)
        places = [self._to(int(x), float(y)) for x, y in zip(bases.ravel(), exponents.ravel(), strict=True)]
        return _places(places, bases.shape)

    def _to(self, x: int, exponent: float) -> int:
        if not exponent.is_integer():
            return self.place("exp", self.place("mul", self.number(exponent), self.place("log", x)))
        if exponent == 0.0:
            return self.number(1.0)
        power = x if abs(exponent) == 1.0 else self.place("power", x, int(abs(exponent)))
        return power if exponent > 0.0 else self.place("div", self.number(1.0), power)

    def number(self, value: float) -> int:
        """The place of a number."""
        return self.place("const", float(value).hex())


def _exp_of(made: Flattener, x: int, factor: float) -> int:
    return made.place("exp", made.place("mul", made.number(factor), x))


def _hyperbolic(made: Flattener, x: int, join: str) -> int:
    both = made.place(join, made.place("exp", x), made.place("exp", made.place("neg", x)))
    return made.place("mul", made.number(0.5), both)


def _tanh(made: Flattener, x: int) -> int:
    """1 - 2 / (exp 2x + 1), in which x stands once."""
    falling = made.place("div", made.number(2.0), made.place("add", _exp_of(made, x, 2.0), made.number(1.0)))
    return made.place("sub", made.number(1.0), falling)


def _logistic(made: Flattener, x: int) -> int:
    return made.place("div", made.number(1.0), made.place("add", made.number(1.0), _exp_of(made, x, -1.0)))


def _rsqrt(made: Flattener, x: int) -> int:
    return made.place("div", made.number(1.0), made.place("sqrt", x))


def _clamp(made: Flattener, low: int, x: int, high: int) -> int:
    return made.place("min", made.place("max", x, low), high)


_RULES: dict[str, Callable[..., int]] = {
    "tanh": _tanh,
    "logistic": _logistic,
    "rsqrt": _rsqrt,
    "clamp": _clamp,
    "sinh": ft.partial(_hyperbolic, join="sub"),
    "cosh": ft.partial(_hyperbolic, join="add"),
    "expm1": lambda made, x: made.place("sub", made.place("exp", x), made.number(1.0)),
    "log1p": lambda made, x: made.place("log", made.place("add", made.number(1.0), x)),
}


def _places(places: Sequence[int], shape: tuple[int, ...]) -> Places:
    return np.array(places, np.int64).reshape(shape).view(Places)


def _each(rule: Callable[..., int], *arrays: Places) -> Places:
    """A rule for numbers, entry by entry."""
    together = np.broadcast_arrays(*map(np.asarray, arrays))
    places = [rule(*map(int, entries)) for entries in zip(*map(np.ravel, together), strict=True)]
    return _places(places, together[0].shape)


def live(operations: Sequence[Operation], wanted: Sequence[int]) -> tuple[list[Operation], list[int]]:
    """The operations that some results need, renumbered, and where these are now."""
    needed = set(wanted)
    for place in reversed(range(len(operations))):
        if place in needed:
            needed.update(operands_of(operations[place]))
    order = {old: new for new, old in enumerate(sorted(needed))}
    kept = []
    for old in sorted(needed):
        name, *given = operations[old]
        count = len(operands_of(operations[old]))
        kept.append([name, *(order[place] for place in given[:count]), *given[count:]])
    return kept, [order[place] for place in wanted]


def operands_of(operation: Operation) -> list[int]:
    """The places of what an operation works on."""
    name, *given = operation
    if name in ("input", "const", "unknown"):
        return []
    return given[:1] if name == "power" else given

"""Traced programs, read and rewritten: the one file that knows JAX's own form of them.

JAX documents how to get a program (`jax.make_jaxpr`), not what it is made of: classes are merged and the parameters of
loops renamed from one version to the next. So all that depends on it is here, written for JAX 0.7 to 0.12, and nothing
of it is taken for granted: what looks otherwise raises `UnknownProgramError` when read, is None when asked for the
programs inside an operation, and is left as it is when rewritten.
"""

import functools as ft
import inspect
import weakref
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any, NamedTuple, TypeAlias

import jax
import numpy as np

from qsmc_jax.base.precision import in_64_bits

core: Any = None
lu: Any = None
_MISSING = ""
try:
    from jax.extend import core
    from jax.extend import linear_util as lu
except ImportError as missing:  # of a JAX to come: programs are then read, but not rewritten
    _MISSING = str(missing)

Program: TypeAlias = Any  # what `jax.make_jaxpr(fn)(...)` returns, or a program inside it

# Operations that stand for the one program in them, whose inputs are theirs, and the parameters that hold it.
CALLS = frozenset({"jit", "pjit", "call", "closed_call", "core_call", "remat", "remat2", "checkpoint"})
CUSTOM_CALLS = frozenset({"custom_jvp_call", "custom_vjp_call", "custom_vjp_call_jaxpr", "custom_lin"})
_HOLDERS = ("jaxpr", "call_jaxpr", "fun_jaxpr")
# An operation of a library's own, in whose inside nobody can look.
OPAQUE = frozenset({"call_hi_primitive"})
_ENTERED = CALLS | {"cond", "scan", "while", "custom_jvp_call", "custom_vjp_call", "custom_linear_solve"}

_LOOP = {"jaxpr", "length", "reverse", "unroll", "linear", "_split_transpose"}
_COUNTS, _GROUPS = {"num_consts", "num_carry"}, {"ft_in", "ft_out"}  # up to JAX 0.10, and from 0.11


class UnknownProgramError(NotImplementedError):
    """A program is not made as those of the versions of JAX that this file was written for."""


class Equation(NamedTuple):
    """One operation of a program.

    Attributes:
        name: Its name, such as "add".
        inputs: What it is given: variables and literals; the same variable is the same object.
        outputs: The variables that it sets.
        params: Its parameters.
        made_by_jax: The equation as JAX has it.
    """

    name: str
    inputs: tuple[Any, ...]
    outputs: tuple[Any, ...]
    params: Mapping[str, Any]
    made_by_jax: Any

    def param(self, name: str) -> Any:
        """A parameter; raises `UnknownProgramError` if there is none of this name."""
        if name not in self.params:
            raise UnknownProgramError(f"{self.name} has no parameter {name}")
        return self.params[name]


class Parts(NamedTuple):
    """What a program is made of.

    Attributes:
        constants: Values of the variables that it closes over.
        inputs: Variables of its arguments.
        equations: Its operations, in order.
        outputs: Variables and literals of its results.
    """

    constants: dict[Any, Any]
    inputs: tuple[Any, ...]
    equations: tuple[Equation, ...]
    outputs: tuple[Any, ...]


class Loop(NamedTuple):
    """A loop of fixed length.

    Attributes:
        body: What is done each time: of constants, state and a row, to state and a row.
        length: How often.
        is_reversed: Whether the last row comes first.
        constants: How many of the loop's inputs are the same each time.
        carried: How many of the next are the state.
    """

    body: Program
    length: int
    is_reversed: bool
    constants: int
    carried: int


def parts(program: Program) -> Parts:
    """What a program is made of.

    Raises:
        UnknownProgramError: It is not made as this file knows it.
    """
    try:
        inside = getattr(program, "jaxpr", program)
        constants = dict(zip(inside.constvars, getattr(program, "consts", ()), strict=True))
        equations = tuple(map(_equation, inside.eqns))
        return Parts(constants, tuple(inside.invars), equations, tuple(inside.outvars))
    except Exception as error:  # whatever JAX's objects raise that are not what they were
        raise UnknownProgramError(f"a program of JAX {jax.__version__} can't be read: {error}") from error


def _equation(raw: Any) -> Equation:
    return Equation(raw.primitive.name, tuple(raw.invars), tuple(raw.outvars), raw.params, raw)


def is_program(value: Any) -> bool:
    """Whether something that a parameter holds is a program."""
    return hasattr(getattr(value, "jaxpr", value), "eqns")


def is_literal(variable: Any) -> bool:
    """Whether an input or result is a number written into the program."""
    return hasattr(variable, "val")


def dtype_of(variable: Any) -> Any:
    """Type of the entries of a variable or literal; None if it is no array."""
    return getattr(variable.aval, "dtype", None)


def shape_of(variable: Any) -> tuple[int, ...]:
    """Shape of a variable or literal."""
    return variable.aval.shape


def evaluated(
    program: Program, arguments: Sequence[Any], evaluate: Callable[[Equation, list[Any]], Sequence[Any]]
) -> list[Any]:
    """The results of a program whose operations are done by a function of one's own.

    Args:
        program: The program.
        arguments: Its arguments.
        evaluate: The results of an operation with these inputs; `computed` does what JAX does.
    """
    made_of = parts(program)
    known = {**made_of.constants, **dict(zip(made_of.inputs, arguments, strict=True))}

    def read(variable: Any) -> Any:
        if is_literal(variable):
            return jax.numpy.asarray(variable.val, dtype_of(variable))
        return known[variable]

    for equation in made_of.equations:
        results = evaluate(equation, [read(variable) for variable in equation.inputs])
        known.update(zip(equation.outputs, results, strict=True))
    return [read(variable) for variable in made_of.outputs]


def computed(equation: Equation, operands: Sequence[Any]) -> Sequence[Any]:
    """The operation on arrays."""
    primitive = equation.made_by_jax.primitive
    bound = primitive.get_bind_params(dict(equation.params))
    functions, params = bound if isinstance(bound, tuple) else ((), bound)  # a pair up to JAX 0.9
    result = primitive.bind(*functions, *operands, **params)
    return result if primitive.multiple_results else [result]


def has_many_results(equation: Equation) -> bool:
    """Whether rules of the operation return a list, not one array."""
    return equation.made_by_jax.primitive.multiple_results


def programs_in(params: Mapping[str, Any]) -> Iterator[Program]:
    """The programs that the parameters of an operation hold, one by one or several in a tuple."""
    for value in params.values():
        yield from filter(is_program, value if isinstance(value, tuple | list) else (value,))


def called(equation: Equation) -> Program | None:
    """The program that an operation stands for; None if it is none of these or not made as they are."""
    if equation.name not in CALLS | CUSTOM_CALLS:
        return None
    held = [equation.params[name] for name in _HOLDERS if is_program(equation.params.get(name))]
    return held[0] if len(held) == 1 and _fits(held[0], equation.inputs, equation.outputs) else None


def branches(equation: Equation) -> tuple[Program, ...] | None:
    """The programs that `cond` chooses from by its first input; None if it is not made so."""
    found = equation.params.get("branches", ())
    fits = isinstance(found, tuple | list) and all(
        is_program(branch) and _fits(branch, equation.inputs[1:], equation.outputs) for branch in found
    )
    return tuple(found) if found and fits else None


def _fits(program: Program, inputs: Sequence[Any], outputs: Sequence[Any]) -> bool:
    made_of = parts(program)
    return len(made_of.inputs) == len(inputs) and len(made_of.outputs) == len(outputs)


def loop(equation: Equation) -> Loop | None:
    """A `scan`; None if it is not made as one of the versions that this file knows."""
    params, names = equation.params, set(equation.params)
    body, length = params.get("jaxpr"), params.get("length")
    if names - _LOOP not in (_COUNTS, _GROUPS) or not is_program(body) or not isinstance(length, int | np.integer):
        return None
    counts = _counts(equation)
    found = None if counts is None else Loop(body, int(length), bool(params.get("reverse")), *counts)
    return found if found is not None and _is_consistent(found, equation) else None


def _counts(equation: Equation) -> tuple[int, int] | None:
    """How many inputs of a `scan` are constants, and how many are its state."""
    params = equation.params
    if "num_consts" in params:
        return params["num_consts"], params["num_carry"]
    given, made = list(range(len(equation.inputs))), list(range(len(equation.outputs)))
    try:  # groups of positions, of constants, state and rows
        constants, carried, rows = map(list, params["ft_in"].update(given).unpack())
        carried_out, rows_out = map(list, params["ft_out"].update(made).unpack())
    except Exception:  # these objects are JAX's own, and say what they like where this is no way to use them
        return None
    in_order = constants + carried + rows == given and carried_out + rows_out == made
    return (len(constants), len(carried)) if in_order and len(carried) == len(carried_out) else None


def _is_consistent(found: Loop, equation: Equation) -> bool:
    """Whether the shapes of a loop's inputs and results are those of constants, state and rows, so counted."""
    made_of, first = parts(found.body), found.constants + found.carried
    if not _fits(found.body, equation.inputs, equation.outputs):
        return False
    whole = [
        *zip(equation.inputs[:first], made_of.inputs[:first], strict=True),
        *zip(equation.outputs[: found.carried], made_of.outputs[: found.carried], strict=True),
        *zip(made_of.inputs[found.constants : first], made_of.outputs[: found.carried], strict=True),
    ]
    stacked = [
        *zip(equation.inputs[first:], made_of.inputs[first:], strict=True),
        *zip(equation.outputs[found.carried :], made_of.outputs[found.carried :], strict=True),
    ]
    kind = lambda variable: (shape_of(variable), dtype_of(variable))  # noqa: E731 - used twice, here only
    rows = [((found.length, *shape_of(row)), dtype_of(row)) for _, row in stacked]
    return all(kind(a) == kind(b) for a, b in whole) and rows == [kind(array) for array, _ in stacked]


class Rewriter:
    """Replaces operations on float64 numbers by functions, wherever they stand in a program that can be entered.

    Where JAX's programs are not made as this file knows them, they are left as they are, which is always right.

    Args:
        functions: What to put in the place of operations of one input, by their names.
        known_to_hold: How messages begin of checks at run time that can't fail here. Such a check calls the host, and
            JAX keeps no program on disk that does: it is left out.
    """

    def __init__(self, functions: Mapping[str, Callable[..., Any]], known_to_hold: str = ""):
        self._functions, self._known_to_hold, self._problem = functions, known_to_hold, _MISSING
        self._calls: dict[Any, Any] = {}
        self._done: weakref.WeakKeyDictionary[Any, Any] = weakref.WeakKeyDictionary()

    @property
    def problem(self) -> str:
        """Why programs are left as they are, in JAX's words; empty while none was."""
        return self._problem

    def run(self, program: Program) -> Sequence[Any] | None:
        """The results of a program without arguments, rewritten; None if it has to be left as it is."""
        rewritten = self._or_same(program, self._once)
        return None if self._problem else core.jaxpr_as_fun(rewritten)()

    def is_done(self, program: Program) -> bool:
        """Whether nothing that should be replaced is left in a program, wherever it may hide; no in doubt."""
        try:
            return not self._holds(program, or_hides=True)
        except Exception:
            return False  # as above

    def _or_same(self, part: Any, rewrite: Callable[[Any], Any]) -> Any:
        if self._problem:
            return part
        try:
            return rewrite(part)
        except Exception as error:  # whatever a form that is not known leads to; the original is as good
            self._problem = f"{type(error).__name__}: {error}".splitlines()[0]
            return part

    def _once(self, program: Program) -> Program:
        """A program that is called in many places stays one program, which JAX goes through once."""
        if program not in self._done:
            inside = program.jaxpr
            rewritten = self._open(inside)
            # From JAX 0.11 on a program holds its constants itself.
            self._done[program] = rewritten if inside is program else program.replace(jaxpr=rewritten)
        return self._done[program]

    def _open(self, program: Any) -> Any:
        return program.replace(eqns=list(map(self._equation, program.eqns)))

    def _part(self, part: Any) -> Any:
        """A program rewritten, wherever it sits in the parameters of an equation."""
        if is_program(part):
            return self._once(part) if hasattr(part, "jaxpr") else self._open(part)
        if isinstance(part, lu.WrappedFun):  # makes the program of a custom derivative, when asked
            return lu.wrap_init(ft.partial(self._rule, part), debug_info=part.debug_info)
        if isinstance(part, tuple):
            items = map(self._part, part)
            return type(part)(*items) if hasattr(part, "_fields") else tuple(items)  # a named tuple stays one
        return part

    def _equation(self, raw: Any) -> Any:
        equation = _equation(raw)
        if self._is_replaced(equation):
            other = self._call(equation) if self._is_slow(equation) else _unknown(equation)
            return raw.replace(primitive=other.primitive, params=other.params, effects=other.effects)
        if equation.name in _ENTERED and any(map(self._holds, programs_in(equation.params))):
            # `bwd`, the backward pass of a custom derivative, is a function of numbers: it makes no program.
            return raw.replace(params={k: v if k == "bwd" else self._part(v) for k, v in equation.params.items()})
        return raw

    def _rule(self, rule: Any, *args: Any) -> tuple[Any, ...]:
        program, *rest = rule.call_wrapped(*args)
        return self._or_same(program, self._part), *rest

    def _is_replaced(self, equation: Equation) -> bool:
        return self._is_slow(equation) or bool(self._known_to_hold and _told(equation).startswith(self._known_to_hold))

    def _is_slow(self, equation: Equation) -> bool:
        return equation.name in self._functions and dtype_of(equation.inputs[0]) == np.float64

    def _holds(self, program: Program, or_hides: bool = False) -> bool:
        """Whether there is something to replace in it; a program left as it is keeps what JAX has cached for it."""
        return any(
            self._is_replaced(equation)
            or (or_hides and equation.name in OPAQUE and any(dtype_of(each) == np.float64 for each in equation.outputs))
            or any(self._holds(inner, or_hides) for inner in programs_in(equation.params))
            for equation in map(_equation, getattr(program, "jaxpr", program).eqns)
        )

    def _call(self, equation: Equation) -> Any:
        """The one equation that a call of the function is."""
        (operand,) = equation.inputs
        key = equation.name, shape_of(operand), bool(operand.aval.weak_type)
        if key not in self._calls:
            stand_in = jax.ShapeDtypeStruct(key[1], np.float64, weak_type=key[2])
            with in_64_bits():
                (self._calls[key],) = jax.make_jaxpr(self._functions[equation.name])(stand_in).eqns
        return self._calls[key]


def _told(equation: Equation) -> str:
    """What a check at run time says where it fails; empty if an operation is none."""
    if equation.name != "pure_callback":
        return ""
    tells = getattr(equation.params.get("callback"), "callback_func", None)
    if getattr(tells, "__module__", "") != "equinox._errors":
        return ""
    told = inspect.getclosurevars(tells).nonlocals.get("msgs", ())
    return told[0] if len(told) == 1 else ""


def _unknown(equation: Equation) -> Any:
    """The one equation that makes NaN in the place of an operation's results: whatever would need them shows it."""

    def make(*inputs: Any) -> tuple[Any, ...]:
        del inputs
        return tuple(jax.numpy.full(shape_of(each), np.nan, dtype_of(each)) for each in equation.outputs)

    stand_ins = [jax.ShapeDtypeStruct(shape_of(each), dtype_of(each)) for each in equation.inputs]
    with in_64_bits():
        (made,) = jax.make_jaxpr(jax.jit(make))(*stand_ins).eqns
    return made

"""A hash of what a traced program computes: its operations, and the numbers that it closes over."""

import hashlib
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qsmc_jax.tracing.programs import Program, UnknownProgramError, dtype_of, is_literal, is_program, parts, shape_of

_ADDRESS = re.compile(r" at 0x[0-9a-fA-F]+")


def digest(program: Program, *others: Any) -> str:
    """A hash that is the same in every process, and another one as soon as an operation or a number is another.

    Args:
        program: What `jax.make_jaxpr` returned.
        *others: What else counts: programs, texts, numbers, arrays, and containers of these.
    """
    hashed = hashlib.sha256()
    try:
        _feed_program(hashed, program)
    except UnknownProgramError:  # of a JAX to come: its text tells it, but for its longer arrays
        _feed(hashed, [str(program), list(getattr(program, "consts", ()))])
    _feed(hashed, others)
    return hashed.hexdigest()[:16]


def _feed_program(hashed: Any, program: Program) -> None:
    made_of = parts(program)
    numbers: dict[Any, int] = {}
    for variable, value in made_of.constants.items():
        numbers[variable] = len(numbers)
        _feed(hashed, np.asarray(value))
    for variable in made_of.inputs:
        numbers[variable] = len(numbers)
        _feed(hashed, (str(dtype_of(variable)), shape_of(variable)))

    def named(variable: Any) -> Any:
        return np.asarray(variable.val) if is_literal(variable) else numbers.setdefault(variable, len(numbers))

    for equation in made_of.equations:
        _feed(hashed, (equation.name, [named(each) for each in (*equation.inputs, *equation.outputs)]))
        for name in sorted(equation.params):
            _feed(hashed, name)
            _feed(hashed, equation.params[name])
    _feed(hashed, [named(each) for each in made_of.outputs])


def _feed(hashed: Any, value: Any) -> None:
    """Adds a value so that no two different ones look alike."""
    if is_program(value):
        _feed_program(hashed, value)
    elif isinstance(value, np.ndarray | np.generic) or hasattr(value, "__array__"):
        array = np.asarray(value)
        hashed.update(f"array {array.dtype} {array.shape}".encode() + array.tobytes())
    elif isinstance(value, Mapping):
        _feed(hashed, sorted(((str(key), item) for key, item in value.items()), key=lambda pair: pair[0]))
    elif isinstance(value, set | frozenset):
        _feed(hashed, sorted(map(_text, value)))
    elif isinstance(value, Sequence) and not isinstance(value, str | bytes):
        hashed.update(f"list {len(value)}".encode())
        for item in value:
            _feed(hashed, item)
    else:
        hashed.update(f"text {len(_text(value))} {_text(value)}".encode())


def _text(value: Any) -> str:
    """What a value is, without where it is in memory."""
    return _ADDRESS.sub("", repr(value))

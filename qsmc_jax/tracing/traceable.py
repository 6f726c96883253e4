"""Tracing of what users wrote, with messages in words for who wrote it."""

import contextlib
import functools as ft
from collections.abc import Callable, Hashable, Iterator
from typing import Any, TypeVar

import equinox as eqx
import jax

from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.tracing.programs import Program

T = TypeVar("T")
R = TypeVar("R")
_KEPT = 256  # structures


def once_per_structure(check: Callable[[T], R]) -> Callable[[T], R]:
    """A check, such as by `trace`, that the numbers in a module do not matter to: once for each structure that passes.

    What it returns is kept. A module that holds a function is checked each time: the function may close over what must
    not be kept.
    """
    passed: dict[Hashable, R] = {}

    @ft.wraps(check)
    def wrapped(module: T) -> R:
        leaves, structure = jax.tree.flatten(module)
        key = structure, tuple(map(_kind_of, leaves))
        if any(map(callable, leaves)) or not _is_hashable(key):
            return check(module)
        if key not in passed:
            found = check(module)
            if len(passed) >= _KEPT:
                passed.clear()
            passed[key] = found
        return passed[key]

    return wrapped


def _kind_of(leaf: Any) -> Hashable:
    """Shape and type of an array; anything else itself, since Python may branch on it."""
    return (leaf.shape, leaf.dtype) if eqx.is_array(leaf) else leaf


def _is_hashable(key: Any) -> bool:
    try:
        hash(key)
    except TypeError:  # a static field, say a list
        return False
    return True


@contextlib.contextmanager
def traceable(what: str, values: str) -> Iterator[None]:
    """Turns JAX's errors about tracers into an `InputError` that says what to write instead.

    Args:
        what: The function, as the subject of the message.
        values: What has no numbers while the function is traced.

    Raises:
        InputError: Inside the context a traced number was used as a Python number.
    """
    try:
        yield
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError) as error:
        said = str(error).strip().splitlines()[0]
        raise InputError(
            f"{what} must be written with `jax.numpy`, not `numpy` or `math`, with `jnp.where` in place of a Python "
            f"`if`, and without `float()`: JAX traces it with stand-ins for {values}. JAX says: {said}"
        ) from error


def trace(what: str, takes: str, module: Any, call: Callable[..., Any], *arguments: Any) -> tuple[Program, Any]:
    """The program of what a module does, in 64 bits, and the shapes of what it returns.

    The arrays in the module are traced too, as they are in a solve, and come before the arguments.

    Args:
        what: What the module does, as the subject of a message.
        takes: What it is given, for the message.
        module: The module.
        call: Does it: `call(module, *arguments)`.
        *arguments: Shapes of its arguments.

    Raises:
        InputError: It can't be traced, or not be called so.
    """
    arrays, rest = eqx.partition(module, eqx.is_array)
    shapes = jax.tree.map(lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype), arrays)

    def program(arrays: Any, *arguments: Any) -> Any:
        return call(eqx.combine(arrays, rest), *arguments)

    try:
        with in_64_bits(), traceable(what, f"{takes} and for its arrays"):
            return jax.make_jaxpr(program, return_shape=True)(shapes, *arguments)
    except (IndexError, TypeError) as error:
        raise InputError(f"{what} must take {takes} (and `self`), but calling it says: {error}.") from error


def require_number(what: str, result: Any, hint: str = "") -> None:
    """Raises unless what a traced function returned is one number."""
    if not is_number(result):
        raise InputError(f"{what} must return one number, but returns {described(result)}. {hint}".rstrip())


def is_number(result: Any) -> bool:
    """Whether what a traced function returned is one number."""
    return getattr(result, "shape", None) == ()


def described(result: Any) -> str:
    """What a traced function returned, in words."""
    if isinstance(result, tuple | list):
        return f"{len(result)} of them: {', '.join(map(described, result))}"
    return f"shape {result.shape}" if hasattr(result, "shape") else type(result).__name__

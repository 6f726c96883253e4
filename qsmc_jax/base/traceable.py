"""Tracing of functions that users wrote, with messages in words for who wrote them."""

import contextlib
import functools as ft
from collections.abc import Callable, Hashable, Iterator
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
from jax.extend.core import ClosedJaxpr

T = TypeVar("T")
_KEPT = 1024  # structures


def once_per_structure(check: Callable[[T], None]) -> Callable[[T], None]:
    """A check of a module that does not depend on the numbers in it: made once for each structure that passes."""
    passed: set[Hashable] = set()

    @ft.wraps(check)
    def wrapped(module: T) -> None:
        leaves, structure = jax.tree.flatten(module)
        key = structure, tuple(map(_kind_of, leaves))
        if not _is_hashable(key):
            check(module)
        elif key not in passed:
            check(module)
            if len(passed) >= _KEPT:
                passed.clear()
            passed.add(key)

    return wrapped


def _is_hashable(key: Any) -> bool:
    try:
        hash(key)
    except TypeError:  # a static field, say a list
        return False
    return True


def _kind_of(leaf: Any) -> Hashable:
    """Shape and type of an array; anything else itself, since Python may branch on it."""
    return (np.shape(leaf), leaf.dtype) if eqx.is_array(leaf) or isinstance(leaf, np.ndarray) else leaf


@contextlib.contextmanager
def traceable(what: str, values: str) -> Iterator[None]:
    """Turns JAX's errors about tracers into a `ValueError` that says what to write instead.

    Args:
        what: The function, as the subject of the message.
        values: What has no number while the function is traced.

    Raises:
        ValueError: Inside the context a traced number was used as a Python number.
    """
    try:
        yield
    except (jax.errors.JAXTypeError, jax.errors.JAXIndexError) as error:
        said = str(error).strip().splitlines()[0]
        raise ValueError(
            f"{what} must be written with `jax.numpy`, not `numpy` or `math`, with `jnp.where` in place of a Python "
            f"`if`, and without `float()`: {values} is no number yet while JAX traces it. JAX says: {said}"
        ) from error


def trace(what: str, values: str, function: Callable[..., Any], *arguments: Any) -> tuple[ClosedJaxpr, Any]:
    """The program of a function in 64 bits, and the shapes of what it returns.

    Args:
        what: The function, as the subject of a message.
        values: What its arguments are, for the message.
        function: The function.
        *arguments: Shapes of its arguments.
    """
    with jax.enable_x64(True), traceable(what, values):
        return jax.make_jaxpr(function, return_shape=True)(*arguments)


def require_number(what: str, result: Any, remedy: str = "") -> None:
    """Raises unless what a traced function returned is one number."""
    if not is_number(result):
        raise ValueError(f"{what} must return one number, but returns {described(result)}. {remedy}".rstrip())


def is_number(result: Any) -> bool:
    """Whether what a traced function returned is one number."""
    return getattr(result, "shape", None) == ()


def described(result: Any) -> str:
    """What a traced function returned, in words."""
    if isinstance(result, tuple | list):
        return f"{len(result)} of them: {', '.join(map(described, result))}"
    return f"shape {result.shape}" if hasattr(result, "shape") else type(result).__name__

"""The base class of everything that holds parameters, and the one way to declare a number field."""

import dataclasses
import functools as ft
from types import UnionType
from typing import TYPE_CHECKING, Any, ClassVar, Union, get_args, get_origin, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from qsmc_jax.base.checks import require, require_kind
from qsmc_jax.base.errors import InputError


class AbstractModule(eqx.Module):
    """A frozen dataclass and pytree, describing one trajectory's worth of parameters.

    Number fields are declared with `float_field()`; everything else is static and hashable. After construction each
    array field is compared with its annotation: a shape that does not fit is refused by name.

    A class of the package is abstract, and named so, or final: what is solved and judged is the class as it is written
    here, not a method that a subclass puts in its place.
    """

    # How to come by one; added to the message where something else is given instead.
    hint: ClassVar[str] = ""
    # What is possible where one would derive a class from a final one; added to that message.
    instead: ClassVar[str] = ""

    def __init_subclass__(cls, **kwargs: Any):
        super().__init_subclass__(**kwargs)
        for base in cls.__mro__[1:]:
            if _is_ours(base) and not _is_abstract(base):
                raise TypeError(_final(cls.__name__, base))

    def __check_init__(self):
        require_fields(self)

    def __repr__(self) -> str:
        fields = dataclasses.fields(self)  # pyright: ignore[reportArgumentType]  # every `eqx.Module` is a dataclass
        shown = (f"{field.name}={_shown(getattr(self, field.name, None))}" for field in fields if field.repr)
        return f"{type(self).__name__}({', '.join(shown)})"


def require_fields(module: AbstractModule) -> None:
    """Raises unless every field has the shape or is of the class of modules that it is annotated with.

    Construction does so by itself, but after the checks of the subclass: one that uses its fields calls this.
    """
    owner = type(module).__name__
    for name, hint in _hints(type(module)).items():
        value: Any = getattr(module, name, None)
        dims, kinds = _dimensions(hint), _module_classes(hint)
        if dims is not None and "..." not in dims and eqx.is_array_like(value):
            rank = len(dims.split())
            fits = np.ndim(value) == rank
            require(fits, f"Argument `{name}` of `{owner}` must be {_RANKS[rank]}, but has shape {np.shape(value)}.")
        is_left_out = value is None and type(None) in get_args(hint)
        if kinds and not is_left_out and not isinstance(value, kinds):
            require_kind(f"{name}` of `{owner}", value, kinds[0], kinds[0].hint)


def _shown(value: Any) -> str:
    """A field in a few characters: numbers as they are, longer arrays by their shape."""
    if isinstance(value, tuple):
        return f"({', '.join(map(_shown, value))}{',' if len(value) == 1 else ''})"
    if isinstance(value, AbstractModule):
        return repr(value)
    if isinstance(value, Tracer) or not eqx.is_array(value):
        return eqx.tree_pformat(value)
    if value.ndim == 0:
        return f"{value.item():.8g}" if value.dtype.kind == "f" else str(value.item())
    if value.size > _LONGEST_SHOWN:
        return f"{value.dtype}[{','.join(map(str, value.shape))}]"
    return np.array2string(np.asarray(value), precision=8, separator=", ", floatmode="maxprec")


def _is_ours(kind: type) -> bool:
    return issubclass(kind, AbstractModule) and kind.__module__.split(".")[0] == __name__.split(".")[0]


def _is_abstract(kind: type) -> bool:
    return kind.__name__.lstrip("_").startswith("Abstract")


def _final(name: str, base: type[AbstractModule]) -> str:
    """The message for a class that is derived from a final one."""
    interfaces = [kind for kind in base.__mro__ if _is_ours(kind) and _is_abstract(kind) and kind is not AbstractModule]
    refusal = f"Class `{name}` must not be derived from `{base.__name__}`, which is final."
    if not interfaces:
        return f"{refusal} {base.instead or f'Keep a `{base.__name__}` in a field instead.'}"
    derive = f"Derive it from `{interfaces[0].__name__}` of `{interfaces[0].__module__}`"
    return f"{refusal} {derive}, and keep a `{base.__name__}` in a field if need be. {base.instead}".rstrip()


@ft.lru_cache(maxsize=256)
def _hints(kind: type) -> dict[str, Any]:
    return get_type_hints(kind, include_extras=True)


def _module_classes(hint: Any) -> tuple[type[AbstractModule], ...]:
    """The classes of modules that an annotation allows, also one that allows None; none if it allows anything else."""
    is_union = get_origin(hint) in (Union, UnionType)
    allowed = tuple(part for part in (get_args(hint) if is_union else [hint]) if part is not type(None))
    are_modules = all(isinstance(part, type) and issubclass(part, AbstractModule) for part in allowed)
    return allowed if are_modules else ()


def _dimensions(hint: Any) -> str | None:
    """The axes of a jaxtyping annotation, also of one that allows None; None for anything else."""
    for part in (hint, *get_args(hint)):
        if hasattr(part, "dim_str"):
            return part.dim_str
    return None


# Numbers of an array that are shown.
_LONGEST_SHOWN = 8
_RANKS = {0: "a single number", 1: "a one-dimensional list of numbers", 2: "a matrix"}


if TYPE_CHECKING:
    from equinox import field as float_field  # the only name by which type checkers know a field of an `eqx.Module`
else:

    def float_field(**kwargs: Any) -> Any:
        """A dataclass field that holds a float64 array, or a tracer.

        A bare Python float would be invisible to `grad` and `vmap` and would recompile for every value; `jnp.asarray`
        outside a 64-bit context would round 0.05 to float32 for good. So NumPy float64 is held, and moved to the device
        by the entry points.
        """
        return eqx.field(converter=as_float64, **kwargs)


# NumPy's kinds of texts, times and complex numbers, which it would turn into floats if it can.
_NO_NUMBERS = "USMmc"


def as_float64(value: Any) -> Any:
    """`value` as a NumPy float64 array; JAX arrays, tracers and sequences holding tracers become JAX arrays.

    None, which stands for something switched off, stays None.

    Raises:
        InputError: It is a text, a date or complex.
    """
    if value is None:
        return None
    if isinstance(value, Tracer):
        return value.astype(float) if jnp.issubdtype(value.dtype, jnp.integer) else value
    if isinstance(value, list | tuple) and any(isinstance(v, Tracer) for v in jax.tree.leaves(value)):
        return jnp.stack([jnp.asarray(v) for v in value])
    array = np.asarray(value)
    if array.dtype.kind in _NO_NUMBERS:
        raise InputError(f"A number or a list of numbers is wanted, but {value!r} was given.")
    return np.asarray(array, dtype=np.float64)

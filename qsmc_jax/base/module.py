"""The base class of everything that holds parameters, and the one way to declare a number field."""

from typing import TYPE_CHECKING, Any, get_args, get_type_hints

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer


class AbstractModule(eqx.Module):
    """A frozen dataclass and pytree, describing one trajectory's worth of parameters.

    Number fields are declared with `float_field()`; everything else is static and hashable. After construction each
    array field is compared with its annotation: a shape that does not fit is refused by name.
    """

    def __check_init__(self):
        for name, hint in get_type_hints(type(self), include_extras=True).items():
            dims = _dimensions(hint)
            value: Any = getattr(self, name, None)
            if dims is None or not eqx.is_array_like(value):
                continue
            rank = len(dims.split())
            if np.ndim(value) != rank:
                raise ValueError(
                    f"Argument `{name}` of `{type(self).__name__}` must be {_RANKS[rank]}, but has shape "
                    f"{np.shape(value)}."
                )


def _dimensions(hint: Any) -> str | None:
    """The axes of a jaxtyping annotation, also of one that allows None; None for anything else."""
    for part in (hint, *get_args(hint)):
        if hasattr(part, "dim_str"):
            return part.dim_str
    return None


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


def as_float64(value: Any) -> Any:
    """`value` as a NumPy float64 array; JAX arrays, tracers and sequences holding tracers become JAX arrays.

    None, which stands for something switched off, stays None.
    """
    if value is None:
        return None
    if isinstance(value, Tracer):
        return value.astype(float) if jnp.issubdtype(value.dtype, jnp.integer) else value
    if isinstance(value, list | tuple) and any(isinstance(v, Tracer) for v in jax.tree.leaves(value)):
        return jnp.stack([jnp.asarray(v) for v in value])
    return np.asarray(value, dtype=np.float64)

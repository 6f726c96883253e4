"""Random numbers that belong to a run and a sample: pure functions of a seed in the unit interval and a counter."""

import jax
import jax.numpy as jnp
import jax.random as jr
from jaxtyping import Array, Float, Key

from qsmc_jax.base.types import RealScalarLike


def keyed(seed: RealScalarLike, k: RealScalarLike) -> Key[Array, ""]:
    """The key of sample `k` of the realisation `seed`; every bit of the float64 `seed` counts.

    The generator is Threefry-2x32 whatever JAX's default is.
    """
    words = jax.lax.bitcast_convert_type(jnp.asarray(seed, float), jnp.uint32)
    return jr.fold_in(jr.wrap_key_data(words, impl="threefry2x32"), jnp.asarray(k).astype(jnp.uint32))


def uniforms(seed: RealScalarLike, k: RealScalarLike, count: int) -> tuple[Float[Array, ""], ...]:
    """Independent numbers, uniform on [-1, 1)."""
    values = jr.uniform(keyed(seed, k), (count,), float, -1.0, 1.0)
    return tuple(values[i] for i in range(count))


def normals(seed: RealScalarLike, k: RealScalarLike, count: int) -> tuple[Float[Array, ""], ...]:
    """Independent standard normal numbers."""
    values = jr.normal(keyed(seed, k), (count,), float)
    return tuple(values[i] for i in range(count))

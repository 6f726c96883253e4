"""Random numbers that belong to a run and a sample: pure functions of a consumer, a seed and a counter."""

import enum

import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Key

from qsmc_jax.base.types import RealScalarLike


class Consumer(enum.IntEnum):
    """What the numbers are for: each gets its own, whatever the seeds. Up to eight; new ones go to the end."""

    JITTER = 0
    WHITE = 1
    UNIFORM = 2


# Each consumer counts in a range of its own, of more samples than a run can have.
_SAMPLES = 2**29

# Sets the first bit of a key, which no key of a study has: `jr.key(seed)` for seeds below 2^63.
_APART = np.array([2**31, 0], np.uint32)


def counter_key(consumer: Consumer, seed: RealScalarLike, k: RealScalarLike) -> Key[Array, ""]:
    """The key of sample `k` of the realisation `seed`, a number in [0, 1); every bit of the float64 `seed` counts.

    No consumer, seed or sample shares its key with another, nor with the points of a study. The generator is
    Threefry-2x32 whatever JAX's default is.
    """
    low, high = jax.lax.bitcast_convert_type(jnp.asarray(seed, float), jnp.uint32)
    key = jr.wrap_key_data(jnp.stack([high, low]) ^ _APART, impl="threefry2x32")
    return jr.fold_in(key, jnp.asarray(k).astype(jnp.uint32) + np.uint32(consumer * _SAMPLES))


def uniforms(consumer: Consumer, seed: RealScalarLike, k: RealScalarLike, count: int) -> tuple[Float[Array, ""], ...]:
    """Independent numbers, uniform on [-1, 1)."""
    values = jr.uniform(counter_key(consumer, seed, k), (count,), float, -1.0, 1.0)
    return tuple(values[i] for i in range(count))


def normals(consumer: Consumer, seed: RealScalarLike, k: RealScalarLike, count: int) -> tuple[Float[Array, ""], ...]:
    """Independent standard normal numbers."""
    values = jr.normal(counter_key(consumer, seed, k), (count,), float)
    return tuple(values[i] for i in range(count))

"""Points of the unit cube, one a run: independent, or spread more evenly.

A point is a pure function of (design, seed, index), whatever other indices are asked for: any run can be done again
alone.
"""

import abc
import functools as ft
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, ClassVar, TypeAlias

import equinox as eqx
import jax
import jax.numpy as jnp
import jax.random as jr
import numpy as np
from jaxtyping import Array, Float, Key, UInt32

from qsmc_jax.base.checks import is_whole, require, require_count, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import AbstractModule, float_field, require_fields
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.tracing.platforms import platform

if TYPE_CHECKING:
    from scipy.stats import qmc

Indices: TypeAlias = Sequence[int] | np.ndarray

# What to use where something else is given.
SAMPLINGS = "Use `qj.Random()`, `qj.Sobol()`, `qj.LatinHypercube(runs)` or `qj.Table(rows)`."
_BLOCK = 1024  # points made together at the least
_HALF_CELL = 2.0**-53  # `jr.uniform` gives multiples of 2**-52; their cells' midpoints lie in the open interval
_SOBOL_BITS = 32  # SciPy's `fast_forward` fails for more


class AbstractSampling(AbstractModule):
    """A way of placing the runs of a study in the unit cube."""

    is_independent: eqx.AbstractClassVar[bool]
    why_not: eqx.AbstractClassVar[str]  # why no exact interval holds and what to do; empty if it does

    @abc.abstractmethod
    def points(self, seed: int, indices: Indices, dim: int) -> Float[np.ndarray, "runs dim"]:
        """The points of the given runs.

        Args:
            seed: Seed of the whole design, 0 <= seed < 2**63.
            indices: Indices of the runs, in any order, 0 <= index < 2**63 unless the design has fewer points.
            dim: Coordinates a point, 0 or more.

        Returns:
            One row a run, in the order of `indices`; every coordinate lies strictly between 0 and 1.
        """


class Random(AbstractSampling):
    """Independent, uniform points: run i uses `fold_in(key(seed), i)`.

    The generator is Threefry-2x32 whatever JAX's default is. An index of 2**32 or more is folded in as two words, the
    low one first.

    Examples:
        A run has the same point whatever other runs there are:

        >>> import qsmc_jax as qj
        >>> points = qj.Random().points(seed=0, indices=range(8), dim=2)
        >>> points.shape, bool((points[7] == qj.Random().points(0, [7], 2)[0]).all())
        ((8, 2), True)
    """

    is_independent: ClassVar[bool] = True
    why_not: ClassVar[str] = ""

    def points(self, seed: int, indices: Indices, dim: int) -> Float[np.ndarray, "runs dim"]:
        wanted = _checked_indices(seed, indices, 2**63)
        size = max(_BLOCK, platform().block)
        padded = np.resize(wanted, -(-wanted.size // size) * size).reshape(-1, size)
        with in_64_bits(), jax.threefry_partitionable(True):
            key = jr.key(seed, impl="threefry2x32")
            blocks = [_random_block(key, *_words(block), dim) for block in padded]
        return np.concatenate([np.empty((0, dim)), *blocks])[: wanted.size]


class Sobol(AbstractSampling):
    """Scrambled Sobol points: far more even than random ones, which sharpens means and plots.

    2**32 points at most. Best with a power of two of runs, from index 0 on.

    Examples:
        Four points lie in the four quarters:

        >>> import qsmc_jax as qj
        >>> points = qj.Sobol().points(seed=0, indices=range(4), dim=1)
        >>> sorted(int(4 * x) for x in points[:, 0])
        [0, 1, 2, 3]

    Source: Owen's scrambling by linear matrix and digital shift, as in `scipy.stats.qmc.Sobol`.
    """

    is_independent: ClassVar[bool] = False
    why_not: ClassVar[str] = (
        "Sobol points are not independent, so no exact interval holds; use `Random()` for a certificate."
    )

    def points(self, seed: int, indices: Indices, dim: int) -> Float[np.ndarray, "runs dim"]:
        wanted = _checked_indices(seed, indices, 2**_SOBOL_BITS)
        if wanted.size == 0 or dim == 0:
            return np.empty((wanted.size, dim))
        most = _qmc().Sobol.MAXDIM
        require(dim <= most, f"Argument `dim` must be at most {most} for `Sobol`, but is {dim}. Use `Random()`.")
        first, columns = _sobol_generators(seed, dim, int(wanted.max()).bit_length())
        gray = wanted ^ (wanted >> 1)
        numbers = np.tile(first, (wanted.size, 1))
        for bit, column in enumerate(columns):
            numbers ^= np.where((gray >> bit & 1)[:, None] == 1, column, 0)
        return (numbers + 0.5) * 2.0**-_SOBOL_BITS


class LatinHypercube(AbstractSampling):
    """A Latin hypercube: in every coordinate each of the `runs` equal slices holds exactly one point.

    The slices depend on the size of the design, which must be known up front: it can't be extended, and the whole of it
    is made (and the last one kept) to give any one point. Strength 1: single coordinates are balanced, not pairs.

    Attributes:
        runs: Size of the design.

    Examples:
        Five points lie in the five fifths, in each coordinate:

        >>> import qsmc_jax as qj
        >>> points = qj.LatinHypercube(runs=5).points(seed=0, indices=range(5), dim=2)
        >>> [sorted(int(5 * x) for x in column) for column in points.T]
        [[0, 1, 2, 3, 4], [0, 1, 2, 3, 4]]

    Source: `scipy.stats.qmc.LatinHypercube`.
    """

    runs: int = eqx.field(static=True)

    is_independent: ClassVar[bool] = False
    why_not: ClassVar[str] = (
        "Points of a Latin hypercube are not independent, so no exact interval holds; use `Random()` for a certificate."
    )

    def __check_init__(self):
        require_count("runs", self.runs)

    def points(self, seed: int, indices: Indices, dim: int) -> Float[np.ndarray, "runs dim"]:
        wanted = _checked_indices(seed, indices, self.runs)
        return _latin_hypercube(seed, self.runs, dim)[wanted]


class Table(AbstractSampling):
    """Points of your own: run i is row i. See `table_of` for a design in physical values.

    The rows are what SALib, OpenTURNS or `scipy.stats.qmc` give, a column for each number that the study draws, in
    order of appearance. How they were made is not known here, so no exact interval holds, random or not.

    Attributes:
        rows: The points, strictly between 0 and 1.

    Examples:
        >>> import scipy.stats
        >>> import qsmc_jax as qj
        >>> halton = scipy.stats.qmc.Halton(2, rng=0).random(64)
        >>> design = qj.Table(halton)
        >>> len(design), bool((design.points(0, [17], 2) == halton[17]).all())
        (64, True)

    Raises:
        InputError: The rows are no matrix, or have a number that is not strictly between 0 and 1.
    """

    rows: Float[np.ndarray, "runs dim"] = float_field()

    is_independent: ClassVar[bool] = False
    why_not: ClassVar[str] = (
        "whether the rows of a `Table` are independent is not known, so no exact interval holds: solve them by "
        "`monte_carlo` and count; use `Random()` for a certificate."
    )

    def __check_init__(self):
        require_fields(self)
        outside = np.argwhere(~((self.rows > 0.0) & (self.rows < 1.0)))
        if len(outside):
            row, column = outside[0]
            raise InputError(
                "Argument `rows` must lie strictly between 0 and 1, where every distribution is finite, but row "
                f"{row}, column {column} is {show(self.rows[row, column])}. Scramble the design."
            )

    def __len__(self) -> int:
        return len(self.rows)

    def points(self, seed: int, indices: Indices, dim: int) -> Float[np.ndarray, "runs dim"]:
        columns = self.rows.shape[1]
        require(dim == columns, f"Argument `rows` must have {dim} columns, as the study draws, but has {columns}.")
        return self.rows[_checked_indices(seed, indices, len(self.rows))]


def require_independent(sampling: AbstractSampling, purpose: str) -> None:
    """Raises unless exact intervals hold for a design."""
    require(sampling.is_independent, f"Argument `sampling` must be independent for `{purpose}`: {sampling.why_not}")


@eqx.filter_jit
def _random_block(key: Key[Array, ""], low: UInt32[Array, " runs"], high: UInt32[Array, " runs"], dim: int) -> Array:
    """A block of independent points; one trace a dimension."""
    return jax.vmap(lambda lo, hi: _random_point(key, lo, hi, dim))(low, high)


def _random_point(
    key: Key[Array, ""], low: UInt32[Array, ""], high: UInt32[Array, ""], dim: int
) -> Float[Array, " dim"]:
    """The point of the run with index `low + 2**32 * high`."""
    first = jr.fold_in(key, low)
    run_key = jnp.where(high == 0, first, jr.fold_in(first, high))
    return jr.uniform(run_key, (dim,), np.float64) + _HALF_CELL


def _qmc() -> Any:
    """SciPy's designs: they take a third of a second to load, and few studies need them."""
    from scipy.stats import qmc

    return qmc


def _words(indices: np.ndarray) -> tuple[UInt32[Array, " runs"], UInt32[Array, " runs"]]:
    """Low and high 32 bits."""
    return jnp.asarray(indices & 0xFFFFFFFF, jnp.uint32), jnp.asarray(indices >> 32, jnp.uint32)


@ft.lru_cache(maxsize=16)
def _sobol_generators(seed: int, dim: int, bits: int) -> tuple[np.ndarray, list[np.ndarray]]:
    """Point 0 and what each of the lowest `bits` bits of an index's Gray code flips in it, as 32-bit integers.

    A scrambled Sobol sequence is linear over bits, and the Gray code of 2**k is bits k and k - 1: so points 0, 1, 2, 4,
    8 ... give every other point, without walking to it.
    """
    engine = _qmc().Sobol(dim, scramble=True, bits=_SOBOL_BITS, rng=np.random.default_rng(seed))
    first = _next_integers(engine)
    column = np.zeros_like(first)
    columns = []
    for bit in range(bits):
        engine.fast_forward(2**bit - engine.num_generated)
        column = _next_integers(engine) ^ first ^ column
        columns.append(column)
    return first, columns


def _next_integers(engine: "qmc.Sobol") -> np.ndarray:
    """The next point times 2**32, which is whole."""
    return (engine.random(1)[0] * 2.0**_SOBOL_BITS).astype(np.int64)


@ft.lru_cache(maxsize=1)
def _latin_hypercube(seed: int, runs: int, dim: int) -> np.ndarray:
    """The whole design; SciPy's points may touch 1."""
    if dim == 0:
        return np.empty((runs, 0))
    points = _qmc().LatinHypercube(dim, rng=np.random.default_rng(seed)).random(runs)
    return np.clip(points, _HALF_CELL, 1.0 - _HALF_CELL)


def require_seed(seed: int) -> None:
    """Raises unless it is the seed of some design."""
    require(is_whole(seed), f"Argument `seed` must be a whole number, but is {seed!r}.")
    require(0 <= seed < 2**63, f"Argument `seed` must be in [0, 2**63), but is {seed}.")


def _checked_indices(seed: int, indices: Indices, limit: int) -> np.ndarray:
    """The indices as int64."""
    require_seed(seed)
    array = np.asarray(indices) if len(indices) else np.empty(0, np.int64)
    require(
        array.ndim == 1 and array.dtype.kind in "iu",
        f"Argument `indices` must be a one-dimensional list of integers below 2**63, but has shape {array.shape} and "
        f"type {array.dtype}.",
    )
    for index in (int(array.min(initial=0)), int(array.max(initial=0))):
        require(0 <= index < limit, f"Argument `indices` must be in [0, {limit}) for this design, but has {index}.")
    return array.astype(np.int64)

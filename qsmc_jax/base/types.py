"""Annotations shared by the whole package, and the glossary of array axes.

Axes: `n` state components, `c` surface coefficients (`n - 1`), `terms` summands of a signal, `breaks` times at
which a signal jumps or kinks, `times` a time grid, `runs` Monte Carlo runs, `lanes` runs solved together in a block,
`dim` coordinates of the unit cube.

Models are written for one trajectory and one instant: a state is a tuple of scalars, indexed `x[0] ... x[n - 1]`,
because XLA turns scalars under `vmap` into well-vectorised loops, and small stacked vectors into poor ones.
"""

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol, TypeAlias, runtime_checkable

import numpy as np
from jaxtyping import Array, ArrayLike, Bool, Real

if TYPE_CHECKING:
    RealScalarLike: TypeAlias = Array | np.ndarray | float
    BoolScalarLike: TypeAlias = Array | np.ndarray
else:
    RealScalarLike: TypeAlias = Real[ArrayLike, ""]
    BoolScalarLike: TypeAlias = Bool[ArrayLike, ""]

State: TypeAlias = Sequence[Any]
Scalars: TypeAlias = tuple[RealScalarLike, ...]


@runtime_checkable
class DrawLike(Protocol):
    """What the package's own models ask of a `Draw`, which is in the study layer.

    Every method takes a `name` that labels a column of the result table, and returns a float64 scalar, or an array of
    the given `shape`.
    """

    def uniform(self, name: str, low: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Uniform on [low, high]."""
        ...

    def log_uniform(self, name: str, low: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Uniform in the logarithm on [low, high], 0 < low < high."""
        ...

    def exponential(self, name: str, mean: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Exponential with the given mean."""
        ...

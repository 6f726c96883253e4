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
class Draw(Protocol):
    """What a scenario function receives: named numbers, one method per distribution.

    Implemented in the study layer; models only need to know its shape. Every method takes a `name` that labels a column
    of the result table, and returns a float64 scalar, or an array of the given `shape`.
    """

    def parameter(self, name: str, default: RealScalarLike, *, bounds: tuple[RealScalarLike, RealScalarLike]) -> Any:
        """A named number that is fixed unless something substitutes it."""
        ...

    def uniform(self, name: str, low: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Uniform on [low, high]."""
        ...

    def log_uniform(self, name: str, low: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Uniform in the logarithm on [low, high], 0 < low < high."""
        ...

    def normal(self, name: str, mean: RealScalarLike, std: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Normal with the given mean and standard deviation."""
        ...

    def truncated_normal(
        self,
        name: str,
        mean: RealScalarLike,
        std: RealScalarLike,
        low: RealScalarLike,
        high: RealScalarLike,
        *,
        shape: tuple[int, ...] = (),
    ) -> Any:
        """Normal with the given mean and standard deviation, conditioned on [low, high]."""
        ...

    def triangular(
        self, name: str, low: RealScalarLike, mode: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()
    ) -> Any:
        """Triangular on [low, high] with its peak at `mode`."""
        ...

    def exponential(self, name: str, mean: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Exponential with the given mean."""
        ...

    def choice(self, name: str, values: Sequence[Any] | np.ndarray | Array, *, shape: tuple[int, ...] = ()) -> Any:
        """One of `values`, each equally likely."""
        ...

    def sign(self, name: str, *, shape: tuple[int, ...] = ()) -> Any:
        """-1 or +1, equally likely."""
        ...

    def record(self, name: str, value: Any) -> Any:
        """Makes a number that the scenario works out from others a column; returns it."""
        ...

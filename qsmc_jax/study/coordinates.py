"""The coordinates of one point of the unit cube, taken by named numbers in order of appearance."""

import functools as ft
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_finite, require_positive, require_shape, show
from qsmc_jax.base.module import as_float64
from qsmc_jax.study import quantiles
from qsmc_jax.study.copula import Copula
from qsmc_jax.study.specs import DrawSpec, require_fixed, require_new_name

# How nearly a coordinate must give the value that it was found for: relative to it, or to the width of the middle half.
_AGAIN = 1e-9


class AbstractCoordinates:
    """Draws numbers and keeps a record of them; lives for one call of a scenario.

    Attributes:
        recorded: The value of each name, in order of appearance.
        specs: What was found about each name; filled at the nominal point only.
        dependent: Names whose bounds depend on traced values.
        is_valid: Whether every distribution had arguments in range in this run; at the nominal point it raises instead.
        solved: The coordinates that give the values in `wanted`.
    """

    def __init__(
        self,
        point: Float[Array | np.ndarray, " dim"] | Sequence[float] | None = None,
        values: Mapping[str, Any] | None = None,
        wanted: Mapping[str, np.ndarray] | None = None,
    ):
        """Starts at the first coordinate.

        Args:
            point: A point of the unit cube, float64; None for the nominal point, every coordinate at 0.5.
            values: Numbers to use in place of what the names would get, unchecked (see `check_values`). Coordinates of
                substituted names are skipped, so that the others don't move.
            wanted: Values whose coordinates are to be found, one for every other name; without a point.
        """
        self.recorded: dict[str, Any] = {}
        self.specs: list[DrawSpec] = []
        self.dependent: set[str] = set()
        self.is_valid: Any = np.True_
        self.solved: list[float] = []
        self._point = None if point is None else as_float64(point)
        self._values = {} if values is None else values
        self._wanted = wanted
        self._used = 0
        self._copula: Copula | None = None

    def _number(self, name: str, argument: str, value: Any) -> Any:
        """An argument of a draw as float64: one finite number."""
        require_shape(f"{argument}` of `{name}", value, (), "a single number")
        number = as_float64(value)
        self._check(abs(number) < math.inf, ft.partial(require_finite, f"{argument}` of `{name}", value))
        return number

    def _positive(self, name: str, argument: str, value: Any) -> Any:
        """An argument of a draw as float64: one positive number."""
        require_shape(f"{argument}` of `{name}", value, (), "a single number")
        number = as_float64(value)
        self._check((number > 0) & (number < math.inf), ft.partial(require_positive, f"{argument}` of `{name}", value))
        return number

    def _fixed(self, name: str, argument: str, value: Any) -> float:
        """An argument of a draw that is compiled in: one positive number that depends on no other name."""
        require_fixed(f"{argument}` of `{name}", value)
        return float(self._positive(name, argument, value))

    def _interval(self, name: str, low_argument: str, low: Any, high_argument: str, high: Any) -> tuple[Any, Any]:
        """Two arguments of a draw as float64: the ends of an interval."""
        low, high = self._number(name, low_argument, low), self._number(name, high_argument, high)
        self._check(low < high, ft.partial(_require_below, name, low_argument, low, high_argument, high))
        return low, high

    def _check(self, holds: Any, complain: Callable[[], None]) -> None:
        """Raises at the nominal point, by `complain`, unless it holds; in a run, and of what is traced, takes note."""
        if self._point is None and not is_traced(holds):
            complain()
        else:
            self.is_valid = self.is_valid & holds

    def _take(
        self,
        name: str,
        kind: str,
        shape: tuple[int, ...],
        bounds: tuple[Any, Any],
        quantile: Callable[..., Any],
        *arguments: Any,
        levels: tuple[float, ...] = (),
    ) -> Any:
        """The value at the next coordinates through the inverse CDF `quantile(u, *arguments)`."""
        u = self._coordinates(name, shape, quantile, *arguments)
        value = quantiles.evaluate(quantile, u, *arguments)
        return self._keep(name, kind, value, bounds, size=math.prod(shape), levels=levels)

    def _coordinates(self, name: str, shape: tuple[int, ...], quantile: Callable[..., Any], *arguments: Any) -> Any:
        """The next coordinates, correlated with those before where a copula does so."""
        size = math.prod(shape)
        if self._wanted is not None:
            return self._found(name, shape, quantile, *arguments)
        if self._point is None:
            u = np.full(shape, 0.5)
        else:
            _require_coordinates(name, self._point, self._used + size)
            u = self._point[self._used : self._used + size].reshape(shape)
        return u if self._copula is None else self._copula.correlated(name, u)

    def _found(self, name: str, shape: tuple[int, ...], quantile: Callable[..., Any], *arguments: Any) -> np.ndarray:
        """The coordinates of what is wanted of a name; the middle of the cube for one that has its value already."""
        wanted = None if name in self._values else np.asarray((self._wanted or {})[name])
        u = np.full(shape, 0.5) if wanted is None else np.asarray(quantiles.inverse(quantile, wanted, *arguments))
        free, u = (u, u) if self._copula is None else self._copula.independent(name, u)
        self.solved += np.ravel(free).tolist()
        if wanted is not None:
            found, *quartiles = (quantiles.evaluate(quantile, each, *arguments) for each in (u, 0.25, 0.75))
            room = _AGAIN * np.maximum(abs(wanted), abs(quartiles[1] - quartiles[0]))
            require(
                bool(np.all(abs(found - wanted) <= room)),
                f"Value {wanted.tolist()} of `{name}` must be one that can be drawn, to nine digits, but nearest is "
                f"{np.asarray(found).tolist()}.",
            )
        return u

    def _keep(
        self, name: str, kind: str, value: Any, bounds: tuple[Any, Any], *, size: int, levels: tuple[float, ...] = ()
    ) -> Any:
        """Records the value, or what is substituted for it, and passes over its coordinates."""
        require_new_name(name, self.recorded)
        value = _scalar(self._values.get(name, value))
        self.recorded[name] = value
        if is_traced(bounds):
            self.dependent.add(name)
        if self._point is None:
            low, high = map(float, bounds)
            flat = tuple(np.ravel(value).tolist())
            self.specs.append(DrawSpec(name, kind, np.shape(value), (low, high), self._used, size, flat, levels))
        self._used += size
        return value


def _scalar(value: Any) -> Any:
    """NumPy float64 (a scalar rather than an array without axes), or the tracer."""
    return value if is_traced(value) else np.asarray(value, dtype=np.float64)[()]


def _require_below(name: str, low_argument: str, low: Any, high_argument: str, high: Any) -> None:
    """Raises unless the ends of an interval are in order."""
    require(
        bool(low < high),
        f"Argument `{low_argument}` of `{name}` must be below `{high_argument}`, but is {show(low)} "
        f"(`{high_argument}` is {show(high)}).",
    )


def _require_coordinates(name: str, point: Any, needed: int) -> None:
    """Raises if the point has too few coordinates."""
    require(
        needed <= point.shape[0],
        f"Argument `point` must have at least {needed} coordinates when `{name}` is drawn, but has {point.shape[0]}. "
        "A scenario must draw the same names, in the same order and of the same shapes, in every run.",
    )

"""Named numbers of a scenario: a pure function from the unit cube.

A scenario is a plain function `scenario(draw)`. Each distribution takes its coordinates of the unit cube, in order of
appearance, through its inverse CDF; a parameter takes none. So every kind of study is a choice of a point and of the
names to substitute, and any run can be done again from these two.
"""

import dataclasses
import functools as ft
import math
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, nearest, require, require_finite, require_positive, require_shape, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.names import require_name
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.claims import require_no_claim
from qsmc_jax.metrics.standard import FIELDS, catalogue
from qsmc_jax.study import quantiles
from qsmc_jax.tracing.traceable import traceable

# Standard deviations from the mean to an interval, beyond which the probability of the interval underflows.
_REACH = 37.0

# Kind of a name that is worked out from others.
RECORDED = "record"
# Columns that every table of runs has, and names by which metrics are told.
TABLE_COLUMNS = frozenset({"index", "tier", *catalogue(), *FIELDS})


@dataclasses.dataclass(frozen=True)
class DrawSpec:
    """What is known of one name before any run.

    Attributes:
        name: The name, label of its columns.
        kind: The method that drew it, such as "uniform" or "parameter"; "record" for what is worked out from others.
        shape: Shape of its value.
        bounds: Smallest and largest value; infinite where there is none, or where it depends on other names.
        start: Its first coordinate of the unit cube.
        size: How many coordinates it takes; 0 for a parameter, and for what is recorded.
        flat_nominal: Entries of `nominal`, in C order.
        levels: The values it can take when these are finitely many, else empty.
    """

    name: str
    kind: str
    shape: tuple[int, ...]
    bounds: tuple[float, float]
    start: int
    size: int
    flat_nominal: tuple[float, ...]
    levels: tuple[float, ...] = ()

    @property
    def nominal(self) -> np.ndarray:
        """A parameter's default; the median of a distribution."""
        return np.array(self.flat_nominal).reshape(self.shape)

    @property
    def columns(self) -> tuple[str, ...]:
        """Column names, one an entry in C order: `name`, `name[0]` or `name[0,1]`."""
        if not self.shape:
            return (self.name,)
        return tuple(f"{self.name}[{','.join(map(str, index))}]" for index in np.ndindex(self.shape))


class PointDraw:
    """Draws the numbers that belong to one point of the unit cube; implements `Draw`.

    Lives for one call of a scenario and keeps a record of it.

    Attributes:
        recorded: The value of each name, in order of appearance.
        specs: What was found about each name; filled at the nominal point only.
        dependent: Names whose bounds depend on traced values.
        is_valid: Whether every distribution had arguments in range in this run; at the nominal point it raises instead.
    """

    def __init__(self, point: Float[Array | np.ndarray, " dim"] | None = None, values: Mapping[str, Any] | None = None):
        """Starts at the first coordinate.

        Args:
            point: A point of the unit cube, float64; None for the nominal point, every coordinate at 0.5.
            values: Numbers to use in place of what the names would get, unchecked (see `check_values`). Coordinates of
                substituted names are skipped, so that the others don't move.
        """
        self.recorded: dict[str, Any] = {}
        self.specs: list[DrawSpec] = []
        self.dependent: set[str] = set()
        self.is_valid: Any = np.True_
        self._point = point
        self._values = {} if values is None else values
        self._used = 0

    def parameter(self, name: str, default: RealScalarLike, *, bounds: tuple[RealScalarLike, RealScalarLike]) -> Any:
        """A named number that is fixed at `default` unless something substitutes it; takes no coordinate."""
        low, high = self._interval(name, "bounds[0]", bounds[0], "bounds[1]", bounds[1])
        require(
            not is_traced(default),
            f"Argument `default` of `{name}` must be a fixed number, but depends on other names of the scenario.",
        )
        default = self._number(name, "default", default)
        value = self._values.get(name, default)
        # A value that is data was compared with fixed bounds before the run.
        if is_traced(low, high) or not is_traced(value):
            inside = ft.partial(_require_inside, f"default` of `{name}", default, (low, high))
            self._check((low <= value) & (value <= high), inside)
        return self._keep(name, "parameter", default, (low, high), size=0)

    def uniform(self, name: str, low: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Uniform on [low, high]."""
        low, high = self._interval(name, "low", low, "high", high)
        return self._take(name, "uniform", shape, (low, high), quantiles.uniform, low, high)

    def log_uniform(self, name: str, low: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Uniform in the logarithm on [low, high], 0 < low < high."""
        low, high = self._interval(name, "low", self._positive(name, "low", low), "high", high)
        return self._take(name, "log_uniform", shape, (low, high), quantiles.log_uniform, low, high)

    def normal(self, name: str, mean: RealScalarLike, std: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Normal with the given mean and standard deviation."""
        mean, std = self._number(name, "mean", mean), self._positive(name, "std", std)
        return self._take(name, "normal", shape, (-math.inf, math.inf), quantiles.normal, mean, std)

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
        """Normal with the given mean and standard deviation (before the cut), conditioned on [low, high].

        For one side only, put the other 40 standard deviations away.
        """
        mean, std = self._number(name, "mean", mean), self._positive(name, "std", std)
        low, high = self._interval(name, "low", low, "high", high)
        reach = _REACH * std
        self._check(
            (low - mean <= reach) & (mean - high <= reach), ft.partial(_require_mass, name, mean, std, low, high)
        )
        return self._take(
            name, "truncated_normal", shape, (low, high), quantiles.truncated_normal, mean, std, low, high
        )

    def triangular(
        self, name: str, low: RealScalarLike, mode: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()
    ) -> Any:
        """Triangular on [low, high] with its peak at `mode`, low <= mode <= high."""
        low, high = self._interval(name, "low", low, "high", high)
        mode = self._number(name, "mode", mode)
        self._check((low <= mode) & (mode <= high), ft.partial(_require_inside, f"mode` of `{name}", mode, (low, high)))
        return self._take(name, "triangular", shape, (low, high), quantiles.triangular, low, mode, high)

    def exponential(self, name: str, mean: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Exponential with the given mean."""
        mean = self._positive(name, "mean", mean)
        return self._take(name, "exponential", shape, (0.0, math.inf), quantiles.exponential, mean)

    def choice(self, name: str, values: Sequence[Any] | np.ndarray | Array, *, shape: tuple[int, ...] = ()) -> Any:
        """One of `values`, each equally likely."""
        array = as_float64(values)
        require(
            array.ndim == 1 and array.size > 0,
            f"Argument `values` of `{name}` must be a list of at least one number, but has shape {array.shape}.",
        )
        self._check((abs(array) < math.inf).all(), ft.partial(require_finite, f"values` of `{name}", array))
        levels = () if is_traced(array) else tuple(array.tolist())
        return self._take(name, "choice", shape, (array.min(), array.max()), quantiles.choice, array, levels=levels)

    def sign(self, name: str, *, shape: tuple[int, ...] = ()) -> Any:
        """-1 or +1, equally likely."""
        levels = (-1.0, 1.0)
        return self._take(name, "sign", shape, levels, quantiles.choice, np.array(levels), levels=levels)

    def record(self, name: str, value: Any) -> Any:
        """Makes a number that the scenario works out from others a column; returns it."""
        return self._keep(name, RECORDED, as_float64(value), (-math.inf, math.inf), size=0)

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
        size = math.prod(shape)
        if self._point is None:
            u = np.full(shape, 0.5)
        else:
            _require_coordinates(name, self._point, self._used + size)
            u = self._point[self._used : self._used + size].reshape(shape)
        return self._keep(name, kind, quantiles.evaluate(quantile, u, *arguments), bounds, size=size, levels=levels)

    def _keep(
        self, name: str, kind: str, value: Any, bounds: tuple[Any, Any], *, size: int, levels: tuple[float, ...] = ()
    ) -> Any:
        """Records the value, or what is substituted for it, and passes over its coordinates."""
        _require_new_name(name, self.recorded)
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


def discover(scenario: Callable[[Any], Any]) -> tuple[tuple[DrawSpec, ...], Any]:
    """Finds the names of a scenario.

    It is called once with NumPy numbers, at the nominal point (parameters at their defaults, distributions at their
    medians), and once traced, to see which bounds depend on other names.

    Args:
        scenario: A function of a `Draw`, traceable by JAX; which names it draws must not depend on their values.

    Returns:
        The names in order of appearance, and what the scenario returned at the nominal point.
    """
    with in_64_bits():
        draw = PointDraw()
        result = scenario(draw)
        with traceable("Argument `scenario`", "the numbers it draws"):
            dependent = _dependent_names(scenario, draw.specs)
    loose = {"bounds": (-math.inf, math.inf), "levels": ()}
    return tuple(dataclasses.replace(s, **loose) if s.name in dependent else s for s in draw.specs), result


def dimension(specs: Sequence[DrawSpec]) -> int:
    """How many coordinates of the unit cube the names take together."""
    return sum(spec.size for spec in specs)


def check_values(specs: Sequence[DrawSpec], values: Mapping[str, Any]) -> dict[str, Any]:
    """Checks numbers that are to be substituted by name.

    Args:
        specs: The names of the study, from `discover`.
        values: A number for each name to substitute, or an array of the name's shape.

    Returns:
        The same as NumPy float64 arrays; tracers pass through.

    Raises:
        InputError: A name does not exist, or a value is not finite, has the wrong shape, or lies outside the bounds.
    """
    by_name = {spec.name: spec for spec in specs}
    for name in values:
        if name not in by_name:
            raise InputError(_unknown_name(name, list(by_name)))
        require(
            by_name[name].kind != RECORDED,
            f"Name `{name}` can't be given a value: the scenario works it out from others and records it.",
        )
    return {name: _checked_value(by_name[name], value) for name, value in values.items()}


def _checked_value(spec: DrawSpec, value: Any) -> Any:
    """One substituted value as float64, of the shape and within the bounds of its name."""
    try:
        array = as_float64(value)
    except (TypeError, ValueError):
        raise InputError(f"Argument `{spec.name}` must be a number or an array, but is {value!r}.") from None
    require_shape(spec.name, array, spec.shape, "as drawn in the scenario")
    if is_traced(array):
        return array
    require_finite(spec.name, array)
    if spec.levels:
        allowed = ", ".join(map(show, spec.levels))
        found = bool(np.all(np.isin(array, spec.levels)))
        require(found, f"Argument `{spec.name}` must be one of {allowed}, but is {show(array)}.")
    _require_inside(spec.name, array, spec.bounds, "Choose a value inside, or widen the bounds in the scenario.")
    return array


def _unknown_name(name: str, names: list[str]) -> str:
    """The message for a name that does not exist, with the nearest that does."""
    listed = ", ".join(f"`{n}`" for n in names) or "none"
    return f"There is no name `{name}` in this study.{nearest(name, names)} It has: {listed}."


def _dependent_names(scenario: Callable[[Any], Any], specs: Sequence[DrawSpec]) -> set[str]:
    """Names whose bounds depend on the values of others: what a traced call finds traced."""
    draws = []

    def trace(point: Array, values: dict[str, Array]) -> None:
        draws.append(PointDraw(point, values))
        scenario(draws[-1])

    point = jax.ShapeDtypeStruct((dimension(specs),), np.float64)
    values = {s.name: jax.ShapeDtypeStruct((), np.float64) for s in specs if s.kind == "parameter"}
    jax.eval_shape(trace, point, values)
    return draws[0].dependent


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


def _require_inside(name: str, value: Any, bounds: tuple[Any, Any], advice: str = "") -> None:
    """Raises unless every entry of `value` lies in the closed interval."""
    low, high = bounds
    message = f"Argument `{name}` must lie in [{show(low)}, {show(high)}], but is {show(value)}. {advice}"
    require(bool(np.all((low <= value) & (value <= high))), message.rstrip())


def _require_mass(name: str, mean: Any, std: Any, low: Any, high: Any) -> None:
    """Raises if the interval is so far out in a tail that its probability underflows."""
    distance = max(low - mean, mean - high) / std
    require(
        bool(distance <= _REACH),
        f"Argument `mean` of `{name}` must be within {_REACH:g} standard deviations of [low, high], but is "
        f"{distance:.6g} away. Use another distribution.",
    )


def _require_coordinates(name: str, point: Any, needed: int) -> None:
    """Raises if the point has too few coordinates."""
    require(
        needed <= point.shape[0],
        f"Argument `point` must have at least {needed} coordinates when `{name}` is drawn, but has {point.shape[0]}. "
        "A scenario must draw the same names, in the same order and of the same shapes, in every run.",
    )


def _require_new_name(name: Any, taken: Mapping[str, Any]) -> None:
    """Raises unless `name` is a string that was not drawn before, and can name a column and stand on a command line."""
    require_name(name)
    require(name not in taken, f"Argument `name` must be new in the scenario, but is `{name}` a second time.")
    require(
        name not in TABLE_COLUMNS,
        f"Argument `name` must not be that of a column which every table has, but is `{name}`. Choose another.",
    )
    require_no_claim(name)

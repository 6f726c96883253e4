"""What is known of the names of a scenario before any run, and checks of names and of values given by name."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from qsmc_jax.base.checks import is_traced, nearest, require, require_finite, require_shape, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.names import require_name
from qsmc_jax.metrics.claims import require_no_claim
from qsmc_jax.metrics.standard import FIELDS, catalogue

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
    def is_drawn(self) -> bool:
        """Whether it takes coordinates."""
        return self.size > 0

    @property
    def columns(self) -> tuple[str, ...]:
        """Column names, one an entry in C order: `name`, `name[0]` or `name[0,1]`."""
        if not self.shape:
            return (self.name,)
        return tuple(f"{self.name}[{','.join(map(str, index))}]" for index in np.ndindex(self.shape))


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
    require_inside(spec.name, array, spec.bounds, "Choose a value inside, or widen the bounds in the scenario.")
    return array


def _unknown_name(name: str, names: list[str]) -> str:
    """The message for a name that does not exist, with the nearest that does."""
    listed = ", ".join(f"`{n}`" for n in names) or "none"
    return f"There is no name `{name}` in this study.{nearest(name, names)} It has: {listed}."


def require_inside(name: str, value: Any, bounds: tuple[Any, Any], advice: str = "") -> None:
    """Raises unless every entry of `value` lies in the closed interval."""
    low, high = bounds
    message = f"Argument `{name}` must lie in [{show(low)}, {show(high)}], but is {show(value)}. {advice}"
    require(bool(np.all((low <= value) & (value <= high))), message.rstrip())


def require_new_name(name: Any, taken: Mapping[str, Any]) -> None:
    """Raises unless `name` is a string that was not drawn before, and can name a column and stand on a command line."""
    require_name(name)
    require(name not in taken, f"Argument `name` must be new in the scenario, but is `{name}` a second time.")
    require(
        name not in TABLE_COLUMNS,
        f"Argument `name` must not be that of a column which every table has, but is `{name}`. Choose another.",
    )
    require_no_claim(name)


def require_fixed(argument: str, value: Any) -> None:
    """Raises if an argument depends on other names."""
    require(
        not is_traced(value),
        f"Argument `{argument}` must be fixed, but depends on other names of the scenario.",
    )

"""The record of a metric: declared once, where the metric is, and read everywhere else."""

import dataclasses
import inspect
import re
from typing import TYPE_CHECKING, Any, Literal, TypeAlias, TypeVar

import equinox as eqx

Phase: TypeAlias = Literal["whole", "steady"]
Loops: TypeAlias = Literal["all", "sampled", "several", "own"]
Worse: TypeAlias = Literal["high", "low"]

_C = TypeVar("_C", bound=type)

_KEY = "metric"
_INDEX = re.compile(r"\[\d+\]$")


@dataclasses.dataclass(frozen=True)
class Record:
    """A metric of a run, as tables, files, pictures, objectives and documentation have it.

    Attributes:
        name: Its column; of one for each derivative of the error, the column without `[i]`.
        meaning: What it is, in a sentence.
        unit: Its unit, "-" for a pure number; empty where it is that of the input, the error or the sliding variable.
        label: How an axis is labelled, without the unit.
        phase: "whole" if it is about the whole run, "steady" if about t >= t_r.
        loops: "all", or "sampled" if only loops with an implementation have it; of ideal loops "several" if only those
            with several inputs have it, "own" if only those of plants in their own coordinates.
        worse: Which direction is worse, "high" or "low"; None if neither is.
        has_gradient: Whether it has a derivative by the gains.
        is_compared: Whether comparisons show it unless told otherwise.
        may_jump: Whether it jumps where a run changes a little, say from one peak to another as high.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.metrics.Record("lateral", "sup |y|", unit="m", label="lateral error").axis
        'lateral error [m]'
    """

    name: str
    meaning: str = ""
    unit: str = ""
    label: str = ""
    phase: Phase = "whole"
    loops: Loops = "all"
    worse: Worse | None = None
    has_gradient: bool = False
    is_compared: bool = False
    may_jump: bool = False

    @property
    def attributes(self) -> dict[str, str]:
        """The unit, as xarray has it; nothing where there is none."""
        return {"units": self.unit} if self.unit else {}

    @property
    def axis(self) -> str:
        """The label with the unit."""
        return f"{self.label or self.name} [{self.unit}]" if self.unit else self.label or self.name


if TYPE_CHECKING:
    from equinox import field as metric  # the only name by which type checkers know a field of an `eqx.Module`
else:

    def metric(*, default: Any = dataclasses.MISSING, **about: Any) -> Any:
        """A dataclass field that holds a metric.

        Args:
            default: What it is where a loop has no such metric; none for what every loop has.
            **about: What a `Record` is made of, but for the name, which is the field's, unless another is given.
        """
        return eqx.field(default=default, metadata={_KEY: about})


def records_of(cls: type) -> dict[str, Record]:
    """The records of a class's metrics, by the names of their fields.

    Args:
        cls: A dataclass, some of whose fields were declared by `metric`.
    """
    fields = {field.name: field.metadata[_KEY] for field in dataclasses.fields(cls) if _KEY in field.metadata}
    return {name: Record(**{"name": name, **about}) for name, about in fields.items()}


def explained(cls: _C) -> _C:
    """The class, with its records as the section "Attributes" of its docstring."""
    if cls.__doc__ is not None:  # as by `python -OO`
        before, heading, after = inspect.cleandoc(cls.__doc__).partition("Attributes:\n")
        lines = (f"    {name}: {told(record)}\n" for name, record in records_of(cls).items())
        cls.__doc__ = f"{before}{heading or f'{chr(10)}{chr(10)}Attributes:{chr(10)}'}{''.join(lines)}{after}"
    return cls


def told(record: Record) -> str:
    """The meaning of a metric, with its unit."""
    return f"{record.meaning} [{record.unit}]." if record.unit else f"{record.meaning}."


def without_index(column: str) -> str:
    """The name of a column without the index at its end: `peak_error` of `peak_error[0]`."""
    return _INDEX.sub("", column)

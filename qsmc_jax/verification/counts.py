"""Runs counted by their verdict on a claim, and the interval of the probability that it is violated."""

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import numpy as np

from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.statistics.intervals import clopper_pearson

_C = TypeVar("_C", bound="Counts")

# What stands above `Counts.row`.
HEADING = f"{'held':>9}{'violated':>10}{'undecided':>11}{'inadmissible':>14}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Counts:
    """Runs by their verdict on a claim: whole numbers, or arrays of them with an entry a cell of a grid.

    Attributes:
        held: Runs in which it held.
        violated: Runs in which it did not.
        undecided: Runs that could not be decided; counted both ways in the interval.
        inadmissible: Runs in which a premise does not hold; not counted in the interval.
        low: Lower end of the interval of the violation probability.
        high: Upper end.
    """

    held: Any
    violated: Any
    undecided: Any
    inadmissible: Any
    low: Any
    high: Any

    @classmethod
    def of(
        cls: type[_C],
        counts: Mapping[Verdict, Any],
        confidence: float,
        interval: Callable[..., tuple[Any, Any]] = clopper_pearson,
        **others: Any,
    ) -> _C:
        """Those of some counts, with their interval.

        Args:
            counts: Runs with each verdict.
            confidence: Confidence of the interval.
            interval: `interval(violated, undecided, total, confidence)`.
            **others: What else it is made of.
        """
        named = {verdict.name.lower(): counts[verdict] for verdict in Verdict}
        total = named["held"] + named["violated"] + named["undecided"]
        low, high = interval(named["violated"], named["undecided"], total, confidence)
        return cls(**{**named, "low": low, "high": high, **others})

    @property
    def total(self) -> Any:
        """Admissible runs."""
        return self.held + self.violated + self.undecided

    @property
    def estimate(self) -> Any:
        """Violated runs over admissible ones; NaN where there are none."""
        total = np.asarray(self.total)
        share = np.where(total > 0, self.violated / np.maximum(total, 1), np.nan)
        return share if share.ndim else share.item()

    def row(self, cell: Any = ()) -> str:
        """The counts and the interval as a line of a table.

        Args:
            cell: Which cell of the grid.
        """
        held, violated, undecided, inadmissible, low, high = (
            np.asarray(getattr(self, field.name))[cell] for field in dataclasses.fields(Counts)
        )
        return f"{held:9d}{violated:10d}{undecided:11d}{inadmissible:14d}   [{low:.3g}, {high:.3g}]"

"""What verification keeps of a stream of runs: counts, the worst runs, histograms, however many runs there are."""

import dataclasses
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from qsmc_jax.metrics.claims import TOGETHER, headline, is_requirement, margin_column, together, verdict_column
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.study.runs import Runs, concatenate, count_verdicts

_BINS = 60


@dataclasses.dataclass
class Histogram:
    """Counts over fixed bins; values beyond the ends are counted in the first or last.

    Attributes:
        edges: Edges of the bins.
        counts: Runs in each.
    """

    edges: np.ndarray
    counts: np.ndarray

    @classmethod
    def over(cls, low: float, high: float) -> "Histogram":
        """Empty, with 60 bins from `low` to `high`."""
        return cls(np.linspace(low, high, _BINS + 1), np.zeros(_BINS, np.int64))

    def add(self, values: np.ndarray) -> None:
        """Counts the values that are not NaN."""
        known = np.clip(values[~np.isnan(values)], self.edges[0], self.edges[-1])
        self.counts += np.histogram(known, self.edges)[0]

    def quantile(self, fraction: float) -> float:
        """The value below which the given fraction of the runs lies, to the width of a bin; NaN if there are none."""
        cumulative = np.cumsum(self.counts)
        if not cumulative[-1]:
            return float("nan")
        return float(self.edges[1 + np.searchsorted(cumulative, fraction * cumulative[-1])])


@dataclasses.dataclass
class Range:
    """What a metric was in the runs in which it is known, infinite ones included.

    Attributes:
        record: What is known of the metric.
        runs: How many they are.
        total: Its sum over them.
        least: The smallest, and the first run that had it.
        largest: The largest, and the first run that had it.
    """

    record: Record
    runs: int = 0
    total: float = 0.0
    least: tuple[float, int] = (np.inf, 0)
    largest: tuple[float, int] = (-np.inf, 0)

    def add(self, values: np.ndarray, index: np.ndarray) -> None:
        """Takes values in that are not NaN."""
        known = ~np.isnan(values)
        if not known.any():
            return
        values, index = values[known], index[known]
        low, high = np.lexsort((index, values))[0], np.lexsort((index, -values))[0]
        least, largest = (float(values[low]), int(index[low])), (float(values[high]), int(index[high]))
        self.least = min(self.least, least) if self.runs else least
        self.largest = max(self.largest, largest, key=lambda each: (each[0], -each[1])) if self.runs else largest
        self.runs, self.total = self.runs + len(values), self.total + float(values.sum())

    @property
    def mean(self) -> float:
        """The mean; NaN if there are none."""
        return self.total / self.runs if self.runs else float("nan")

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts."""
        about = {"name": self.record.name, "unit": self.record.unit, "runs": self.runs, "mean": self.mean}
        ends = {"least": self.least, "largest": self.largest} if self.runs else {}
        return {
            **about,
            **{f"{end}{part}": each[i] for end, each in ends.items() for i, part in enumerate(("", "_run"))},
        }

    def __str__(self) -> str:
        name, unit = self.record.name, f" {self.record.unit}" if self.record.unit else ""
        if not self.runs:
            return f"{name}: known in no run"
        (least, least_run), (largest, largest_run) = self.least, self.largest
        ends = f"{least:.6g} (run {least_run}) to {largest:.6g}{unit} (run {largest_run})"
        return f"{name}: {ends}, mean {self.mean:.6g}{unit}, in {self.runs} runs"


class Summary:
    """Takes tables in any order.

    Attributes:
        counts: Runs with each verdict, by claim, and of all claims together.
        headline: Those of them that the conclusion and stopping rules are about.
        worst: The worst rows so far, as at most one table.
        margin: Histogram of 1 - sup |sigma|/rho.
        reach: Histogram of the reach time [s].
        steps: Solver steps of all runs together.
        peak_u: Largest sup |u| of any run that held.
        ranges: What the study's own metrics were.
    """

    def __init__(self, worst: int, longest_reach: float, claims: Iterable[str], records: Iterable[Record] = ()):
        """Empty.

        Args:
            worst: How many of the worst rows to keep.
            longest_reach: End of the histogram of reach times [s].
            claims: The claims of the study.
            records: What is known of the study's own metrics and margins.
        """
        self.ranges = tuple(map(Range, records))
        claims = tuple(claims)
        self.counts = {claim: dict.fromkeys(Verdict, 0) for claim in (*claims, TOGETHER)}
        self.headline = self.counts[headline(claims)]
        self.worst: list[Runs] = []
        self.margin = Histogram.over(0.0, 1.0)
        self.reach = Histogram.over(0.0, longest_reach)
        self.steps = 0
        self.peak_u = 0.0
        self._keep = worst

    def add(self, table: Runs) -> None:
        """Takes a table in."""
        for claim, counts in self.counts.items():
            each = together(table.verdicts) if claim == TOGETHER else table[verdict_column(claim)]
            for verdict, count in count_verdicts(each).items():
                counts[verdict] += count
        self.margin.add(table["margin"])
        self.reach.add(table["reach_time"])
        self.steps += int(table["steps"].sum())
        for each in self.ranges:
            each.add(table[each.record.name], table["index"])
        held = table["peak_u"][table["verdict"] == Verdict.HELD]
        self.peak_u = max(self.peak_u, held.max(initial=0.0))
        self.worst = [worst_of([*self.worst, table], self._keep)]


def worst_of(tables: Sequence[Runs], count: int, claim: str | None = None) -> Runs:
    """The worst rows of some tables, so many at most, the worst first."""
    candidates = concatenate(tables)
    return candidates.take(worst_first(candidates, claim)[:count])


def worst_first(table: Runs, claim: str | None = None) -> np.ndarray:
    """Row numbers: VIOLATED, UNDECIDED, HELD by rising margin, INADMISSIBLE; of equals the lower index first.

    Args:
        table: The rows.
        claim: The claim; None for the funnel first, and of equals the requirements.
    """
    own = [each for each in table.claims if is_requirement(each)] if claim is None else []
    margin = table[margin_column(claim or "funnel")]
    # What has no margin, since it was not followed to the end, is as bad as its verdict.
    keys = [table["index"], np.where(np.isnan(margin), 0.0, margin)]
    if own:
        keys.append(_rank(together(np.array([table[verdict_column(each)] for each in own]))))
    keys.append(_rank(table[verdict_column(claim or "funnel")]))
    return np.lexsort(keys)


def _rank(verdicts: np.ndarray) -> np.ndarray:
    order = (Verdict.VIOLATED, Verdict.UNDECIDED, Verdict.HELD)
    return np.select([verdicts == verdict for verdict in order], range(3), 3)

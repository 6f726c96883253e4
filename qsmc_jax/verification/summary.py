"""What verification keeps of a stream of runs: counts, the worst runs, histograms, however many runs there are."""

import dataclasses
from collections.abc import Sequence

import numpy as np

from qsmc_jax.simulation.outcome import Verdict
from qsmc_jax.study.runs import CLAIMS, Runs, concatenate

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


class Summary:
    """Takes tables in any order.

    Attributes:
        counts: Runs with each verdict, by claim.
        worst: The worst rows so far, as at most one table.
        margin: Histogram of 1 - sup |sigma|/rho.
        reach: Histogram of the reach time [s].
        steps: Solver steps of all runs together.
        peak_u: Largest sup |u| of any run that held.
    """

    def __init__(self, worst: int, longest_reach: float):
        """Empty.

        Args:
            worst: How many of the worst rows to keep.
            longest_reach: End of the histogram of reach times [s].
        """
        self.counts = {claim: dict.fromkeys(Verdict, 0) for claim in CLAIMS}
        self.worst: list[Runs] = []
        self.margin = Histogram.over(0.0, 1.0)
        self.reach = Histogram.over(0.0, longest_reach)
        self.steps = 0
        self.peak_u = 0.0
        self._keep = worst

    def add(self, table: Runs) -> None:
        """Takes a table in."""
        for claim in CLAIMS:
            for verdict, count in table.counts(claim).items():
                self.counts[claim][verdict] += count
        self.margin.add(table["margin"])
        self.reach.add(table["reach_time"])
        self.steps += int(table["steps"].sum())
        held = table["peak_u"][table["verdict"] == Verdict.HELD]
        self.peak_u = max(self.peak_u, held.max(initial=0.0))
        self.worst = [worst_of([*self.worst, table], self._keep)]


def worst_of(tables: Sequence[Runs], count: int) -> Runs:
    """The worst rows of some tables, so many at most, the worst first."""
    candidates = concatenate(tables)
    return candidates.take(worst_first(candidates)[:count])


def worst_first(table: Runs) -> np.ndarray:
    """Row numbers: VIOLATED, UNDECIDED, HELD by rising margin, INADMISSIBLE; of equals the lower index first."""
    order = (Verdict.VIOLATED, Verdict.UNDECIDED, Verdict.HELD)
    rank = np.select([table["verdict"] == verdict for verdict in order], range(3), 3)
    return np.lexsort((table["index"], np.nan_to_num(table["margin"]), rank))

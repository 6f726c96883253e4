"""The escalation ladder: no violated or undecided run is believed at the first solve, and none is dropped."""

from collections.abc import Callable, Iterator

import numpy as np

from qsmc_jax.simulation.outcome import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.lanes import LANE_MULTIPLE
from qsmc_jax.study.runs import CLAIMS, Runs, concatenate, replace_rows

# By how much `peak_u` may exceed its bound before it counts as a breach: what solving and interpolating at the default
# tolerance explain, and no more.
_BREACH_RTOL, _BREACH_ATOL = 1e-2, 1e-6


class Ladder:
    """Solves doubtful runs again, on ever firmer rungs, until one decides them.

    Rung 0 is the solve of the study. Rung 1 has a hundredth of its tolerance and rung 2 an implicit method for stiff
    loops. An UNDECIDED run climbs until a rung decides it; a VIOLATED one needs a second rung to agree; a peak above
    what the comparison lemma allows is doubtful too, and on the last rung a defect of the simulator.

    Attributes:
        climbed: How many runs were solved on rung 1, 2.
        defects: Indices of runs whose peak stayed above the bound; they are UNDECIDED.
    """

    def __init__(self, solve: Callable[..., Iterator[Runs]], settings: SolverSettings, block: int):
        """At the foot of the ladder.

        Args:
            solve: `stream` of the study, to be called with indices, `settings` and `block`.
            settings: Settings of rung 0.
            block: Rows to wait for before they are solved again together.
        """
        self.climbed = [0, 0]
        self.defects: list[int] = []
        self._solve, self._block = solve, block
        self._rungs = ({"settings": firmer(settings)}, {"settings": stiff(settings), "block": LANE_MULTIPLE})
        self._waiting: list[Runs] = []

    def feed(self, table: Runs) -> Iterator[Runs]:
        """Yields the rows that need no second look, and whatever has been decided meanwhile, in no particular order."""
        doubtful = is_doubtful(table)
        if not doubtful.all():
            yield table.take(~doubtful)
        if doubtful.any():
            self._waiting.append(table.take(doubtful))
        if sum(map(len, self._waiting)) >= self._block:
            yield from self.finish()

    def finish(self) -> Iterator[Runs]:
        """Decides the rows still waiting, as far as the ladder can, and yields them."""
        if self._waiting:
            table = concatenate(self._waiting)
            self._waiting = []
            yield self._climb(table)

    def _climb(self, table: Runs) -> Runs:
        previous = table["verdict"].copy()
        open_rows = np.arange(len(table))
        for rung, options in enumerate(self._rungs):
            if not len(open_rows):
                break
            self.climbed[rung] += len(open_rows)
            again = concatenate(list(self._solve(table["index"][open_rows], **options)))
            table = replace_rows(table, open_rows, again)
            is_confirmed = (again["verdict"] == Verdict.VIOLATED) & (previous[open_rows] == Verdict.VIOLATED)
            previous[open_rows] = again["verdict"]
            open_rows = open_rows[is_doubtful(again) & ~is_confirmed]
        return self._mark_defects(table)

    def _mark_defects(self, table: Runs) -> Runs:
        rows = np.flatnonzero(breaches_bound(table))
        self.defects.extend(table["index"][rows].tolist())
        columns = {name: table[name].copy() for name in table}
        for claim in CLAIMS:
            columns[claim][rows] = int(Verdict.UNDECIDED)
        return Runs(columns, table.names)


def firmer(settings: SolverSettings) -> SolverSettings:
    """The same method at a hundredth of the tolerance."""
    return settings.replace(rtol=settings.rtol / 100.0, atol=settings.atol / 100.0)


def stiff(settings: SolverSettings) -> SolverSettings:
    """The implicit method in the funnel coordinate, with ten times as many steps to spend."""
    return settings.replace(max_steps=10 * settings.max_steps, method="rodas5p", coordinates="funnel")


def is_doubtful(table: Runs) -> np.ndarray:
    """Rows whose funnel verdict is not yet to be believed."""
    verdict = table["verdict"]
    return (verdict == Verdict.VIOLATED) | (verdict == Verdict.UNDECIDED) | breaches_bound(table)


def breaches_bound(table: Runs) -> np.ndarray:
    """Rows that HELD with a higher peak than the comparison lemma allows, where its premise on g holds."""
    allowed = table["peak_u_bound"] * (1.0 + _BREACH_RTOL) + _BREACH_ATOL
    return (table["verdict"] == Verdict.HELD) & (table["least_gain"] > 0.0) & (table["peak_u"] > allowed)

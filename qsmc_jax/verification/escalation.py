"""Escalation: no violated or undecided run is believed at the first solve, none is dropped, none outvoted."""

import dataclasses
import logging
from collections.abc import Callable, Iterator, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from qsmc_jax.metrics.claims import is_requirement, margin_column, verdict_column
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.study.runs import Runs, concatenate, replace_rows
from qsmc_jax.verification.tiers import TIERS, Tiers

_LOG = logging.getLogger(__name__)

# By how much `peak_u` may exceed its bound before it counts as a breach: what solving and interpolating at the default
# tolerance explain, and no more.
_BREACH_RTOL, _BREACH_ATOL = 1e-2, 1e-6

# Tiers that must say it: a run that HELD is one in which nothing was found, by as many solves as nobody doubts.
_VOICES = {Verdict.HELD: 1, Verdict.VIOLATED: 2, Verdict.INADMISSIBLE: 1}

# Metrics of a run that are facts of any solve, whatever another one says.
_FACTS = ("end_time", "least_gain", "largest_disturbance")


class Escalation:
    """Solves doubtful runs again, on up to two firmer tiers, until they agree.

    A run is VIOLATED if two tiers say so and none that it HELD. Once two tiers disagree, it is decided only by two that
    share no method (in a sampled loop: no cells) and agree, tier 2 being one of them; else it is UNDECIDED. An
    UNDECIDED run is solved on until a tier decides it. A peak above what the comparison lemma allows says nothing, and
    on the last tier is a defect of the simulator. Each claim is decided so on its own, all of them only where the
    funnel claim is.

    The rows get a column `tier`: the last solve that agrees with what was decided, whose metrics they carry.

    Attributes:
        escalated: How many runs were solved on tier 1, 2.
        defects: Indices of runs whose peak stayed above the bound; they are UNDECIDED.
    """

    def __init__(self, solve: Callable[..., Iterator[Runs]], tiers: Tiers, block: int):
        """Nothing solved yet.

        Args:
            solve: `stream` of the study, to be called with indices, `settings` and `block`.
            tiers: Settings of each tier.
            block: Rows to wait for before they are solved again together.
        """
        self.escalated = [0, 0]
        self.defects: list[int] = []
        self._solve, self._tiers, self._block = solve, tiers, block
        self._waiting: list[Runs] = []

    def feed(self, table: Runs) -> Iterator[Runs]:
        """Yields the rows that need no second look, and whatever has been decided meanwhile, in no particular order."""
        doubtful = is_open([said(table)], is_near([table]))
        if not doubtful.all():
            yield _with(table.take(~doubtful), tier=np.zeros(int((~doubtful).sum()), np.int64))
        if doubtful.any():
            self._waiting.append(table.take(doubtful))
        if sum(map(len, self._waiting)) >= self._block:
            yield from self.finish()

    def finish(self) -> Iterator[Runs]:
        """Decides the rows still waiting, as far as the tiers can, and yields them."""
        if self._waiting:
            table = concatenate(self._waiting)
            self._waiting = []
            yield self._escalate(table)

    def _escalate(self, table: Runs) -> Runs:
        tables, verdicts = [table], [said(table)]
        for tier in range(1, TIERS):
            rows = np.flatnonzero(is_open(verdicts, is_near(tables)))
            if not len(rows):
                break
            self.escalated[tier - 1] += len(rows)
            _LOG.info("solving %d doubtful runs again, for the %s time", len(rows), ("first", "second")[tier - 1])
            again = concatenate(list(self._solve(table["index"][rows], **self._tiers.options(tier))))
            tables.append(replace_rows(tables[-1], rows, again))
            verdicts.append(np.full_like(verdicts[0], Verdict.UNDECIDED))
            verdicts[-1][:, rows] = said(again)
        decided = _decided(tables, verdicts)
        is_defect = breaches_bound(tables[-1]) & (decided["verdict"] == Verdict.UNDECIDED)
        self.defects.extend(table["index"][is_defect].tolist())
        return decided


def said(table: Runs) -> Int[np.ndarray, "claims rows"]:
    """What one solve says of each claim: nothing where its peak is above what the comparison lemma allows."""
    return np.where(breaches_bound(table), int(Verdict.UNDECIDED), table.verdicts)


def agreed(verdicts: Sequence[np.ndarray]) -> Int[np.ndarray, "..."]:
    """What the tiers so far decide together; UNDECIDED where they don't.

    Args:
        verdicts: Verdicts by tier, from tier 0 on, arrays of one shape; UNDECIDED where a tier was not asked.
    """
    by_tier = np.array(verdicts)
    decided = np.full_like(by_tier[0], Verdict.UNDECIDED)
    for verdict, voices in _VOICES.items():
        says = by_tier == verdict
        is_alone = (says.sum(axis=0) >= voices) & ~_disagree(by_tier)
        # Tiers 0 and 1 share their method, so that of two that agree against a third one must be tier 2.
        is_double = says[:2].any(axis=0) & says[2:].any(axis=0)
        decided[is_alone | is_double] = verdict
    return decided


def is_open(
    verdicts: Sequence[Int[np.ndarray, "claims rows"]], near: Bool[np.ndarray, "claims rows"]
) -> Bool[np.ndarray, " rows"]:
    """Rows to be solved on the next tier, if there is one.

    The funnel claim must be decided. The later ones may be UNDECIDED for good, by a horizon that is too short, and are
    open only where a tier says something that is not yet to be believed, or where they are near.

    Args:
        verdicts: What each tier said so far.
        near: Where a firmer solve might decide what none has said.
    """
    is_undecided = agreed(verdicts) == Verdict.UNDECIDED
    says_something = (np.array(verdicts) != Verdict.UNDECIDED).any(axis=0)
    return is_undecided[0] | (is_undecided & (says_something | near)).any(axis=0)


def is_near(tables: Sequence[Runs]) -> Bool[np.ndarray, "claims rows"]:
    """Where the last solve knows the margin of a requirement, and it is too small to tell its sign."""
    table, unknown = tables[-1], np.full(len(tables[-1]), np.nan)
    margins = [table[margin_column(claim)] if is_requirement(claim) else unknown for claim in table.claims]
    return np.isfinite(margins) & (table.verdicts == Verdict.UNDECIDED)


def breaches_bound(table: Runs) -> Bool[np.ndarray, " rows"]:
    """Rows that HELD with a higher peak than the comparison lemma allows, where its premise on g holds.

    With several inputs it is Lyapunov's inequality that allows so much. A study that does not ask for `peak_u_bound`
    has no such rows.
    """
    held = table["verdict"] == Verdict.HELD
    if "barrier_bound" in table:
        return held & _passes(table["peak_barrier"], table["barrier_bound"])
    if "peak_u_bound" not in table:
        return np.zeros(len(table), bool)
    return held & (table["least_gain"] > 0.0) & _passes(table["peak_u"], table["peak_u_bound"])


def _passes(peak: Float[np.ndarray, " rows"], bound: Float[np.ndarray, " rows"]) -> Bool[np.ndarray, " rows"]:
    """Whether a peak is higher than its bound, beyond what the solve may be wrong."""
    return peak > bound * (1.0 + _BREACH_RTOL) + _BREACH_ATOL


def _disagree(by_tier: np.ndarray) -> np.ndarray:
    """Where two tiers say different things."""
    return np.sum([(by_tier == verdict).any(axis=0) for verdict in _VOICES], axis=0) > 1


def _decided(tables: Sequence[Runs], verdicts: Sequence[np.ndarray]) -> Runs:
    """The rows with what was decided, each with the metrics of the last tier that agrees with it."""
    decided = agreed(verdicts)
    tier = np.full(decided.shape[1], len(tables) - 1, np.int64)
    for is_wanted in (lambda each: each[0] == decided[0], lambda each: (each == decided).all(axis=0)):
        for number, each in enumerate(verdicts):
            tier[is_wanted(each)] = number
    columns = {name: np.choose(tier, [table[name] for table in tables]) for name in tables[0]}
    disputed = (decided[0] == Verdict.UNDECIDED) & _disagree(np.array(verdicts))[0]
    tier[disputed] = len(tables) - 1
    decided[:, disputed] = Verdict.UNDECIDED
    columns.update(zip(map(verdict_column, tables[0].claims), decided, strict=True))
    return _disowned(_with(tables[0], **columns, tier=tier), disputed)


def _disowned(table: Runs, disputed: Bool[np.ndarray, " rows"]) -> Runs:
    """The table without the metrics of disputed rows, of which no solve is known to be right."""
    columns = {}
    for name, column in table.columns.items():
        is_metric = np.issubdtype(column.dtype, np.floating) and name not in (*table.names, *_FACTS)
        columns[name] = np.where(disputed, np.nan, column) if is_metric else column
    columns["outcome"] = np.where(disputed, int(Outcome.SOLVES_DISAGREE), table["outcome"])
    return _with(table, **columns)


def _with(table: Runs, **columns: np.ndarray) -> Runs:
    return dataclasses.replace(table, columns={**table.columns, **columns})

"""From rows to a verdict: what is kept of them, and what is concluded in the end."""

import dataclasses
import math
from collections.abc import Callable, Iterator

import numpy as np

from qsmc_jax.base.checks import require_count, require_fraction, require_kind
from qsmc_jax.simulation.outcome import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.runs import CLAIMS, Runs, concatenate
from qsmc_jax.study.study import Study
from qsmc_jax.verification.anytime import confidence_sequence
from qsmc_jax.verification.ladder import firmer, is_doubtful
from qsmc_jax.verification.result import Claim, NumericalError, Verification
from qsmc_jax.verification.statistics import clopper_pearson
from qsmc_jax.verification.stopping import AbstractRule
from qsmc_jax.verification.summary import Summary

_STATEMENTS = {
    "funnel": "|sigma(t)| < rho(t) for all t",
    "reaching": "|sigma(t)| < bandwidth for all t >= t_r",
    "tracking": "|e^(i)(t)| <= bandwidth ||G_i||_1 for all t >= t_s and all i",
}


@dataclasses.dataclass(frozen=True)
class Effort:
    """What the rows cost.

    Attributes:
        climbed: Runs solved again on rung 1, 2 of the ladder.
        defects: Indices of runs whose peak broke the comparison bound.
        occupancy: Part of the solver's work that was not waiting for the slowest run of a block.
        seconds: Time of solving [s].
    """

    climbed: tuple[int, ...]
    defects: tuple[int, ...]
    occupancy: float
    seconds: float


class Evidence:
    """What is kept of decided rows, however many.

    Attributes:
        study: Their study.
        summary: Counts, worst rows, histograms.
        runs: Rows so far.
    """

    def __init__(self, study: Study, worst: int, block: int):
        """None yet; of the first `block` rows a sample will be kept to be solved again, with the worst."""
        reaching_time = float(study.nominal.loop.control.funnel.reaching_time(study.bandwidth))
        self.study, self.runs, self.summary = study, 0, Summary(worst, longest_reach=2.0 * reaching_time or 1.0)
        self._sample, self._sampled = [], max(block - worst, 1)

    def add(self, table: Runs) -> None:
        """Takes a table of decided rows in."""
        self._sample = self._sample or [table.take(~is_doubtful(table)).take(slice(self._sampled))]
        self.summary.add(table)
        self.runs += len(table)

    def conclude(
        self,
        solve: Callable[..., Iterator[Runs]],
        effort: Effort,
        *,
        seed: int,
        confidence: float,
        settings: SolverSettings,
        is_anytime: bool = False,
        decision: str | None = None,
    ) -> Verification:
        """Solves the sample and the worst rows again at a hundredth of the tolerance, and puts all together.

        Args:
            solve: `stream` of the study, to be called with indices and `settings`.
            effort: What the rows cost.
            seed: Seed of the rows.
            confidence: Confidence of each interval.
            settings: Settings of their first solve.
            is_anytime: Whether the number of runs may have been chosen by looking at them.
            decision: What a stopping rule said.
        """
        summary = self.summary
        interval = confidence_sequence if is_anytime else clopper_pearson
        checked = concatenate([*self._sample, *summary.worst])
        claims = zip(_STATEMENTS, CLAIMS, strict=True)
        return Verification(
            study=self.study,
            runs=self.runs,
            seed=seed,
            confidence=confidence,
            settings=settings,
            claims=tuple(_claim(summary, name, column, confidence, interval) for name, column in claims),
            worst=concatenate(summary.worst),
            numerical_error=_numerical_error(checked, solve, settings),
            climbed=effort.climbed,
            defects=effort.defects,
            margin=summary.margin,
            reach=summary.reach,
            peak_u=summary.peak_u,
            steps=summary.steps,
            occupancy=effort.occupancy,
            solve_seconds=effort.seconds,
            is_anytime=is_anytime,
            decision=decision,
        )


def check_request(runs: int, confidence: float, worst: int, until: AbstractRule | None) -> None:
    """Raises unless so many runs can be made, stopped by such a rule, and reported so."""
    if until is not None:
        require_kind("until", until, AbstractRule, "Use one of `qj.stopping`, such as `UntilBelow(1e-3)`.")
    require_count("runs", runs)
    require_fraction("confidence", confidence)
    require_count("worst", worst)


def _claim(
    summary: Summary, name: str, column: str, confidence: float, interval: Callable[..., tuple[float, float]]
) -> Claim:
    counts = summary.counts[column]
    held, violated, undecided = counts[Verdict.HELD], counts[Verdict.VIOLATED], counts[Verdict.UNDECIDED]
    low, high = interval(violated, undecided, held + violated + undecided, confidence)
    return Claim(name, _STATEMENTS[name], held, violated, undecided, counts[Verdict.INADMISSIBLE], low, high)


def _numerical_error(checked: Runs, solve: Callable[..., Iterator[Runs]], settings: SolverSettings) -> NumericalError:
    """Solves the decided rows again at a hundredth of the tolerance, and compares."""
    decided = (checked["verdict"] == Verdict.HELD) | (checked["verdict"] == Verdict.VIOLATED)
    before = checked.take(decided)
    if not len(before):
        return NumericalError(0, math.nan, 0)
    after = concatenate(list(solve(before["index"], settings=firmer(settings))))
    change = np.abs(after["peak_ratio"] - before["peak_ratio"])
    changed = np.any([after[claim] != before[claim] for claim in CLAIMS], axis=0)
    return NumericalError(len(before), float(np.nanmax(change, initial=0.0)), int(changed.sum()))

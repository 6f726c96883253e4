"""From rows to a verdict: what is kept of them, and what is concluded in the end."""

import dataclasses
from collections.abc import Callable, Mapping

from qsmc_jax.base.checks import require_count, require_fraction, require_kind
from qsmc_jax.metrics.claims import statement_of
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.trajectory import reaching_time
from qsmc_jax.statistics.anytime import confidence_sequence
from qsmc_jax.statistics.intervals import clopper_pearson
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.study import Study
from qsmc_jax.verification.numerical_error import ClaimCheck, Sample, Solve, recheck
from qsmc_jax.verification.result import Claim, Verification
from qsmc_jax.verification.stopping import AbstractRule
from qsmc_jax.verification.summary import Summary
from qsmc_jax.verification.tiers import Tiers


@dataclasses.dataclass(frozen=True)
class Cost:
    """What the rows cost.

    Attributes:
        escalated: Runs solved again on tier 1, 2.
        defects: Indices of runs whose peak broke the comparison bound.
        occupancy: Part of the solver's work that was not waiting for the slowest run of a block.
        seconds: Time of solving [s].
    """

    escalated: tuple[int, ...]
    defects: tuple[int, ...]
    occupancy: float
    seconds: float


class VerificationAccumulator:
    """What is kept of decided rows, however many.

    Attributes:
        study: Their study.
        summary: Counts, worst rows, histograms.
        sample: Rows to be solved again, with the worst.
        runs: Rows so far.
    """

    def __init__(self, study: Study, worst: int):
        """None yet; so many of the worst rows will be kept."""
        t_r = reaching_time(study.nominal.loop, study.bandwidth)
        self.study, self.runs, self.sample = study, 0, Sample()
        records = map(study.record_of, study.measured)
        self.summary = Summary(worst, 2.0 * t_r or 1.0, study.claims, records)

    def add(self, table: Runs) -> None:
        """Takes a table of decided rows in."""
        self.sample.add(table)
        self.summary.add(table)
        self.runs += len(table)

    def conclude(
        self,
        solve: Solve,
        cost: Cost,
        *,
        seed: int,
        confidence: float,
        settings: SolverSettings,
        is_anytime: bool = False,
        decision: str | None = None,
    ) -> Verification:
        """Solves the sample and the worst rows again another way, and puts all together.

        Args:
            solve: `stream` of the study, to be called with indices, `settings` and `block`.
            cost: What the rows cost.
            seed: Seed of the rows.
            confidence: Confidence of each interval.
            settings: Settings of their first solve.
            is_anytime: Whether the number of runs may have been chosen by looking at them.
            decision: What a stopping rule said.
        """
        summary = self.summary
        interval = confidence_sequence if is_anytime else clopper_pearson
        rows = concatenate([*self.sample.rows, *summary.worst])
        error, checks = recheck(rows, solve, Tiers.of(self.study, settings))
        *claims, all_together = (
            _claim(claim, counts, checks[claim], confidence, interval) for claim, counts in summary.counts.items()
        )
        found = Verification(
            study=self.study,
            runs=self.runs,
            seed=seed,
            confidence=confidence,
            settings=settings,
            claims=tuple(claims),
            together=all_together,
            worst=concatenate(summary.worst),
            numerical_error=error,
            escalated=cost.escalated,
            defects=cost.defects,
            margin=summary.margin,
            reach=summary.reach,
            peak_u=summary.peak_u,
            ranges=summary.ranges,
            steps=summary.steps,
            occupancy=cost.occupancy,
            solve_seconds=cost.seconds,
            is_anytime=is_anytime,
            decision=decision,
        )
        is_doubted = decision is not None and found.headline.changed
        doubted = f"{decision}, by verdicts that the check doubts"
        return dataclasses.replace(found, decision=doubted) if is_doubted else found


def check_request(runs: int, confidence: float, worst: int, until: AbstractRule | None) -> None:
    """Raises unless so many runs can be made, stopped by such a rule, and reported so."""
    if until is not None:
        require_kind("until", until, AbstractRule, "Use one of `qj.stopping`, such as `UntilBelow(1e-3)`.")
    require_count("runs", runs)
    require_fraction("confidence", confidence)
    require_count("worst", worst)


def _claim(
    name: str,
    counts: Mapping[Verdict, int],
    check: ClaimCheck,
    confidence: float,
    interval: Callable[..., tuple[float, float]],
) -> Claim:
    """The counts of a claim, and the interval.

    The check samples: where it changes one verdict, others that it did not try may be as wrong. All that it did not
    confirm then count as undecided in the interval, which holds however many of them are.
    """

    def of_the_confirmed(violated: int, undecided: int, total: int, confidence: float) -> tuple[float, float]:
        if check.changed:
            violated, undecided = check.violated, total - check.held - check.violated
        return interval(violated, undecided, total, confidence)

    about = {"name": name, "statement": statement_of(name)}
    return Claim.of(counts, confidence, of_the_confirmed, **about, changed=check.changed, confirmed=check.violated)

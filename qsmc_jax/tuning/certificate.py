"""What fresh runs say of tuned gains: the only numbers here that are a guarantee."""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np

from qsmc_jax.display.short_repr import short_repr
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.statistics.simultaneous import each_of
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.runs import Runs, concatenate, count_verdicts
from qsmc_jax.study.study import Study
from qsmc_jax.tuning.objectives import Constraint, Objective
from qsmc_jax.tuning.rows import counted, is_solved_to_its_end
from qsmc_jax.verification.counts import Counts
from qsmc_jax.verification.resolve import decide, part_of


@dataclasses.dataclass(frozen=True)
class Guarantee(Counts):
    """How often one thing fails, over fresh runs; all count, those that were not admissible as failed.

    Attributes:
        statement: What is said of a run.
    """

    statement: str


@dataclasses.dataclass(frozen=True)
class Certificate:
    """What fresh runs say of some gains. All its intervals, with those of every other candidate, hold together.

    Attributes:
        gains: The gains.
        seed: Seed of the fresh runs.
        runs: How many.
        risk: The probability that was to be shown.
        confidence: That all intervals of this design hold together.
        guarantees: The funnel claim, and each constraint on single runs.
        objective: The objective over the fresh runs.
        training_objective: The same over the training runs.

    Examples:
        >>> import qsmc_jax as qj
        >>> from qsmc_jax.tuning.certificate import Guarantee
        >>> counts = {qj.Verdict.HELD: 10_000, **dict.fromkeys((qj.Verdict(1), qj.Verdict(2), qj.Verdict(3)), 0)}
        >>> funnel = Guarantee.of(counts, 0.95, statement="in the funnel")
        >>> certificate = qj.Certificate({"mu": 2.7}, 1, 10_000, 0.01, 0.95, (funnel,), 50.0, training_objective=49.5)
        >>> certificate.is_granted, certificate.optimism
        (True, 0.5)
    """

    gains: dict[str, float]
    seed: int
    runs: int
    risk: float
    confidence: float
    guarantees: tuple[Guarantee, ...]
    objective: float
    training_objective: float

    @property
    def is_granted(self) -> bool:
        """Whether each probability of failure is shown to be at most the risk."""
        return all(each.high <= self.risk for each in self.guarantees)

    @property
    def optimism(self) -> float:
        """The objective over fresh runs less that over the training runs: what the choice of gains flattered it by."""
        return self.objective - self.training_objective

    __repr__ = short_repr

    def __str__(self) -> str:
        rows = [
            f"{'GRANTED' if self.is_granted else 'REFUSED'}: {self.runs} fresh runs, seed {self.seed}, "
            f"risk {self.risk:g}; all intervals together with {100 * self.confidence:.4g} % confidence"
        ]
        rows += [
            f"  {each.statement:28} false in {each.violated} of {each.total} ({each.undecided} undecided): "
            f"probability in [{each.low:.3g}, {each.high:.3g}]"
            for each in self.guarantees
        ]
        rows.append(
            f"  objective {self.objective:.6g} on fresh runs, {self.training_objective:.6g} on training runs "
            f"(optimism {self.optimism:+.2g})"
        )
        return "\n".join(rows)


def confidence_of(attempt: int, confidence: float) -> float:
    r"""The confidence of design j = `attempt` + 1, which has $6 / (\pi^2 j^2)$ of the risk that all share.

    Source: Calafiore, IEEE TAC 62 (2017), repetitive scenario design.
    """
    return 1.0 - (1.0 - confidence) * 6.0 / (math.pi * (attempt + 1)) ** 2


def certify(
    study: Study,
    candidates: list[tuple[dict[str, float], float]],
    objective: Objective,
    constraints: tuple[Constraint, ...],
    *,
    runs: int,
    seed: int,
    risk: float,
    confidence: float,
    settings: SolverSettings,
    block: int | None,
    threads: int | None,
    progress: Progress | None,
) -> list[Certificate]:
    """Tries candidates on fresh runs, the same for all; doubtful runs are solved again as in `verify`.

    Args:
        study: The study.
        candidates: Gains, and the objective that they had in training.
        objective: The objective.
        constraints: The constraints; those on single runs are certified, those on means are not.
        runs: Fresh runs of each.
        seed: Their seed, not that of the training.
        risk: The probability of failure to be shown.
        confidence: That all intervals of all candidates hold together.
        settings: Method and tolerances.
        block: Runs solved together; None for what suits the platform.
        threads: Blocks solved at the same time.
        progress: Called as `progress(done, all)`.
    """
    single = [constraint for constraint in constraints if constraint.per_run]
    each = each_of(len(candidates) * (1 + len(single)), confidence)
    made = []
    for number, (gains, trained) in enumerate(candidates):
        told = part_of(progress, number * runs, len(candidates) * runs)
        there = study.substitute(**gains)
        tables = decide(there, range(runs), seed, settings=settings, block=block, threads=threads, progress=told)
        table = concatenate(list(tables))
        verdict = table["verdict"]
        funnel = _counted("in the funnel from t = 0 on", fails_any(verdict), verdict == Verdict.UNDECIDED, each)
        kept = [_kept(constraint, table, each) for constraint in single]
        fresh = objective.evaluate(counted(table.columns, objective.metrics, float(there.nominal.t1)))[0]
        made.append(Certificate(gains, seed, runs, risk, confidence, (funnel, *kept), fresh, trained))
    return made


def fails_any(verdict: np.ndarray) -> np.ndarray:
    """The runs that fail whatever is said of them, unless a known metric says otherwise.

    A start outside the funnel counts as a failure: gains must not look safe by shutting runs out.
    """
    return (verdict == Verdict.VIOLATED) | (verdict == Verdict.INADMISSIBLE)


def judge(constraint: Constraint, table: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Which single runs fail a bound for certain, and which could not be decided; every other run keeps it for certain.

    A run keeps the bound only if its metric is known, over the whole horizon, and lies within; one that left the funnel
    fails whatever bound implies that it stays there. Where the metric is not known a run that left fails, as one that
    was not admissible does, and any other is undecided.

    Args:
        constraint: A constraint on single runs.
        table: The runs, by column.
    """
    metric = str(constraint.per_run)
    values, verdict = table[metric], table["verdict"]
    is_known = is_solved_to_its_end(table) & np.isfinite(values)
    passes = constraint.side * (values - constraint.bound) > 0.0
    if constraint.implies_funnel:
        passes |= verdict == Verdict.VIOLATED
    failed = np.where(is_known, passes, fails_any(verdict)) | (verdict == Verdict.INADMISSIBLE)
    return failed, ~is_known & ~failed


def _kept(constraint: Constraint, table: Runs, confidence: float) -> Guarantee:
    """How often a single run passes the bound."""
    sign = "<=" if constraint.side > 0 else ">="
    return _counted(f"{constraint.per_run} {sign} {constraint.bound:g}", *judge(constraint, table.columns), confidence)


def _counted(statement: str, failed: np.ndarray, undecided: np.ndarray, confidence: float) -> Guarantee:
    verdicts = np.select([failed, undecided], [int(Verdict.VIOLATED), int(Verdict.UNDECIDED)], int(Verdict.HELD))
    return Guarantee.of(count_verdicts(verdicts), confidence, statement=statement)

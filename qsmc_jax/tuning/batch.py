"""The training runs: the same random numbers for all gains, their objective and constraints, and what was spent."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float

from qsmc_jax.simulation.outcome import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.lanes import LANE_MULTIPLE, thread_count
from qsmc_jax.study.monte_carlo import monte_carlo
from qsmc_jax.study.study import Study
from qsmc_jax.study.tangents import differentiate
from qsmc_jax.tuning.box import Box
from qsmc_jax.tuning.objectives import Constraint, Objective

# A constraint counts as kept up to this part of its bound.
KEPT = 1e-6


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """The training runs at some gains.

    Attributes:
        gains: The gains, by name.
        objective: The objective, without smoothing.
        excess: By how much each constraint is passed, in units of its bound; kept where not positive.
        inside: How far inside its bound each must stay, in units of it.
        unknown: Part of the runs that are inadmissible or undecided, or in which some figure is not known.
        allowed: What part may be: that at the study's own gains. Statistics pass over unknown runs, and gains must not
            look better by making more of them.
        spent: Simulations made so far; a gradient counts as one for the run and one for each name.
        start: Number of the start that the descent came from; -1 for the starts themselves.
        attempt: Number of the design, from 0.
    """

    gains: dict[str, float]
    objective: float
    excess: tuple[float, ...]
    inside: float
    unknown: float
    allowed: float
    spent: int
    start: int
    attempt: int

    @property
    def lacks(self) -> tuple[float, ...]:
        """What each constraint lacks to be kept as far inside as it must; nothing where not positive."""
        return tuple(each + self.inside for each in self.excess)

    @property
    def is_feasible(self) -> bool:
        """Whether every constraint is kept and the objective known, in no fewer runs than at the study's own gains."""
        is_known = bool(np.isfinite(self.objective)) and self.unknown <= self.allowed
        return is_known and all(each <= KEPT for each in self.lacks)

    @property
    def merit(self) -> tuple[bool, float]:
        """Smaller is better: feasible ones by their objective, then the others by what they lack."""
        lack = sum(max(each, 0.0) if np.isfinite(each) else np.inf for each in self.lacks)
        lack += max(self.unknown - self.allowed, 0.0)
        return not self.is_feasible, self.objective if self.is_feasible else lack


@dataclasses.dataclass
class Batch:
    """Training runs of a study, on common random numbers.

    Attributes:
        study: The study.
        box: The parameters to be tuned.
        objective: What to make small.
        constraints: What to keep.
        runs: How many runs.
        seed: Their seed.
        settings: Method, tolerances and mode of differentiation.
        block: Runs solved together at most.
        threads: Blocks solved at the same time; None for one a core.
        attempt: Number of the design.
        tell: Told each evaluation.
        allowed: Part of the runs that may be unknown.
        inside: How far inside its bound each constraint must stay, in units of it.
        spent: Simulations made so far.
        history: Every evaluation, in order.
    """

    study: Study
    box: Box
    objective: Objective
    constraints: tuple[Constraint, ...]
    runs: int
    seed: int
    settings: SolverSettings
    block: int
    threads: int | None
    attempt: int
    tell: Callable[[Evaluation], None] | None
    allowed: float = 1.0
    inside: float = 0.0
    spent: int = 0
    history: list[Evaluation] = dataclasses.field(default_factory=list)

    @property
    def metrics(self) -> tuple[str, ...]:
        """The columns that objective and constraints need."""
        needed = [self.objective.metrics, *(constraint.objective.metrics for constraint in self.constraints)]
        return tuple(dict.fromkeys(metric for metrics in needed for metric in metrics))

    def evaluate(self, v: Float[np.ndarray, " names"], start: int = -1) -> Evaluation:
        """Objective and constraints at a point of the unit cube."""
        gains = self.box.gains(v)
        table = monte_carlo(
            self.study.substitute(**gains),
            self.runs,
            self.seed,
            settings=self.settings,
            block=self._block,
            threads=self.threads,
        )
        self.spent += self.runs
        return self._keep(gains, {metric: table[metric] for metric in self.metrics}, table["verdict"], start)

    def differentiate(
        self, v: Float[np.ndarray, " names"], smoothing: float, start: int
    ) -> tuple[Evaluation, np.ndarray, np.ndarray]:
        """The same, and smoothed objective and excesses (1 + constraints) with their derivatives by `v`."""
        gains = self.box.gains(v)
        found = differentiate(
            self.study.substitute(**gains),
            np.arange(self.runs),
            self.seed,
            names=self.box.names,
            metrics=self.metrics,
            settings=self.settings,
            block=self._block,
            threads=self.threads,
        )
        self.spent += self.runs * (1 + len(self.box.names))
        known = np.where(found.is_known, found.values, np.nan)
        columns = {metric: known[:, i] for i, metric in enumerate(self.metrics)}
        by_metric = {metric: found.jacobian[:, i] for i, metric in enumerate(self.metrics)}
        parts = [self.objective.evaluate(columns, smoothing)]
        parts += [constraint.excess(columns, smoothing) for constraint in self.constraints]
        values = np.array([value for value, _ in parts])
        slopes = np.array([sum(w @ by_metric[m] for m, w in weights.items()) for _, weights in parts])
        raw = {metric: found.values[:, i] for i, metric in enumerate(self.metrics)}
        return self._keep(gains, raw, found.verdict, start), values, slopes * self.box.slopes(v)

    @property
    def _block(self) -> int:
        """Small enough that every thread has work, a multiple of 64."""
        each = -(-self.runs // (thread_count(self.threads) * LANE_MULTIPLE)) * LANE_MULTIPLE
        return min(self.block, each)

    def _keep(self, gains: dict[str, float], columns: Any, verdict: np.ndarray, start: int) -> Evaluation:
        is_known = np.all([np.isfinite(column) for column in columns.values()], axis=0)
        made = Evaluation(
            gains=gains,
            objective=self.objective.evaluate(columns)[0],
            excess=tuple(constraint.excess(columns)[0] for constraint in self.constraints),
            inside=self.inside,
            unknown=float(np.mean(~is_known | np.isin(verdict, (Verdict.UNDECIDED, Verdict.INADMISSIBLE)))),
            allowed=self.allowed,
            spent=self.spent,
            start=start,
            attempt=self.attempt,
        )
        self.history.append(made)
        if self.tell is not None:
            self.tell(made)
        return made

"""The training runs, the same for all gains: their objective and constraints, and how many simulations were made."""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import nearest, require
from qsmc_jax.metrics.record import without_index
from qsmc_jax.metrics.standard import columns_of_channels, kinds_of
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.batches import LANE_MULTIPLE, block_size, thread_count
from qsmc_jax.study.monte_carlo import stream
from qsmc_jax.study.runs import concatenate
from qsmc_jax.study.study import Study
from qsmc_jax.study.tangents import differentiate
from qsmc_jax.tuning.bounds import Bounds
from qsmc_jax.tuning.objectives import Constraint, Objective
from qsmc_jax.tuning.rows import LOSS, NEEDED, counted, is_unknown, mean_loss, slopes
from qsmc_jax.tuning.terms import METRICS, Term

# A constraint counts as kept up to this part of its bound.
KEPT = 1e-6
# Which loops alone have a metric, by the kind that its record names.
_ONLY = {
    "sampled": "a loop with an `implementation`",
    "several": "an ideal loop with several inputs",
    "own": "an ideal loop of a plant in its own coordinates",
}


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """The training runs at some gains.

    Attributes:
        gains: The gains, by name.
        objective: The objective, without smoothing; infinite if a metric that it needs is not known in some run.
        excess: Violation of each constraint, in units of its bound; satisfied where not positive.
        inside: How far inside its bound each must stay, in units of it.
        lost: Part of the runs that left the funnel or could not be decided, and have no metrics for that.
        unknown: Part of the runs in which a metric is not known, for that or another reason, or that are inadmissible.
        inadmissible: Part of the runs that are inadmissible: statistics are those of the others.
        allowed: What part may be: that at the study's own gains. Gains must not look better by shutting runs out.
        loss: Mean over the admissible runs of what each lost that has not all metrics: at least 0.01, and the part of
            its horizon that was left when it left; see `counted`.
        n_simulations: Simulations made so far; a gradient counts as one for the run and one for each name.
        start: Number of the start that the descent came from; -1 for the starts themselves.
        attempt: Number of the design, from 0.
    """

    gains: dict[str, float]
    objective: float
    excess: tuple[float, ...]
    inside: float
    lost: float
    unknown: float
    inadmissible: float
    allowed: float
    loss: float
    n_simulations: int
    start: int
    attempt: int

    @property
    def violations(self) -> tuple[float, ...]:
        """What each constraint lacks to be kept as far inside as it must; nothing where not positive."""
        return tuple(each + self.inside for each in self.excess)

    @property
    def is_feasible(self) -> bool:
        """Whether every constraint is kept, and the objective known in every run, no fewer than at the own gains."""
        is_known = bool(np.isfinite(self.objective)) and self.inadmissible <= self.allowed
        return is_known and all(each <= KEPT for each in self.violations)

    @property
    def merit(self) -> tuple[int, float]:
        """Smaller is better: feasible gains by their objective, others by what they lack, those that lose runs last.

        Gains that lose runs are ordered by how many those are and how soon they left, whatever the constraints say.
        """
        if self.is_feasible:
            return 0, self.objective
        if self.loss > 0.0:
            return 2, self.loss
        return 1, sum(max(each, 0.0) for each in self.violations) + max(self.inadmissible - self.allowed, 0.0)


@dataclasses.dataclass
class Batch:
    """Training runs of a study, on common random numbers.

    Attributes:
        study: The study.
        bounds: The parameters to be tuned.
        objective: What to make small.
        constraints: What to keep.
        runs: How many runs.
        seed: Their seed.
        settings: Method, tolerances and mode of differentiation.
        block: Runs solved together at most; None for what suits the platform.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        attempt: Number of the design.
        tell: Told each evaluation.
        allowed: Part of the runs that may be inadmissible.
        inside: How far inside its bound each constraint must stay, in units of it.
        n_simulations: Simulations made so far.
        history: Every evaluation, in order.
    """

    study: Study
    bounds: Bounds
    objective: Objective
    constraints: tuple[Constraint, ...]
    runs: int
    seed: int
    settings: SolverSettings
    block: int | None
    threads: int | None
    attempt: int
    tell: Callable[[Evaluation], None] | None
    allowed: float = 1.0
    inside: float = 0.0
    n_simulations: int = 0
    history: list[Evaluation] = dataclasses.field(default_factory=list)

    def __post_init__(self):
        loop, own = self.study.nominal.loop, self.study.measured
        by_channel = columns_of_channels(len(loop.channels))
        known = (*(f"peak_error[{i}]" for i in range(loop.order)), *METRICS, *by_channel, *own)
        for metric in self.metrics:
            named, record = f"Argument `objective` names `{metric}`", self.study.record_of(metric)
            hint = nearest(metric, known)
            require(metric in known, f"{named}, but must name one of {', '.join(known)}.{hint}")
            is_asked = metric in own or without_index(metric) in self.study.standard
            require(is_asked, f"{named}, which `metrics` of the study leaves out: add it there.")
            require(record.loops in kinds_of(loop), f"{named}, which only {_ONLY.get(record.loops)} has.")
            require(record.has_gradient, f"{named}, which has no derivative by the gains.")
        for term in self.terms:
            is_meant = term.statistic not in ("worst", "cvar") or self.study.record_of(term.metric).worse != "low"
            require(
                is_meant,
                f"Argument `objective`: `{term.statistic}` is the largest, but of `{term.metric}` the smallest is the "
                f"worst: use `least({term.metric})`.",
            )

    @property
    def metrics(self) -> tuple[str, ...]:
        """The columns that objective and constraints need."""
        return tuple(dict.fromkeys(term.metric for term in self.terms))

    @property
    def terms(self) -> list[Term]:
        """What objective and constraints are made of."""
        objectives = (self.objective, *(constraint.objective for constraint in self.constraints))
        return [term for objective in objectives for term in objective.terms]

    def evaluate(self, v: Float[np.ndarray, " names"], start: int = -1) -> Evaluation:
        """Objective and constraints at a point of the unit cube."""
        gains = self.bounds.gains(v)
        there, options = self.study.substitute(**gains), {"block": self._block, "threads": self.threads}
        blocks = stream(there, range(self.runs), self.seed, settings=self.settings, **options)
        table = concatenate(list(blocks)).columns
        self.n_simulations += self.runs
        return self._keep(gains, table, counted(table, self.metrics, self._horizon(gains)), start)

    def differentiate(
        self, v: Float[np.ndarray, " names"], smoothing: float, start: int
    ) -> tuple[Evaluation, np.ndarray, np.ndarray]:
        """The same, and finite numbers for a descent to go by, with their derivatives by `v`.

        Returns:
            The evaluation; smoothed objective and excesses, each over the runs in which it is known, and what lost runs
            lack, negative if there are none, (1 + constraints + 1,); and their derivatives.
        """
        gains, wanted = self.bounds.gains(v), tuple(dict.fromkeys((*self.metrics, *NEEDED)))
        found = differentiate(
            self.study.substitute(**gains),
            np.arange(self.runs),
            self.seed,
            names=self.bounds.names,
            metrics=wanted,
            settings=self.settings,
            block=self._block,
            threads=self.threads,
        )
        self.n_simulations += self.runs * (1 + len(self.bounds.names))
        table = {metric: found.values[:, i] for i, metric in enumerate(wanted)}
        table |= {"verdict": found.verdict, "outcome": found.outcome}
        horizon, by_name = self._horizon(gains), {metric: found.jacobian[:, i] for i, metric in enumerate(wanted)}
        columns = counted(table, self.metrics, horizon)
        by_column = {name: by_name[name][found.verdict != Verdict.INADMISSIBLE] for name in self.metrics}
        by_column[LOSS] = slopes(table, by_name, horizon)
        made = self._keep(gains, table, columns, start)
        lacking, by_loss = mean_loss(columns, self.metrics)
        lacking += max(made.inadmissible - made.allowed, 0.0)
        parts = [self.objective.among_known(columns, smoothing)]
        parts += [constraint.lead(columns, smoothing) for constraint in self.constraints]
        parts.append((lacking if lacking > 0.0 else -1.0, by_loss))
        values = np.array([value for value, _ in parts])
        by_gain = np.array([sum(w @ by_column[name] for name, w in weights.items()) for _, weights in parts])
        return made, values, by_gain * self.bounds.slopes(v)

    def _horizon(self, gains: Mapping[str, float]) -> float:
        return float(self.study.substitute(**gains).nominal.t1)

    @property
    def _block(self) -> int:
        """Small enough that every thread has work, a multiple of 64."""
        each = -(-self.runs // (thread_count(self.threads) * LANE_MULTIPLE)) * LANE_MULTIPLE
        return min(block_size(self.block), each)

    def _keep(
        self, gains: dict[str, float], table: Mapping[str, np.ndarray], columns: Mapping[str, np.ndarray], start: int
    ) -> Evaluation:
        verdict = np.asarray(table["verdict"])
        has_metrics = ~is_unknown(columns, self.metrics)
        inadmissible = float(np.mean(verdict == Verdict.INADMISSIBLE))
        made = Evaluation(
            gains=gains,
            objective=self.objective.evaluate(columns)[0],
            excess=tuple(constraint.excess(columns)[0] for constraint in self.constraints),
            inside=self.inside,
            lost=float(np.sum(columns[LOSS] > 0.0)) / len(verdict),
            unknown=1.0 - float(np.sum(has_metrics)) / len(verdict),
            inadmissible=inadmissible,
            allowed=self.allowed,
            loss=mean_loss(columns, self.metrics)[0],
            n_simulations=self.n_simulations,
            start=start,
            attempt=self.attempt,
        )
        self.history.append(made)
        if self.tell is not None:
            self.tell(made)
        return made

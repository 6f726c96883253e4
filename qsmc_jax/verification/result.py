"""The result of `verify`: what was found, how sure it is, and the worst runs."""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from qsmc_jax.base.checks import require, show
from qsmc_jax.display.notebook import as_html
from qsmc_jax.display.result import AbstractResult
from qsmc_jax.metrics.claims import TOGETHER, breached, breaching, headline
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.probed import probed_functions, said_of_probed
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.trajectory import reaching_time
from qsmc_jax.statistics.intervals import runs_needed
from qsmc_jax.statistics.shift import Shift, survived, under_divergence, under_ratio, under_variation
from qsmc_jax.study.runs import Runs
from qsmc_jax.study.study import Study
from qsmc_jax.verification.counts import HEADING, Counts
from qsmc_jax.verification.numerical_error import NumericalError
from qsmc_jax.verification.result_plots import plot_margin, plot_verification
from qsmc_jax.verification.summary import Histogram, Range
from qsmc_jax.verification.tiers import Tiers

# Divergences [nat] of which the summary tells what the probability is at most.
_DIVERGENCES = (1e-3, 1e-2, 1e-1)


@dataclasses.dataclass(frozen=True)
class Claim(Counts):
    """Counts for one claim, and the interval of the probability that it is violated.

    Attributes:
        name: "funnel", "reaching", "tracking", or the name of a requirement of the study.
        statement: What is claimed.
        changed: Runs whose verdict changed when they were solved again another way, of a sample and the worst. With
            one, the interval counts as undecided every run that was not solved again or not confirmed.
        confirmed: Violated runs that were confirmed so.
    """

    name: str
    statement: str
    changed: int = 0
    confirmed: int = 0

    @property
    def verdict(self) -> Verdict:
        """VIOLATED by one violated run, UNDECIDED by one undecided, INADMISSIBLE if no run was admitted, else HELD.

        Once a verdict changed when solved again, only a violated run that was confirmed counts, and nothing is HELD.
        """
        if self.confirmed if self.changed else self.violated:
            return Verdict.VIOLATED
        if self.undecided or self.changed:
            return Verdict.UNDECIDED
        return Verdict.HELD if self.held else Verdict.INADMISSIBLE


def _summary(claim: Claim) -> dict[str, Any]:
    return {**dataclasses.asdict(claim), "verdict": claim.verdict.name}


@dataclasses.dataclass(frozen=True, repr=False)
class Verification(AbstractResult):
    """What `verify` found.

    Attributes:
        study: The study.
        runs: Runs made.
        seed: Their seed.
        confidence: Confidence of each interval.
        settings: Settings of the first solve.
        claims: The three claims of Theorem 1, and the requirements of the study.
        together: All of them holding together in one run.
        worst: The worst runs, most serious first.
        numerical_error: What changed in the runs that were solved again to check them.
        escalated: Runs solved again because they were doubtful: at a tighter tolerance, and by another method.
        defects: Indices of runs whose peak breaks the comparison bound: a defect of the simulator, not of the loop.
        margin: Histogram of 1 - sup |sigma|/rho.
        reach: Histogram of the reach time [s].
        peak_u: Largest sup |u| of the runs that held.
        steps: Solver steps of all runs together.
        occupancy: Part of the solver's work that was not waiting for the slowest run of a block.
        solve_seconds: Time of solving, without compilation [s].
        is_anytime: Whether the intervals hold at all numbers of runs at once, as they must where one looked before
            stopping; else they are exact for this number.
        decision: What the stopping rule said; None without one, or if it said nothing.
        ranges: What the study's own metrics were, and the margins of its requirements.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> found = qj.verify(study, runs=64, block=64)
        >>> found.verdict.name, found.claims[0].held, found.plan(1e-3)
        ('HELD', 64, 3688)
        >>> round(found.shifted(divergence=0.01), 4), round(found.survives(below=0.1).ratio, 2)
        (0.0913, 1.79)
    """

    study: Study
    runs: int
    seed: int
    confidence: float
    settings: SolverSettings
    claims: tuple[Claim, ...]
    together: Claim
    worst: Runs
    numerical_error: NumericalError
    escalated: tuple[int, ...]
    defects: tuple[int, ...]
    margin: Histogram
    reach: Histogram
    peak_u: float
    steps: int
    occupancy: float
    solve_seconds: float
    is_anytime: bool = False
    decision: str | None = None
    ranges: tuple[Range, ...] = ()

    @property
    def verdict(self) -> Verdict:
        """The verdict on all claims together, and on the simulator: HELD only if nothing at all is in doubt."""
        verdicts = [claim.verdict for claim in self.claims]
        if Verdict.VIOLATED in verdicts:
            return Verdict.VIOLATED
        is_held = all(verdict == Verdict.HELD for verdict in verdicts)
        return Verdict.HELD if is_held and not self.defects else Verdict.UNDECIDED

    @property
    def headline(self) -> Claim:
        """What the conclusion is about: the funnel claim; with requirements, all claims together."""
        return self.together if headline(self.study.claims) == TOGETHER else self.claims[0]

    @property
    def firmer(self) -> SolverSettings:
        """The settings that the check used: to verify all runs by, where it changed a verdict."""
        tiers = Tiers.of(self.study, self.settings)
        return tiers.settings[tiers.check_of(0)]

    def settings_of(self, row: Mapping[str, Any]) -> SolverSettings:
        """The settings of the solve that decided a run.

        Args:
            row: Its row, with the column `tier`.
        """
        return Tiers.of(self.study, self.settings).settings[int(row["tier"])]

    def summary(self) -> Mapping[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        firmer = self.firmer
        return {
            "verdict": self.verdict.name,
            "runs": self.runs,
            "seed": self.seed,
            "confidence": self.confidence,
            "interval": "confidence sequence" if self.is_anytime else "Clopper-Pearson",
            "decision": self.decision,
            "bandwidth": self.study.bandwidth,
            "values": {name: value.tolist() for name, value in self.study.values.items()},
            "claims": [_summary(claim) for claim in self.claims],
            "together": _summary(self.together),
            "shifted": [{"divergence": each, "high": self.shifted(divergence=each)} for each in _DIVERGENCES],
            "probed": list(probed_functions(self.study.nominal.loop)),
            "numerical_error": dataclasses.asdict(self.numerical_error),
            "firmer": {"rtol": float(firmer.rtol), "max_steps": firmer.max_steps, "method": firmer.method},
            "escalated": list(self.escalated),
            "defects": list(self.defects),
            "peak_u": self.peak_u,
            "metrics": [each.summary() for each in self.ranges],
            "worst": [self.worst.row(i) for i in range(len(self.worst))],
            "steps": self.steps,
            "occupancy": self.occupancy,
            "solve_seconds": self.solve_seconds,
        }

    def conclusion(self) -> str:
        """The finding in a sentence or two that can be quoted."""
        sure = f"with {100 * self.confidence:g} % confidence" + (" at any time" if self.is_anytime else "")
        whole = self.headline
        interval = f"the probability of {breaching(whole.name)} lies in [{whole.low:.3g}, {whole.high:.3g}] {sure}"
        if self.verdict == Verdict.VIOLATED:
            reasons = {Outcome(int(code)).advice for code in self.worst["outcome"] if code != Outcome.COMPLETED}
            broken = [claim for claim in self.claims if claim.violated] or list(self.claims[:1])
            told = ", ".join(f"{claim.violated} {breached(claim.name)}" for claim in broken)
            found = f"of {whole.total} admissible runs {told}"
            return " ".join((f"VIOLATED: {found}; {interval}.", *sorted(reasons), *self._of_the_check()))
        if self.verdict == Verdict.UNDECIDED:
            return f"UNDECIDED: {self._doubts()} Counting undecided runs both ways, {interval}."
        return " ".join((f"HELD in all {whole.total} admissible runs: {interval}.", *self._of_the_check()))

    def _of_the_check(self) -> list[str]:
        """What is to be said of the runs that were solved again to check them; nothing if they were all confirmed."""
        error, firmer, found = self.numerical_error, self.firmer, []
        if error.changed:
            claims = ", ".join(f"{claim.name} {claim.changed}" for claim in self.claims if claim.changed)
            found.append(
                f"Of {error.checked} runs that were solved again another way {error.changed} changed their verdict "
                f"({claims}): until all are, by `SolverSettings(rtol={float(firmer.rtol)!r}, "
                f"max_steps={firmer.max_steps}, method={firmer.method!r})`, every run that was not confirmed counts as "
                "undecided in the interval."
            )
        if error.unchecked:
            found.append(
                f"{error.unchecked} of {error.checked + error.unchecked} runs could not be checked: solved again "
                "another way they came to no verdict."
            )
        return found

    def _doubts(self) -> str:
        doubts = [f"{c.undecided} runs undecided on {c.name}." for c in self.claims if c.undecided]
        nominal = self.study.nominal
        t_r, t1 = reaching_time(nominal.loop, self.study.bandwidth), float(nominal.t1)
        if t_r >= t1 and any(c.undecided for c in self.claims[1:3]):
            doubts.append(f"The reaching time {t_r:.4g} s lies beyond the horizon {t1:.4g} s: make `t1` longer.")
        doubts += [f"No admissible run for {c.name}." for c in self.claims if c.verdict == Verdict.INADMISSIBLE]
        if self.defects:
            doubts.append(
                f"{len(self.defects)} peaks break the comparison bound, a defect of the simulator: please report it."
            )
        doubts += self._of_the_check()
        codes = sorted({int(code) for code in self.worst["outcome"]} - {0})
        return " ".join(doubts + [Outcome(code).advice for code in codes])

    def plot_margin(self, ax: Any = None) -> Any:
        """The histogram of 1 - sup |sigma|/rho; nothing is solved for it.

        Args:
            ax: Matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        return plot_margin(self, ax)

    def _repr_html_(self) -> str:
        return as_html(str(self), self.plot_margin)

    def plot(self, ax: Any = None) -> Any:
        """The funnel with bands of the runs and the worst run, and the distributions of margin and reach time.

        Solves 64 runs and the worst one again to draw them.

        Args:
            ax: Three matplotlib `Axes` to draw in; None for a new figure, which also gets a heading.

        Returns:
            The axes, (3,).
        """
        return plot_verification(self, ax)

    def table(self) -> dict[str, Any]:
        """The claims as columns, a row a claim: its name, the counts, the interval of its violation, its verdict."""
        counts = [field.name for field in dataclasses.fields(Counts)]
        columns = {name: np.array([getattr(claim, name) for claim in self.claims]) for name in ("name", *counts)}
        return {**columns, "verdict": np.array([claim.verdict.name for claim in self.claims])}

    def plan(self, probability: float) -> int:
        """Runs needed, without a violation, to bound the violation probability by `probability` at this confidence.

        Args:
            probability: What is to be shown, strictly between 0 and 1.
        """
        return runs_needed(probability, self.confidence)

    def shifted(
        self, *, divergence: float | None = None, variation: float | None = None, ratio: float | None = None
    ) -> float:
        """The upper end of the violation probability if the draws have another distribution than the study says.

        Give one distance. The bound is sharp: some distribution that near has it, if the upper end is the probability.

        Args:
            divergence: Kullback-Leibler divergence from the study's distribution at most [nat], at least 0.
            variation: Total variation at most: the largest difference of any probability.
            ratio: How many times as probable as the study says anything may be, at least 1.

        Returns:
            The bound on the probability that `conclusion` is about, with the same confidence.

        Raises:
            InputError: Not exactly one distance is given, or it is out of range.
        """
        bounds = {under_divergence: divergence, under_variation: variation, under_ratio: ratio}
        given = [(bound, distance) for bound, distance in bounds.items() if distance is not None]
        require(len(given) == 1, f"Give one of `divergence`, `variation` and `ratio`, not {len(given)} of them.")
        ((bound, distance),) = given
        return bound(self.headline.high, distance)

    def survives(self, below: float) -> Shift:
        """How far the distribution of the draws may be off, and the violation probability still be at most `below`.

        Args:
            below: The probability, strictly between 0 and 1.

        Returns:
            The largest distances; NaN where even the study's own distribution is not shown to be below.
        """
        return survived(self.headline.high, below)

    def __str__(self) -> str:
        rows = [f"{self.runs} runs, seed {self.seed}, bandwidth {show(np.float64(self.study.bandwidth))}"]
        shown = (*self.claims, self.together) if self.study.requirements else self.claims
        width = max(10, *(len(claim.name) + 1 for claim in shown))
        rows.append(f"{'claim':{width}}{HEADING}   violation probability")
        rows += [f"{claim.name:{width}}{claim.row()}" for claim in shown]
        rows += map(str, self.ranges)
        rows.append(self.conclusion())
        if probed := said_of_probed(self.study.nominal.loop):
            rows.append(probed)
        if self.decision:
            rows.append(f"Stopped after {self.runs} runs: {self.decision}.")
        return "\n".join(rows)

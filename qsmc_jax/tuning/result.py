"""The result of `tune`: the gains, how they were found, and their certificate."""

import dataclasses
from typing import Any

import numpy as np

from qsmc_jax.display.result import AbstractResult
from qsmc_jax.study.study import Study
from qsmc_jax.tuning.batch import KEPT, Evaluation
from qsmc_jax.tuning.certificate import Certificate
from qsmc_jax.tuning.objectives import Constraint, Objective
from qsmc_jax.tuning.result_plots import plot_tuning


@dataclasses.dataclass(frozen=True, repr=False)
class Tuning(AbstractResult):
    """What `tune` found.

    Attributes:
        base: The study as it was.
        parameters: The names tuned.
        objective: What was made small.
        constraints: What was kept.
        runs: Training runs of each evaluation.
        seed: Seed of the first training runs.
        confidence: That every statement of all certificates holds.
        before: The training runs at the study's own gains.
        best: The training runs at the chosen gains.
        history: Every evaluation in order.
        certificates: Those of every candidate, in order; the last design's last.
        certificate: That of the chosen gains; None if none was asked for.
        sensitivity: Derivative of the objective and of each constraint's excess at the chosen gains by each gain,
            in units of what each is there: percent by percent, (1 + constraints, names).

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     rho0, mu = draw.parameter("rho0", 4.0, bounds=(3.0, 8.0)), draw.parameter("mu", 3.0, bounds=(2.0, 4.0))
        ...     control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0, mu, rho_inf=0.05))
        ...     loop = dataclasses.replace(qj.paper.example1(), control=control)
        ...     return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> tuned = qj.tune(study, ["mu"], "mean(energy_u)", runs=2, starts=1, steps=3, certificate_runs=0, block=64)
        >>> tuned.parameters, tuned.is_certified, float(tuned.study.values["mu"]) == tuned.gains["mu"]
        (('mu',), False, True)
    """

    base: Study
    parameters: tuple[str, ...]
    objective: Objective
    constraints: tuple[Constraint, ...]
    runs: int
    seed: int
    confidence: float
    before: Evaluation
    best: Evaluation
    history: tuple[Evaluation, ...]
    certificates: tuple[Certificate, ...]
    certificate: Certificate | None
    sensitivity: np.ndarray

    @property
    def gains(self) -> dict[str, float]:
        """The chosen gains, by name."""
        return self.best.gains

    @property
    def study(self) -> Study:
        """The study with the chosen gains."""
        return self.base.substitute(**self.gains)

    @property
    def is_certified(self) -> bool:
        """Whether the chosen gains have a certificate that was granted."""
        return self.certificate is not None and self.certificate.is_granted

    @property
    def simulations(self) -> int:
        """Training simulations; a gradient counts as one for the run and one for each gain."""
        return self.history[-1].n_simulations

    def conclusion(self) -> str:
        """What is claimed, in a sentence or two that can be quoted."""
        was = self.before.objective
        change = 100.0 * (self.best.objective / was - 1.0) if was and np.isfinite(was) else np.nan
        changed = f"{change:+.3g} %" if np.isfinite(was) else "it was not known before"
        gains = ", ".join(f"{name} = {value:.6g}" for name, value in self.gains.items())
        found = f"{gains}: {self.objective} is {self.best.objective:.6g} on {self.runs} training runs ({changed})"
        if self.certificate is None:
            return f"TUNED, NOT CERTIFIED: {found}. Training runs are no guarantee: verify with fresh ones."
        failure = max(each.high for each in self.certificate.guarantees)
        shown = (
            f"on {self.certificate.runs} fresh runs each statement fails with a probability of at most {failure:.3g}"
        )
        sure = f"with {100 * self.confidence:g} % confidence over all designs"
        word = "CERTIFIED" if self.is_certified else "NOT CERTIFIED"
        return f"{word}: {found}; {shown}, {sure} (asked for: {self.certificate.risk:g})."

    def table(self) -> dict[str, Any]:
        """The history as columns, a row an evaluation."""
        rows = self.history
        columns: dict[str, Any] = {name: np.array([row.gains[name] for row in rows]) for name in self.parameters}
        columns["objective"] = np.array([row.objective for row in rows])
        for i, constraint in enumerate(self.constraints):
            columns[f"excess of {constraint}"] = np.array([row.excess[i] for row in rows])
        for name in ("lost", "unknown", "inadmissible", "n_simulations", "start", "attempt"):
            columns[name] = np.array([getattr(row, name) for row in rows])
        return columns

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON; `gains` is what `-S @file` reads."""
        return {
            "gains": self.gains,
            "conclusion": self.conclusion(),
            "objective": str(self.objective),
            "constraints": [str(constraint) for constraint in self.constraints],
            "runs": self.runs,
            "seed": self.seed,
            "confidence": self.confidence,
            "before": dataclasses.asdict(self.before),
            "best": dataclasses.asdict(self.best),
            "simulations": self.simulations,
            "certificates": [
                {**dataclasses.asdict(each), "granted": each.is_granted, "optimism": each.optimism}
                for each in self.certificates
            ],
            "sensitivity": {
                name: dict(zip(self._judged, column.tolist(), strict=True))
                for name, column in zip(self.parameters, self.sensitivity.T, strict=True)
            },
        }

    def plot(self, ax: Any = None) -> Any:
        """Objective, constraints and gains along the search, and the sensitivities at its end.

        Args:
            ax: Four matplotlib `Axes` to draw in, in reading order; None for a new figure, which also gets a heading.

        Returns:
            The axes, (4,).
        """
        return plot_tuning(self, ax)

    @property
    def _judged(self) -> list[str]:
        return [str(self.objective), *map(str, (constraint.objective for constraint in self.constraints))]

    def __str__(self) -> str:
        rows = [f"{len(self.history)} evaluations, {self.simulations} simulations in training, seed {self.seed}"]
        rows.append(f"{'':32}{'before':>14}{'tuned':>14}")
        for name in self.parameters:
            rows.append(f"{name:32}{self.before.gains[name]:14.6g}{self.best.gains[name]:14.6g}")
        rows.append(f"{str(self.objective)[:31]:32}{self.before.objective:14.6g}{self.best.objective:14.6g}")
        for i, constraint in enumerate(self.constraints):
            ends = [
                f"{'kept' if e.excess[i] <= KEPT else 'passed'} {e.excess[i]:+.2g}" for e in (self.before, self.best)
            ]
            rows.append(f"{str(constraint)[:31]:32}{ends[0]:>14}{ends[1]:>14}")
        if self.before.lost > 0.0 or self.best.lost > 0.0:
            ends = [f"{100.0 * each.lost:.3g} %" for each in (self.before, self.best)]
            rows.append(f"{'left the funnel, or undecided':32}{ends[0]:>14}{ends[1]:>14}")
        rows += [
            "Derivatives at the tuned gains, percent by percent:",
            f"{'':32}" + "".join(f"{n:>14}" for n in self.parameters),
        ]
        for judged, row in zip(self._judged, self.sensitivity, strict=True):
            rows.append(f"{judged[:31]:32}" + "".join(f"{value:+14.3g}" for value in row))
        if self.certificate is not None:
            rows += ["Certificate", str(self.certificate)]
        return "\n".join([*rows, self.conclusion()])

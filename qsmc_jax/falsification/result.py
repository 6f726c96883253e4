"""The result of `falsify`: the worst scenario found, and what it cost to find it."""

import dataclasses
import functools as ft
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require
from qsmc_jax.display.result import AbstractResult
from qsmc_jax.falsification.adversary import against
from qsmc_jax.falsification.result_plots import plot_falsification
from qsmc_jax.metrics.claims import breached, statement_of
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.trajectory import Trajectory
from qsmc_jax.study.sampling import Table
from qsmc_jax.study.study import Study


@dataclasses.dataclass(frozen=True, repr=False)
class Falsification(AbstractResult):
    """What `falsify` found: a scenario within the study's uncertainty, and how bad it is.

    Nothing is claimed of scenarios that were not simulated: a worse one may exist.

    Attributes:
        study: The study.
        objective: The claim, or the metric, that was made as bad as possible.
        column: The column of the table of runs that tells it: of a claim its margin.
        is_low_worse: Whether small values of it are the worse ones.
        claims: The claims by which the worst scenario is judged.
        budget: Simulations that could be made.
        seed: Seed of the random runs from which it started.
        adversary: How many times the worst disturbance could switch; None with the study's own disturbance.
        settings: Settings of the solves.
        verdict: VIOLATED if the scenario violates a claim by which it is judged, which another way of solving it
            confirms. UNDECIDED if a run seemed to, or came to no verdict, and none was confirmed. Else HELD, which says
            that this scenario held, and nothing of others.
        value: The metric, or the margin, of the worst scenario: of two solves the less bad number; NaN if no run was
            confirmed.
        change: How far the two solves lie apart.
        values: What the worst scenario draws, by name.
        point: Its point of the unit cube.
        simulations: Simulations made; a gradient counts as one, and one for each number it is taken by.
        random_value: The same column of the worst of the random runs at the beginning, not confirmed; NaN if unknown.
        first_violation_at: Simulations after which the first run violated one of the claims; None if none did.
        undecided: Runs that no solve decided.
        unconfirmed: Runs that looked worse, but were not confirmed.
        progress: Simulations and value, each time a run was worse than all before.
        replaced: Names of which nothing depends but the disturbance that an adversary replaced.
        cut: Names whose distributions have no end, which were cut off at far quantiles.
        outside: Probability of what was cut off.
        without_gradient: Why no gradient was used; empty if it was.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> found = qj.falsify(qj.Study(scenario, bandwidth=0.1), "peak_ratio", budget=64)
        >>> found.verdict.name, found.column, found.values["x0"].round(3).tolist()
        ('HELD', 'peak_ratio', [0.9, 0.1])
    """

    study: Study
    objective: str
    column: str
    is_low_worse: bool
    claims: tuple[str, ...]
    budget: int
    seed: int
    adversary: int | None
    settings: SolverSettings
    verdict: Verdict
    value: float
    change: float
    values: Mapping[str, Float[np.ndarray, "..."]]
    point: Float[np.ndarray, " dim"]
    simulations: int
    random_value: float
    first_violation_at: int | None
    undecided: int
    unconfirmed: int
    progress: tuple[tuple[int, float], ...]
    replaced: tuple[str, ...]
    cut: tuple[str, ...]
    outside: float
    without_gradient: str

    @property
    def is_found(self) -> bool:
        """Whether any run was confirmed: else there is no worst scenario."""
        return not math.isnan(self.value) or self.verdict == Verdict.VIOLATED

    @property
    def record(self) -> Record:
        """What is known of the column: its unit, its meaning."""
        return self.study.record_of(self.column)

    @ft.cached_property
    def attacked(self) -> Study:
        """The study whose scenarios were simulated: with an adversary in place of its disturbance, if there is one."""
        return against(self.study, self.adversary)

    def replay(self, *, ts: Float[np.ndarray, " times"] | None = None) -> Trajectory:
        """Solves the worst scenario again, in full.

        Args:
            ts: Times [s] at which to give the signals; None for 2001 evenly spaced.

        Raises:
            InputError: There is none: no run was confirmed.
        """
        require(self.is_found, "There is no scenario to replay: no run was confirmed by another way of solving it.")
        return self.attacked.replay(0, sampling=Table(self.point[None]), ts=ts, settings=self.settings)

    def conclusion(self) -> str:
        """The finding in a sentence or two that can be quoted."""
        if not self.is_found:
            return f"UNDECIDED: of {self.simulations} simulations none was confirmed by another way of solving it."
        value = f"{self.column} = {self.value:.6g}{self._unit}"
        if self.verdict == Verdict.VIOLATED:
            return f"VIOLATED: a scenario within the study's uncertainty {self._broken}; {value}."
        if self.verdict == Verdict.UNDECIDED:
            return f"UNDECIDED: {self._doubts}. The worst that was confirmed has {value}."
        if self.verdict == Verdict.INADMISSIBLE:
            return "INADMISSIBLE: no scenario fulfils the premises."
        return f"NO VIOLATION FOUND in {self.simulations} simulations, which proves none absent; worst: {value}."

    @property
    def _broken(self) -> str:
        return " or ".join(breached(claim) for claim in self.claims)

    @property
    def _doubts(self) -> str:
        looked = f"{self.unconfirmed} runs looked worse but were not confirmed" if self.unconfirmed else ""
        undecided = f"{self.undecided} runs came to no verdict" if self.undecided else ""
        return ", ".join(each for each in (looked, undecided) if each)

    @property
    def _unit(self) -> str:
        return f" {self.record.unit}" if self.record.unit not in ("", "-") else ""

    def table(self) -> dict[str, Any]:
        """The best so far: simulations made and value, a row each time a run was worse than all before."""
        simulations, values = zip(*self.progress, strict=True) if self.progress else ((), ())
        return {"simulations": np.array(simulations, np.int64), self.column: np.array(values, np.float64)}

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        return {
            "verdict": self.verdict.name,
            "conclusion": self.conclusion(),
            "objective": self.objective,
            "column": self.column,
            "meaning": self.record.meaning or statement_of(self.objective),
            "unit": self.record.unit,
            "value": self.value,
            "change": self.change,
            "values": {name: value.tolist() for name, value in self.values.items()},
            "point": self.point.tolist(),
            "simulations": self.simulations,
            "budget": self.budget,
            "first_violation_at": self.first_violation_at,
            "random_value": self.random_value,
            "adversary": self.adversary,
            "claims": list(self.claims),
            "seed": self.seed,
            "undecided": self.undecided,
            "unconfirmed": self.unconfirmed,
            "replaced": list(self.replaced),
            "cut": list(self.cut),
            "outside": self.outside,
            "without_gradient": self.without_gradient,
            "bandwidth": self.study.bandwidth,
            "fixed": {name: value.tolist() for name, value in self.study.values.items()},
            "progress": [list(each) for each in self.progress],
        }

    def plot(self, ax: Any = None) -> Any:
        """The worst so far over the simulations, and the worst of the random runs.

        Args:
            ax: Matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        return plot_falsification(self, ax)

    def __str__(self) -> str:
        rows = [self.conclusion()]
        if self.is_found:
            rows += [f"  {name} = {_short(value)}" for name, value in self.values.items() if name not in self.replaced]
            rows.append(f"Solved another way {self.column} is within {self.change:.2g} of that.")
        random = f"; worst of the random ones at the beginning: {self.random_value:.6g}"
        random = "" if math.isnan(self.random_value) else random
        rows.append(f"{self.simulations} of {self.budget} simulations, seed {self.seed}{random}")
        if self.first_violation_at is not None:
            rows.append(f"First violation after {self.first_violation_at} simulations.")
        if self.cut:
            names = ", ".join(f"`{name}`" for name in self.cut)
            rows.append(
                f"Searched within far quantiles of {names}, which have no end: {self.outside:.2g} of the probability "
                "lies outside."
            )
        if self.without_gradient:
            rows.append(f"Searched without gradients: {self.without_gradient}")
        return "\n".join(rows)


def _short(value: np.ndarray) -> str:
    """A number, or several, to six digits."""
    return ", ".join(f"{each:.6g}" for each in np.ravel(value))

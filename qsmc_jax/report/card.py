"""One page for a study: what is certain, the worst that was found, and how probable a violation is."""

import base64
import dataclasses
import functools as ft
import math
import shlex
from typing import Any, NamedTuple

import jinja2
import numpy as np

from qsmc_jax.base.errors import InputError
from qsmc_jax.campaign.commands import fixed_options, verify_command
from qsmc_jax.display.plotting import ORANGE, as_png, panels
from qsmc_jax.display.result import AbstractResult
from qsmc_jax.falsification.falsify import falsify
from qsmc_jax.falsification.result import Falsification
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.proof.certify import certify
from qsmc_jax.proof.result import Proof
from qsmc_jax.simulation.trajectory import Trajectory
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.study import Study, require_study
from qsmc_jax.verification.result import Verification
from qsmc_jax.verification.verify import verify

# Violation probabilities of which the page tells how wrong the distributions may be.
_BELOW = (0.01, 0.1)
# What a solved run may miss its metrics by, relative to them, and more.
_ERROR = 1e-4


class Bracket(NamedTuple):
    """How large a column gets: the worst random run, the worst that was found, and what no run exceeds.

    Attributes:
        column: The column.
        random: The largest in the random runs that held; NaN if none did.
        attack: The largest in the worst scenario found; NaN if none was confirmed.
        proof: What is certain for all runs; infinite if nothing is proved.
    """

    column: str
    random: float
    attack: float
    proof: float

    @property
    def found(self) -> float:
        """The largest that was seen."""
        return max((each for each in (self.random, self.attack) if not math.isnan(each)), default=math.nan)

    @property
    def part(self) -> float:
        """Which part of what is certain was found: 1 for a bracket without room."""
        return self.found / self.proof


@dataclasses.dataclass(frozen=True, repr=False)
class Card(AbstractResult):
    """What is known of a study: a proof, an attack, and random runs, side by side.

    Attributes:
        study: The study.
        verification: Of random runs.
        attack: The worst scenario that was found.
        proof: What is certain; None for a study that proofs do not cover.
        not_covered: Why not; empty if they do.
        boxes: Boxes that the proof might tell apart.

    Examples:
        It is what `qj.card` returns; each part is a result of its own:

        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> [field.name for field in dataclasses.fields(qj.Card)][:4]
        ['study', 'verification', 'attack', 'proof']
    """

    study: Study
    verification: Verification
    attack: Falsification
    proof: Proof | None
    not_covered: str
    boxes: int

    @property
    def verdict(self) -> Verdict:
        """VIOLATED if a run, random or sought, violates a claim; HELD and UNDECIDED are those of the random runs."""
        return Verdict.VIOLATED if self.attack.verdict == Verdict.VIOLATED else self.verification.verdict

    @ft.cached_property
    def worst_run(self) -> Trajectory | None:
        """The worst scenario that was found, solved again in full; None if no run was confirmed."""
        return self.attack.replay() if self.attack.is_found else None

    @property
    def brackets(self) -> tuple[Bracket, ...]:
        """Peak input and peak ratio, each between what was found and what is certain."""
        worst = None if self.worst_run is None else self.worst_run.metrics
        attack = [math.nan, math.nan] if worst is None else [float(worst.peak_u), float(worst.peak_ratio)]
        certain = (math.inf, math.inf) if self.proof is None else (self.proof.peak_u, self.proof.peak_ratio)
        ratios = [float(each) for each in self.verification.worst["peak_ratio"]]
        random = self.verification.peak_u, max((each for each in ratios if not math.isnan(each)), default=math.nan)
        return tuple(map(Bracket, ("peak_u", "peak_ratio"), random, attack, certain))

    def conclusion(self) -> str:
        """All findings, a sentence each."""
        proved = self.not_covered if self.proof is None else self.proof.conclusion()
        return " ".join((proved, self.attack.conclusion(), self.verification.conclusion()))

    def table(self) -> dict[str, Any]:
        """The brackets, a row each."""
        rows = self.brackets
        return {name: [getattr(row, name) for row in rows] for name in (*Bracket._fields, "part")}

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        not_covered = {"verdict": "NOT_COVERED", "reason": self.not_covered}
        return {
            "verdict": self.verdict.name,
            "conclusion": self.conclusion(),
            "brackets": [{**each._asdict(), "part": each.part} for each in self.brackets],
            "proof": not_covered if self.proof is None else self.proof.summary(),
            "attack": self.attack.summary(),
            "verification": self.verification.summary(),
            "survives": [{"below": below, **self.verification.survives(below)._asdict()} for below in _BELOW],
            "premises": [each._asdict() for each in self.premises],
        }

    @property
    def premises(self) -> "tuple[Premise, ...]":
        """What Theorem 1 asks for, and what is known of it."""
        runs, headline = self.verification.runs, self.verification.headline
        proof = self.proof if self.proof is not None and self.proof.is_proved else None
        seen = f"so in {runs - headline.inadmissible} of {runs} random runs"
        start = "certain for all starts" if proof else seen
        gain = f"certain: |g| >= {proof.least_gain:.6g}" if proof else f"{seen}, at the ends of their steps"
        bound, where = _bound(self.study), "in the nominal scenario, by its class"
        if proof is not None:
            bound, where = proof.disturbance_bound, "whatever is drawn, by its class"
        return (
            Premise("The run starts inside its funnel (C1)", start),
            Premise("The bandwidth is one the funnel comes inside of (C2)", seen),
            Premise("The gain keeps its sign", gain),
            Premise("The disturbance is bounded", f"|d| <= {bound:.6g} {where}"),
        )

    def page(self, study_file: str) -> str:
        """The page, self-contained.

        Args:
            study_file: The file of the study, as commands name it.
        """
        environment = jinja2.Environment(
            loader=jinja2.PackageLoader("qsmc_jax.report", "templates"),
            autoescape=True,
            undefined=jinja2.StrictUndefined,
        )
        environment.filters["short"] = lambda value: f"{value:.5g}"
        return environment.get_template("card.html.j2").render(
            card=self,
            summary=self.summary(),
            study_file=study_file,
            picture=base64.b64encode(as_png(self.plot, dpi=110)).decode(),
            commands=self.commands(study_file),
        )

    def commands(self, study_file: str) -> dict[str, str]:
        """Commands that find the same again, by what they find.

        Args:
            study_file: The file of the study.
        """
        sure, attack = self.verification, self.attack
        values = {name: value.tolist() for name, value in self.study.values.items()}
        against = [] if attack.adversary is None else ["--adversary", attack.adversary]
        sought = ["--of", attack.objective, *against, "--budget", attack.budget, "--seed", attack.seed]
        given = {
            "proof": ["qsmc", "certify", study_file, "--boxes", self.boxes, *fixed_options(values), "--out", "proof"],
            "attack": ["qsmc", "falsify", study_file, *sought, *fixed_options(values)],
            "probability": verify_command(study_file, sure.runs, sure.seed, sure.confidence, values, sure.settings),
        }
        return {name: shlex.join(map(str, words)) for name, words in given.items()}

    def plot(self, ax: Any = None) -> Any:
        """The tubes of the proof, with the worst scenario that was found inside.

        Args:
            ax: Two matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        axes = panels(ax, 2, 1, (8.0, 6.4)) if self.proof is None else self.proof.plot(ax)
        if (run := self.worst_run) is not None:
            label = f"worst found: |u| up to {float(run.metrics.peak_u):.4g}"
            for axis, signal in zip(axes, (run.sigma, run.u), strict=True):
                axis.plot(run.ts, signal, color=ORANGE, lw=1.2, label=label)
                axis.legend(loc="best", fontsize=8)
        if self.proof is None:
            axes[0].set(ylabel="sliding variable", title=self.verdict.name)
            axes[1].set(xlabel="t [s]", ylabel="u")
        return axes

    def __str__(self) -> str:
        rows = [self.verdict.name, *([self.not_covered] if self.proof is None else [self.proof.conclusion()])]
        rows += [self.attack.conclusion(), self.verification.conclusion(), ""]
        rows += [f"{'':12}{'random runs':>14}{'worst found':>14}{'certain':>14}{'part found':>12}"]
        rows += [
            f"{each.column:12}{each.random:14.6g}{each.attack:14.6g}{each.proof:14.6g}{each.part:12.3g}"
            for each in self.brackets
        ]
        return "\n".join(rows)


class Premise(NamedTuple):
    """A premise of the theorem.

    Attributes:
        premise: What it asks for.
        status: What is known of it.
    """

    premise: str
    status: str


def card(
    study: Study,
    runs: int = 1000,
    *,
    budget: int = 400,
    boxes: int = 64,
    seed: int = 0,
    confidence: float = 0.95,
    progress: Progress | None = None,
) -> Card:
    """What is known of a study on one page: a proof, an attack on the peak input, and random runs.

    The three answer different questions: what is certain for all runs that the study allows, how bad a run was found
    among them, under the worst constant disturbance within its bound, and how probable a violation is. The peak input
    lies between the second and the first.

    Args:
        study: The study.
        runs: Random runs, at least 1.
        budget: Simulations of the attack at most.
        boxes: Boxes that the proof tells apart at most.
        seed: Seed of the random runs, and of those that the attack starts from.
        confidence: Confidence of each interval.
        progress: Called as `progress(done, runs)` while the random runs are solved.

    Raises:
        InputError: An argument is out of range.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.4, 0.6, shape=(2,)), t1=5.0)
        >>> card = qj.card(qj.Study(scenario, bandwidth=0.1), runs=64, budget=64, boxes=1)
        >>> peak = card.brackets[0]
        >>> card.verdict.name, peak.random <= peak.attack <= peak.proof
        ('HELD', True)
    """
    require_study(study)
    try:
        proof, not_covered = certify(study, boxes), ""
    except InputError as error:
        proof, not_covered = None, str(error)
    bound = proof.disturbance_bound if proof is not None and proof.is_proved else _bound(study)
    adversary = 0 if bound > 0.0 else None
    attack = falsify(study, "peak_u", budget=budget, seed=seed, adversary=adversary)
    verification = verify(study, runs, seed, confidence, progress=progress)
    made = Card(study, verification, attack, proof, not_covered, boxes)
    violated = verification.headline.violated if proof is not None and proof.is_proved else 0
    _require_consistent(made.brackets, violated)
    return made


def _require_consistent(brackets: tuple[Bracket, ...], violated: int) -> None:
    """Raises where runs contradict the proof: then one of the two is wrong, and nothing may be told."""
    beyond = [
        f"{each.column} = {each.found:.17g} > {each.proof:.17g}"
        for each in brackets
        if each.found > (1.0 + _ERROR) * each.proof
    ]
    told = ", ".join(beyond + [f"{violated} runs leave the funnel"] * (violated > 0))
    if told:
        raise RuntimeError(f"A run contradicts the proof: {told}. Please report this study.")


def _bound(study: Study) -> float:
    """The largest bound of a disturbance in the nominal scenario."""
    return max(float(np.asarray(each.disturbance.bound)) for each in study.nominal.loop.channels)

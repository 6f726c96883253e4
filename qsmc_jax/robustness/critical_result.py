"""The result of `critical_value`: the last value shown to be safe, and what that claims."""

import dataclasses
from typing import Any, Literal, TypeAlias

import numpy as np

from qsmc_jax.display.result import AbstractResult
from qsmc_jax.metrics.claims import breaching
from qsmc_jax.robustness.critical_plots import plot_critical
from qsmc_jax.study.study import Study
from qsmc_jax.verification.counts import HEADING, Counts

Side: TypeAlias = Literal["largest", "smallest"]
Finding: TypeAlias = Literal["below", "above", "open"]


@dataclasses.dataclass(frozen=True)
class CriticalTest(Counts):
    """One value of the name against the probability.

    Attributes:
        value: The value.
        runs: Runs made.
        below: The probability to be compared with.
    """

    value: float
    runs: int
    below: float

    @property
    def finding(self) -> Finding:
        """What the interval says: "below" or "above" the probability, else "open"."""
        if self.high < self.below:
            return "below"
        return "above" if self.low > self.below else "open"

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts."""
        return {**dataclasses.asdict(self), "finding": self.finding}


@dataclasses.dataclass(frozen=True, repr=False)
class CriticalValue(AbstractResult):
    """What `critical_value` found.

    Attributes:
        study: The study.
        name: The name whose value was searched.
        below: The violation probability that was to be shown.
        confidence: That all findings are right together.
        seed: Seed of the runs.
        between: The two ends of the search.
        side: "largest" if small values are safe, "smallest" if large ones are; None if the ends did not tell.
        confidence_each: Confidence of the interval at each look of each test.
        looks: Numbers of runs at which a test looked.
        tests: Every test made, in order; the two ends first.
        claim: The claim whose violations were counted.

    Examples:
        >>> import equinox as eqx
        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> def scenario(draw):  # the gain has the wrong sign with probability p
        ...     p = draw.parameter("p", 0.0, bounds=(0.0, 1.0))
        ...     sign = jnp.where(draw.uniform("coin", 0.0, 1.0) < p, -1.0, 1.0)
        ...     loop = eqx.tree_at(lambda loop: loop.control.gain_sign, qj.paper.example1(), sign)
        ...     return qj.Scenario(loop, x0=[0.9, 0.9], t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> found = qj.critical_value(study, "p", below=0.4, steps=0, block=64)
        >>> found.is_found, [(test.value, test.finding) for test in found.tests]
        (True, [(0.0, 'below'), (1.0, 'above')])
    """

    study: Study
    name: str
    below: float
    confidence: float
    seed: int
    between: tuple[float, float]
    side: Side | None
    confidence_each: float
    looks: tuple[int, ...]
    tests: tuple[CriticalTest, ...]
    claim: str = "funnel"

    @property
    def shown(self) -> float | None:
        """The last value shown below, from the safe end on; None if the safe end was not shown below or not found."""
        if self.side is None:
            return None
        safe = self.tests[0 if self.side == "largest" else 1]
        if safe.finding != "below":
            return None
        values = [test.value for test in self.tests if test.finding == "below"]
        return max(values) if self.side == "largest" else min(values)

    @property
    def not_shown(self) -> float | None:
        """The first value beyond `shown` that was not shown below; None if there is none."""
        if self.shown is None:
            return None
        values = [test.value for test in self.tests if test.finding != "below"]
        return (min if self.side == "largest" else max)(values, default=None)

    @property
    def is_found(self) -> bool:
        """Whether a value was shown below at the safe end, or at both ends."""
        return self.shown is not None or all(test.finding == "below" for test in self.tests)

    @property
    def runs(self) -> int:
        """Runs of all tests together."""
        return sum(test.runs for test in self.tests)

    def conclusion(self) -> str:
        """What is claimed, and what is not, in sentences that can be quoted."""
        sure = f"with {100 * self.confidence:g} % confidence over the whole search"
        small = f"the probability of {breaching(self.claim)} is below {self.below:g}"
        shown, other = self.shown, self.not_shown
        if not any(test.finding == "below" for test in self.tests):
            return f"NOT FOUND: neither at {self._at(0)} nor at {self._at(1)} was it shown that {small}."
        if not self.is_found:
            safe, other_end = (0, 1) if self.side == "largest" else (1, 0)
            return (
                f"NOT FOUND: the {self.side} value was asked for, but at {self._at(safe)} it was not shown that "
                f"{small}; at {self._at(other_end)} it was. Try the other `side`."
            )
        if other is None:
            return f"SAFE AT BOTH ENDS: at {self._at(0)} and at {self._at(1)} {small}, {sure}. {self._nothing_else()}"
        beyond = next(test for test in self.tests if test.value == other)
        reason = "it is above" if beyond.finding == "above" else f"{beyond.runs} runs leave it open"
        order = "rises" if self.side == "largest" else "falls"
        return (
            f"FOUND: at {self.name} = {shown:.6g} {small}, {sure}. At {other:.6g} this was not shown ({reason}). "
            f"{self._nothing_else()} That {shown:.6g} is the {self.side} safe value, up to the distance of these two, "
            f"assumes that the probability {order} with `{self.name}`."
        )

    def table(self) -> dict[str, Any]:
        """The tests as columns, a row a test."""
        rows = [test.summary() for test in self.tests]
        return {key: np.array([row[key] for row in rows]) for key in rows[0]}

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        return {
            "name": self.name,
            "claim": self.claim,
            "below": self.below,
            "shown": self.shown,
            "not_shown": self.not_shown,
            "side": self.side,
            "conclusion": self.conclusion(),
            "confidence": self.confidence,
            "confidence_each": self.confidence_each,
            "looks": list(self.looks),
            "seed": self.seed,
            "between": list(self.between),
            "bandwidth": self.study.bandwidth,
            "values": {name: value.tolist() for name, value in self.study.values.items()},
            "runs": self.runs,
            "tests": [test.summary() for test in self.tests],
        }

    def plot(self, ax: Any = None) -> Any:
        """Every test with its interval, and the probability that was to be shown.

        Args:
            ax: Matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        return plot_critical(self, ax)

    def __str__(self) -> str:
        rows = [f"{self.runs} runs, seed {self.seed}, each test with its own"]
        rows.append(f"{self.name:>14}  finding{HEADING}   interval")
        rows += [f"{test.value:14.6g}  {test.finding:7}{test.row()}" for test in self.tests]
        return "\n".join((*rows, self.conclusion()))

    def _at(self, end: int) -> str:
        return f"{self.name} = {self.between[end]:.6g}"

    def _nothing_else(self) -> str:
        return "Nothing is claimed of any value that was not tested."

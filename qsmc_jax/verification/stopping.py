"""Rules by which a verification stops before its last run; each is valid however often one looks."""

import abc
import dataclasses

from qsmc_jax.base.checks import require
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.statistics.anytime import confidence_sequence, sequential_test

# Runs between two looks of a rule; a run folder, which looks after each of its files, has as many in one.
LOOK = 32_768


@dataclasses.dataclass(frozen=True)
class AbstractRule(abc.ABC):
    """When to stop. Looked at after each block of runs, in the order of the blocks, never within one.

    Examples:
        A rule that stops at the first violation, as you may write it:

        >>> import qsmc_jax as qj
        >>> class FirstViolation(qj.stopping.AbstractRule):
        ...     def decision(self, violated, undecided, total, confidence):
        ...         return "a run left the funnel" if violated else None
        >>> FirstViolation().decision(1, 0, 100, 0.95)
        'a run left the funnel'
    """

    @abc.abstractmethod
    def decision(self, violated: int, undecided: int, total: int, confidence: float) -> str | None:
        """What can be said, or None while more runs are needed. Of the funnel claim; with requirements, of all claims.

        Args:
            violated: Runs that left the funnel, or violated any claim.
            undecided: Runs without a verdict.
            total: Runs so far, without the inadmissible.
            confidence: Confidence of what is said.
        """


@dataclasses.dataclass(frozen=True)
class UntilWidth(AbstractRule):
    """Stops when the interval of the violation probability is no wider than this.

    Attributes:
        width: Difference of its ends, strictly between 0 and 1.

    Examples:
        >>> import qsmc_jax as qj
        >>> rule = qj.stopping.UntilWidth(0.01)
        >>> rule.decision(violated=0, undecided=0, total=100, confidence=0.95)
        >>> rule.decision(violated=0, undecided=0, total=1000, confidence=0.95)
        'the interval is no wider than 0.01'
    """

    width: float

    def __post_init__(self):
        _require_fraction("width", self.width)

    def decision(self, violated: int, undecided: int, total: int, confidence: float) -> str | None:
        low, high = confidence_sequence(violated, undecided, total, confidence)
        return f"the interval is no wider than {self.width:g}" if high - low <= self.width else None


@dataclasses.dataclass(frozen=True)
class UntilBelow(AbstractRule):
    """Stops when the violation probability is known to be at most this, or to be above.

    Attributes:
        probability: What is to be shown, strictly between 0 and 1.

    Examples:
        >>> import qsmc_jax as qj
        >>> rule = qj.stopping.UntilBelow(0.01)
        >>> rule.decision(violated=0, undecided=0, total=1000, confidence=0.95)
        'the violation probability is at most 0.01'
        >>> rule.decision(violated=50, undecided=0, total=1000, confidence=0.95)
        'the violation probability is above 0.01'
    """

    probability: float

    def __post_init__(self):
        _require_fraction("probability", self.probability)

    def decision(self, violated: int, undecided: int, total: int, confidence: float) -> str | None:
        low, high = confidence_sequence(violated, undecided, total, confidence)
        if high <= self.probability:
            return f"the violation probability is at most {self.probability:g}"
        return f"the violation probability is above {self.probability:g}" if low > self.probability else None


@dataclasses.dataclass(frozen=True)
class SequentialTest(AbstractRule):
    """Wald's sequential probability ratio test with an indifference region; each error has the risk 1 - confidence.

    Attributes:
        probability: p0, that is to be refuted, strictly between 0 and 1.
        alternative: p1, strictly between 0 and p0; between the two either answer is right.

    Examples:
        >>> import qsmc_jax as qj
        >>> rule = qj.stopping.SequentialTest(probability=0.02, alternative=0.01)
        >>> rule.decision(violated=0, undecided=0, total=1000, confidence=0.95)
        'the test accepts that the violation probability is below 0.02'
    """

    probability: float
    alternative: float

    def __post_init__(self):
        _require_fraction("probability", self.probability)
        require(
            0.0 < self.alternative < self.probability,
            f"Argument `alternative` must lie strictly between 0 and {self.probability:g}, but is {self.alternative}.",
        )

    def decision(self, violated: int, undecided: int, total: int, confidence: float) -> str | None:
        require(confidence > 0.5, f"Argument `confidence` of a sequential test must be above 0.5, but is {confidence}.")
        bounds = self.probability, self.alternative, 1.0 - confidence
        if sequential_test(violated + undecided, total, *bounds) >= 1.0:
            return f"the test accepts that the violation probability is below {self.probability:g}"
        if sequential_test(violated, total, *bounds) <= -1.0:
            return f"the test accepts that the violation probability is above {self.alternative:g}"
        return None


def decision_of(rule: AbstractRule | None, counts: dict[Verdict, int], confidence: float) -> str | None:
    """What the rule says of the counts of the funnel claim, or of all claims together; None without a rule.

    Args:
        rule: The rule, or None.
        counts: Runs with each verdict.
        confidence: Confidence of what is said.

    Examples:
        >>> import qsmc_jax as qj
        >>> counts = {qj.Verdict.HELD: 1000, qj.Verdict.VIOLATED: 0, qj.Verdict.UNDECIDED: 0}
        >>> qj.stopping.decision_of(qj.stopping.UntilBelow(0.01), counts, confidence=0.95)
        'the violation probability is at most 0.01'
    """
    if rule is None:
        return None
    violated, undecided = counts[Verdict.VIOLATED], counts[Verdict.UNDECIDED]
    return rule.decision(violated, undecided, violated + undecided + counts[Verdict.HELD], confidence)


def _require_fraction(name: str, value: float) -> None:
    require(0.0 < value < 1.0, f"Argument `{name}` of a stopping rule must lie in (0, 1), but is {value}.")

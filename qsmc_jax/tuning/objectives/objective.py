"""Sums of statistics over runs, and their comparisons with a number."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require
from qsmc_jax.tuning.rows import BEYOND, LOSS, mean_loss
from qsmc_jax.tuning.terms import METRICS as METRICS
from qsmc_jax.tuning.terms import Term


@dataclasses.dataclass(frozen=True)
class Objective:
    """A weighted sum of statistics over runs; add, scale and compare it like a number.

    Attributes:
        terms: The summands.

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> objective = qj.objectives.mean("peak_u") + 2.0 * qj.objectives.worst("peak_u")
        >>> str(objective), objective.evaluate(columns)[0]
        ('mean(peak_u) + 2 * worst(peak_u)', 15.0)
    """

    terms: tuple[Term, ...]

    @property
    def metrics(self) -> tuple[str, ...]:
        """The columns it needs."""
        return tuple(dict.fromkeys(term.metric for term in self.terms))

    def evaluate(
        self, columns: Mapping[str, Float[np.ndarray, " runs"]], smoothing: float = 0.0
    ) -> tuple[float, dict[str, np.ndarray]]:
        """Its value over the runs of a table, and its derivative by each entry of each column.

        Args:
            columns: Columns by name; an entry that is not finite is a metric that is not known.
            smoothing: Width of the smooth maximum in place of `worst` and `least`, in units of the column's standard
                deviation; 0 for the maximum itself.

        Returns:
            The value, infinite if a metric is not known in some run or there is no run; and the derivative of what is
            known.
        """
        value, weights = self.among_known(columns, smoothing)
        return value if self.is_known(columns) else np.inf, weights

    def among_known(
        self, columns: Mapping[str, Float[np.ndarray, " runs"]], smoothing: float = 0.0
    ) -> tuple[float, dict[str, np.ndarray]]:
        """The same over the entries that are known, a finite number for a descent to go by; 0 if there are none.

        Args:
            columns: As for `evaluate`.
            smoothing: As for `evaluate`.
        """
        total, weights = 0.0, {metric: np.zeros(len(columns[metric])) for metric in self.metrics}
        for term in self.terms:
            value, slope = term.evaluate(columns[term.metric], smoothing)
            total += value
            weights[term.metric] += slope
        return total, weights

    def is_known(self, columns: Mapping[str, Float[np.ndarray, " runs"]]) -> bool:
        """Whether there are runs, and every one of them has the metrics that it needs.

        Args:
            columns: As for `evaluate`.
        """
        return all(columns[metric].size > 0 and bool(np.isfinite(columns[metric]).all()) for metric in self.metrics)

    def __add__(self, other: "Objective") -> "Objective":
        return Objective(self.terms + other.terms)

    def __sub__(self, other: "Objective") -> "Objective":
        return self + (-1.0) * other

    def __mul__(self, factor: float | int) -> "Objective":
        return Objective(tuple(dataclasses.replace(t, weight=t.weight * float(factor)) for t in self.terms))

    __rmul__ = __mul__

    def __le__(self, bound: float | int) -> "Constraint":
        return Constraint(self, float(bound), 1)

    def __ge__(self, bound: float | int) -> "Constraint":
        return Constraint(self, float(bound), -1)

    def __str__(self) -> str:
        return " + ".join(map(str, self.terms)).replace("+ -", "- ")


@dataclasses.dataclass(frozen=True)
class Constraint:
    """An objective that must not pass a bound.

    Attributes:
        objective: What is bounded.
        bound: The bound.
        side: 1 for an upper bound, -1 for a lower one.

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> constraint = qj.objectives.worst("peak_u") <= 5.0
        >>> str(constraint), round(constraint.excess(columns)[0], 3)
        ('worst(peak_u) <= 5', 0.2)
    """

    objective: Objective
    bound: float
    side: int

    def __post_init__(self):
        require(bool(np.isfinite(self.bound)), f"The bound of a constraint must be finite, but is {self.bound}.")

    def excess(self, columns: Mapping[str, np.ndarray], smoothing: float = 0.0) -> tuple[float, dict[str, np.ndarray]]:
        """Its violation, in units of the bound (of 1 for a bound of 0), and the derivative; fine if <= 0.

        Args:
            columns: Columns by name; an entry that is not finite is a metric that is not known.
            smoothing: As for `Objective.evaluate`.

        Returns:
            The excess, infinite if a metric is not known in some run, but for `violation`, which counts such runs; and
            the derivative of what is known.
        """
        if self.bounds_violation:
            return self._violation(columns, smoothing)
        excess, weights = self._scaled(*self.objective.among_known(columns, smoothing))
        return excess if self.objective.is_known(columns) else np.inf, weights

    def lead(self, columns: Mapping[str, np.ndarray], smoothing: float = 0.0) -> tuple[float, dict[str, np.ndarray]]:
        """The same for a descent: finite, and where a metric is not known positive, with what leads back to known ones.

        Args:
            columns: Columns by name; `LOSS`, if it is among them, as `counted` has it.
            smoothing: As for `Objective.evaluate`.
        """
        excess, weights = self.excess(columns, smoothing)
        if np.isfinite(excess):
            return excess, weights
        excess, _ = self._scaled(*self.objective.among_known(columns, smoothing))
        loss, by_loss = mean_loss(columns, self.objective.metrics)
        known = weights if excess > 0.0 else {}
        return max(excess, 0.0) + loss, {**known, **by_loss}

    @property
    def bounds_violation(self) -> bool:
        """Whether it is `violation <= p`, or the worst of `peak_ratio` against 1, which is the same for every p."""
        only = self.objective.terms[0]
        is_peak = only.metric == "peak_ratio" and only.weight == 1.0 and only.statistic in ("cvar", "worst")
        return len(self.objective.terms) == 1 and is_peak and self.bound == 1.0 and self.side > 0

    @property
    def implies_funnel(self) -> bool:
        """Whether a run within the bound has stayed in its funnel."""
        level = {"peak_ratio": self.bound <= 1.0, "margin": self.bound >= 0.0, "peak_excess": self.bound <= 0.0}
        return self.per_run is not None and level.get(self.per_run, False)

    def _scaled(self, value: float, weights: dict[str, np.ndarray]) -> tuple[float, dict[str, np.ndarray]]:
        scale = self.side / (abs(self.bound) or 1.0)
        return scale * (value - self.bound), {metric: scale * weight for metric, weight in weights.items()}

    def _violation(self, columns: Mapping[str, np.ndarray], smoothing: float) -> tuple[float, dict[str, np.ndarray]]:
        """Every run that left counts as clearly beyond 1, and the more of its horizon it lost the further beyond."""
        peak = columns["peak_ratio"]
        is_lost, loss = ~np.isfinite(peak), np.maximum(columns.get(LOSS, 0.0), BEYOND)
        counted = np.where(is_lost, 1.0 + loss, peak + np.where(peak >= 1.0, BEYOND, 0.0))
        if not counted.size:
            return np.inf, {"peak_ratio": counted}
        value, weights = self._scaled(*self.objective.among_known({"peak_ratio": counted}, smoothing))
        weight = weights["peak_ratio"]
        return value, {"peak_ratio": np.where(is_lost, 0.0, weight), LOSS: np.where(is_lost, weight, 0.0)}

    @property
    def per_run(self) -> str | None:
        """The column that it bounds in all runs or most, None if it is about a mean, a sum or a few."""
        only = self.objective.terms[0]
        is_tail = only.statistic == "worst" or (only.statistic == "cvar" and only.level >= 0.5)
        is_bound = (self.side > 0 and is_tail) or (self.side < 0 and only.statistic == "least")
        return only.metric if len(self.objective.terms) == 1 and only.weight == 1.0 and is_bound else None

    def __str__(self) -> str:
        return f"{self.objective} {'<=' if self.side > 0 else '>='} {self.bound:.12g}"

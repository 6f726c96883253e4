"""A statistic of one column over runs, weighted: what objectives are sums of."""

import dataclasses
import re
from collections.abc import Callable
from typing import Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require
from qsmc_jax.metrics.standard import catalogue

Statistic: TypeAlias = Literal["mean", "cvar", "worst", "least"]

# Columns with a derivative by the gains. Times and counts to the step, such as `settle_time`, have none.
METRICS = tuple(name for name, record in catalogue().items() if record.has_gradient and name != "peak_error")
_NO_METRICS = set(catalogue()) - set(METRICS)
_NAME = re.compile(r"peak_error\[\d+\]|[^()\[\]]+")


@dataclasses.dataclass(frozen=True)
class Term:
    """A statistic of one column times a weight.

    Attributes:
        statistic: "mean", "cvar" (mean of the worst part, the largest), "worst" (largest) or "least" (smallest).
        metric: The column.
        weight: What it is multiplied by.
        level: Of "cvar": the part of the runs that is left out, in [0, 1).

    Examples:
        >>> from qsmc_jax.tuning.terms import Term
        >>> str(Term("cvar", "peak_u", weight=2.0, level=0.9))
        '2 * cvar(peak_u, 0.9)'
    """

    statistic: Statistic
    metric: str
    weight: float = 1.0
    level: float = 0.0

    def __post_init__(self):
        # A study may have metrics of its own, by names that are known to it.
        is_refused = self.metric in _NO_METRICS or not _NAME.fullmatch(self.metric)
        require(
            not is_refused,
            f"Argument `metric` must be peak_error[i] or one of {', '.join(METRICS)}, but is `{self.metric}`.",
        )
        require(bool(0.0 <= self.level < 1.0), f"Argument `level` must lie in [0, 1), but is {self.level}.")
        require(bool(np.isfinite(self.weight)), f"A weight must be finite, but is {self.weight}.")

    def evaluate(self, values: Float[np.ndarray, " runs"], smoothing: float) -> tuple[float, np.ndarray]:
        """The weighted statistic of the values that are known, and its derivative by each.

        Args:
            values: The column; entries that are not finite are left to `Objective.evaluate`, which counts them.
            smoothing: As for `Objective.evaluate`.

        Returns:
            Statistic and derivative; 0 if no value is known.
        """
        weights = np.zeros(len(values))
        known = np.flatnonzero(np.isfinite(values))
        if not len(known):
            return 0.0, weights
        value, weights[known] = _STATISTICS[self.statistic](values[known], self.level, smoothing)
        return self.weight * value, self.weight * weights

    def __str__(self) -> str:
        level = f", {self.level:.12g}" if self.statistic == "cvar" else ""
        weight = "" if self.weight == 1.0 else f"{self.weight:.12g} * "
        return f"{weight}{self.statistic}({self.metric}{level})"


# Part of a number below which a difference to another may be rounding.
_ROUNDING = 1e-12


def _mean(values: np.ndarray, level: float, smoothing: float) -> tuple[float, np.ndarray]:
    return float(values.mean()), np.full(len(values), 1.0 / len(values))


def _cvar(values: np.ndarray, level: float, smoothing: float) -> tuple[float, np.ndarray]:
    """The largest get weight 1 / ((1 - level) N) each, the last of them what is left."""
    each = 1.0 / ((1.0 - level) * len(values))
    before = each * np.arange(len(values))
    weights = np.empty(len(values))
    weights[np.argsort(-values, kind="stable")] = np.clip(1.0 - before, 0.0, each)
    return float(weights @ values), weights


def _worst(values: np.ndarray, level: float, smoothing: float) -> tuple[float, np.ndarray]:
    """The maximum, or the logarithm of the sum of exponentials, which is above it."""
    width = smoothing * float(values.std())
    top = float(values.max())
    # Of numbers that are equal but for rounding, so is the standard deviation nothing but rounding.
    if width == 0.0 or np.ptp(values) <= _ROUNDING * np.abs(values).max():
        return top, np.eye(len(values))[int(values.argmax())]
    powers = np.exp((values - top) / width)
    weights, logarithm = powers / powers.sum(), float(np.log(powers.sum()))
    # The width is made of the values too.
    by_width = logarithm - float(weights @ (values - top)) / width
    width_by_values = smoothing * (values - values.mean()) / (len(values) * values.std())
    return top + width * logarithm, weights + by_width * width_by_values


def _least(values: np.ndarray, level: float, smoothing: float) -> tuple[float, np.ndarray]:
    value, weights = _worst(-values, level, smoothing)
    return -value, weights


_STATISTICS: dict[str, Callable[..., tuple[float, np.ndarray]]] = {
    "mean": _mean,
    "cvar": _cvar,
    "worst": _worst,
    "least": _least,
}

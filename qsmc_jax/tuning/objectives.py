"""What to make small, and what to keep: statistics over runs of a column of their table, to be added and compared.

`cvar("peak_error[0]", 0.9) + 0.01 * mean("energy_u")` is an objective; `worst("peak_u") <= 20` is a constraint.
"""

import ast
import dataclasses
from collections.abc import Mapping
from typing import Any, Literal, TypeAlias, TypeVar

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import nearest, require

_Kind = TypeVar("_Kind")
Statistic: TypeAlias = Literal["mean", "cvar", "worst", "least"]

# Columns with a derivative by the gains. Times and counts to the step, such as `settle_time`, have none.
METRICS = (
    "peak_ratio",
    "margin",
    "peak_u",
    "reach_time",
    "rms_error",
    "energy_u",
    "total_variation_u",
    "recovery_time",
    "peak_excess",
    "excess_variation_u",
    "high_frequency_ratio",
    "peak_rate_u",
)


@dataclasses.dataclass(frozen=True)
class Term:
    """A statistic of one column times a weight.

    Attributes:
        statistic: "mean", "cvar" (mean of the worst part, the largest), "worst" (largest) or "least" (smallest).
        metric: The column.
        weight: What it is multiplied by.
        level: Of "cvar": the part of the runs that is left out, in [0, 1).

    Examples:
        >>> import qsmc_jax as qj
        >>> str(qj.objectives.Term("cvar", "peak_u", weight=2.0, level=0.9))
        '2 * cvar(peak_u, 0.9)'
    """

    statistic: Statistic
    metric: str
    weight: float = 1.0
    level: float = 0.0

    def __post_init__(self):
        is_known = self.metric in METRICS or self.metric.startswith("peak_error[")
        if not is_known:
            known = f"peak_error[i] or one of {', '.join(METRICS)}"
            hint = nearest(self.metric, METRICS)
            raise ValueError(f"Argument `metric` must be {known}, but is `{self.metric}`.{hint}")
        require(bool(0.0 <= self.level < 1.0), f"Argument `level` must lie in [0, 1), but is {self.level}.")
        require(bool(np.isfinite(self.weight)), f"A weight must be finite, but is {self.weight}.")

    def evaluate(self, values: Float[np.ndarray, " runs"], smoothing: float) -> tuple[float, np.ndarray]:
        """The weighted statistic of the known values, and its derivative by each.

        Args:
            values: The column; entries that are not finite are passed over.
            smoothing: As for `Objective.evaluate`.
        """
        weights = np.zeros(len(values))
        known = np.flatnonzero(np.isfinite(values))
        if not len(known):
            return np.nan, weights
        value, weights[known] = _STATISTICS[self.statistic](values[known], self.level, smoothing)
        return self.weight * value, self.weight * weights

    def __str__(self) -> str:
        level = f", {self.level:.12g}" if self.statistic == "cvar" else ""
        weight = "" if self.weight == 1.0 else f"{self.weight:.12g} * "
        return f"{weight}{self.statistic}({self.metric}{level})"


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
            columns: Columns by name; entries that are not finite are passed over.
            smoothing: Width of the smooth maximum in place of `worst` and `least`, in units of the column's standard
                deviation; 0 for the maximum itself.
        """
        total, weights = 0.0, {metric: np.zeros(len(columns[metric])) for metric in self.metrics}
        for term in self.terms:
            value, slope = term.evaluate(columns[term.metric], smoothing)
            total += value
            weights[term.metric] += slope
        return total, weights

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
        """How far it is passed, in units of the bound (of 1 for a bound of 0), and the derivative; fine if <= 0.

        Args:
            columns: Columns by name.
            smoothing: As for `Objective.evaluate`.
        """
        value, weights = self.objective.evaluate(columns, smoothing)
        scale = self.side / (abs(self.bound) or 1.0)
        return scale * (value - self.bound), {metric: scale * weight for metric, weight in weights.items()}

    @property
    def per_run(self) -> str | None:
        """The column that it bounds in all runs or most, None if it is about a mean, a sum or a few."""
        only = self.objective.terms[0]
        is_tail = only.statistic == "worst" or (only.statistic == "cvar" and only.level >= 0.5)
        is_bound = (self.side > 0 and is_tail) or (self.side < 0 and only.statistic == "least")
        return only.metric if len(self.objective.terms) == 1 and only.weight == 1.0 and is_bound else None

    def __str__(self) -> str:
        return f"{self.objective} {'<=' if self.side > 0 else '>='} {self.bound:.12g}"


def mean(metric: str) -> Objective:
    """The mean of a column over the runs.

    Args:
        metric: The column, one of `METRICS` or `peak_error[i]`.

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> qj.objectives.mean("peak_u").evaluate(columns)[0]
        3.0
    """
    return Objective((Term("mean", metric),))


def cvar(metric: str, level: float = 0.9) -> Objective:
    """The mean of the largest 1 - `level` of a column: conditional value at risk.

    Args:
        metric: The column, one of `METRICS` or `peak_error[i]`.
        level: Part of the runs that is left out, in [0, 1).

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> qj.objectives.cvar("peak_u", 0.5).evaluate(columns)[0]
        4.5

    Source: Rockafellar and Uryasev, J. Risk 2 (2000).
    """
    return Objective((Term("cvar", metric, level=level),))


def worst(metric: str) -> Objective:
    """The largest of a column.

    Args:
        metric: The column, one of `METRICS` or `peak_error[i]`.

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> qj.objectives.worst("peak_u").evaluate(columns)[0]
        6.0
    """
    return Objective((Term("worst", metric),))


def least(metric: str) -> Objective:
    """The smallest of a column.

    Args:
        metric: The column, one of `METRICS` or `peak_error[i]`.

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> columns = {"peak_u": np.array([1.0, 2.0, 3.0, 6.0])}
        >>> qj.objectives.least("peak_u").evaluate(columns)[0]
        1.0
    """
    return Objective((Term("least", metric),))


def violation(probability: float | int) -> Constraint:
    r"""A constraint that implies a probability of at most `probability` of leaving the funnel, over the training runs.

    Over the runs whose figures are known, $\mathrm{CVaR}_{1-p}(\sup|\sigma|/\rho) \le 1$ implies
    $P(\sup|\sigma|/\rho > 1) \le p$, and has a derivative.

    Args:
        probability: What it may be at most, above 0.

    Examples:
        >>> import qsmc_jax as qj
        >>> str(qj.objectives.violation(0.01))
        'cvar(peak_ratio, 0.99) <= 1'
    """
    return cvar("peak_ratio", 1.0 - probability) <= 1.0


def parse_objective(text: "str | Objective") -> Objective:
    """An objective from a text such as `cvar(peak_error[0], 0.9) + 0.01 * mean(energy_u)`.

    Args:
        text: The text; an objective is given back as it is.

    Raises:
        ValueError: The text is not of that form.

    Examples:
        >>> import qsmc_jax as qj
        >>> str(qj.objectives.parse_objective("cvar(peak_error[0], 0.9) - 2 * mean(energy_u)"))
        'cvar(peak_error[0], 0.9) - 2 * mean(energy_u)'
    """
    return _parsed(text, Objective, f"Argument `objective` must be a sum of statistics, but is `{text}`.")


def parse_constraint(text: "str | Constraint") -> Constraint:
    """A constraint from a text such as `worst(peak_u) <= 20` or `violation <= 0.01`.

    Args:
        text: The text; a constraint is given back as it is.

    Raises:
        ValueError: The text is not of that form.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.objectives.parse_constraint("worst(peak_u) <= 20").bound
        20.0
    """
    return _parsed(text, Constraint, f"Argument `subject_to` must be a comparison with a number, not `{text}`.")


_FUNCTIONS: dict[str, Any] = {"mean": mean, "cvar": cvar, "worst": worst, "least": least}


def _parsed(text: "str | _Kind", kind: type[_Kind], message: str) -> _Kind:
    """What the text says, which must be of that kind."""
    if isinstance(text, kind):
        return text
    argument = "objective" if kind is Objective else "subject_to"
    try:
        made = _read(ast.parse(str(text).strip(), mode="eval").body)
    except (SyntaxError, TypeError, KeyError, AttributeError, OverflowError, RecursionError):
        raise ValueError(
            f"Argument `{argument}` must be made of mean(m), cvar(m, level), worst(m) and least(m), such as "
            f"cvar(peak_error[0], 0.9) + 0.01 * mean(energy_u) or worst(peak_u) <= 20, but is `{text}`."
        ) from None
    if not isinstance(made, kind):
        raise ValueError(message)
    return made


def _read(node: ast.AST) -> Any:
    """The value of an expression of numbers, statistics, +, -, * and one comparison; nothing else is evaluated."""
    match node:
        case ast.Constant(value=int() | float() as number):
            return float(number)
        case ast.Call(func=ast.Name(id=name), args=[metric, *rest], keywords=[]):
            return _FUNCTIONS[name](ast.unparse(metric).strip("'\""), *map(_read, rest))
        case ast.UnaryOp(op=ast.USub(), operand=inner):
            return -1.0 * _read(inner)
        case ast.BinOp(left=left, op=ast.Add(), right=right):
            return _read(left) + _read(right)
        case ast.BinOp(left=left, op=ast.Sub(), right=right):
            return _read(left) - _read(right)
        case ast.BinOp(left=left, op=ast.Mult(), right=right):
            return _read(left) * _read(right)
        case ast.Compare(left=ast.Name(id="violation"), ops=[ast.LtE()], comparators=[bound]):
            return violation(_read(bound))
        case ast.Compare(left=left, ops=[ast.LtE()], comparators=[bound]):
            return _read(left) <= _read(bound)
        case ast.Compare(left=left, ops=[ast.GtE()], comparators=[bound]):
            return _read(left) >= _read(bound)
    raise TypeError


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
    if width == 0.0:
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


_STATISTICS = {"mean": _mean, "cvar": _cvar, "worst": _worst, "least": _least}

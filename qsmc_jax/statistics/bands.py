"""What independent runs say of the whole distribution of a column: its CDF, quantiles, mean tail, the next run."""

import dataclasses
import math
from typing import Any, Literal, TypeAlias

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require, require_count, require_fraction
from qsmc_jax.display.plotting import BLUE, GREY, one_axes
from qsmc_jax.display.result import AbstractResult
from qsmc_jax.statistics.intervals import cdf_band

Tail: TypeAlias = Literal["high", "low"]

# Quantiles that a text and a table show.
_LEVELS = (0.01, 0.05, 0.25, 0.5, 0.75, 0.95, 0.99)


@dataclasses.dataclass(frozen=True, repr=False)
class Band(AbstractResult):
    r"""Two step functions between which the CDF of a column lies everywhere, with the given confidence.

    Runs in which the column is not known may be anywhere: the lower function has them at the upper end of the support,
    the upper one at its lower end. Both are the empirical CDF moved by $\sqrt{\ln(2/\alpha) / (2N)}$.

    Attributes:
        name: The column.
        unit: Its unit; empty if it has none of its own.
        values: Its known values, in order; infinite ones too.
        unknown: Runs in which it is not known.
        confidence: Confidence of the whole band, and of all that is read from it together.
        least: What it is never below, from a proof say; -inf for nothing known.
        most: What it never exceeds; inf for nothing known.

    Raises:
        InputError: There is no run, or a value lies outside the support, or the confidence out of (0, 1).

    Examples:
        >>> import numpy as np
        >>> import qsmc_jax as qj
        >>> band = qj.Band("peak", "N", np.linspace(0.0, 1.0, 1001), 0, 0.95, most=1.2)
        >>> [round(end, 3) for end in band.quantile(0.5)], [round(end, 3) for end in band.cvar(0.9)]
        ([0.457, 0.543], [0.907, 1.07])

    Source: Dvoretzky, Kiefer and Wolfowitz (1956), Massart (1990); unknown values as Horowitz and Manski (2000).
    """

    name: str
    unit: str
    values: Float[np.ndarray, " known"]
    unknown: int
    confidence: float
    least: float = -math.inf
    most: float = math.inf

    def __post_init__(self):
        require_count("unknown", self.unknown, 0)
        values = np.sort(np.asarray(self.values, np.float64))
        require(not bool(np.isnan(values).any()), "Argument `values` must hold no NaN: count these as `unknown`.")
        require(self.runs > 0, f"Argument `values` must have a run at least, but has none of `{self.name}`.")
        require_fraction("confidence", self.confidence)
        require(self.least < self.most, f"Argument `least` must be below `most`, but is {self.least!r}.")
        is_inside = bool(np.all((self.least <= values) & (values <= self.most)))
        require(
            is_inside,
            f"Arguments `least` and `most` must hold all values of `{self.name}`, but [{self.least:g}, {self.most:g}] "
            f"does not hold [{min(values, default=0.0):g}, {max(values, default=0.0):g}]: what you take as proved is "
            "not so.",
        )
        object.__setattr__(self, "values", values)

    @property
    def runs(self) -> int:
        """All runs, known or not."""
        return len(self.values) + self.unknown

    @property
    def width(self) -> float:
        """By how much either function is moved, in units of probability."""
        return cdf_band(self.runs, self.confidence)

    def cdf(self, value: float) -> tuple[float, float]:
        """Lower and upper bound on the probability that the column does not exceed a value.

        Args:
            value: The value.
        """
        below = int(np.searchsorted(self.values, value, side="right"))
        low = 1.0 if value >= self.most else max(below / self.runs - self.width, 0.0)
        high = 0.0 if value < self.least else min((below + self.unknown) / self.runs + self.width, 1.0)
        return low, high

    def quantile(self, level: float) -> tuple[float, float]:
        """Lower and upper bound on a quantile; an end of the support where the runs say nothing.

        Args:
            level: Its probability, strictly between 0 and 1.
        """
        require_fraction("level", level)
        low, high = self._quantiles(np.array([level]))
        return float(low[0]), float(high[0])

    def cvar(self, level: float, tail: Tail = "high") -> tuple[float, float]:
        r"""Lower and upper bound on the mean of the worst part of the runs, $\frac{1}{1-a} \int_a^1 Q(u)\, du$.

        What is rarer than the band is wide may be as bad as the support allows: without a known end the bound on that
        side is infinite.

        Args:
            level: The part a that is left out, in [0, 1).
            tail: Which end is the worse one.
        """
        require(0.0 <= level < 1.0, f"Argument `level` must lie in [0, 1), but is {level!r}.")
        require(tail in ("high", "low"), f"Argument `tail` must be 'high' or 'low', but is {tail!r}.")
        start, end = (level, 1.0) if tail == "high" else (0.0, 1.0 - level)
        steps = np.arange(len(self.values) + 1) / self.runs
        cuts = np.concatenate([steps + self.unknown / self.runs + self.width, steps - self.width, [start, end]])
        cuts = np.unique(np.clip(cuts, start, end))
        lows, highs = self._quantiles(0.5 * (cuts[1:] + cuts[:-1]))
        parts = np.diff(cuts) / (end - start)
        with np.errstate(invalid="ignore"):
            return float(parts @ lows), float(parts @ highs)

    def _quantiles(self, levels: Float[np.ndarray, " levels"]) -> tuple[np.ndarray, np.ndarray]:
        """Where the upper, and where the lower function reaches some levels."""
        known = np.concatenate([[self.least], self.values, [self.most]])
        # The number of values that must lie at or below for the function to be at the level.
        upper = np.ceil((levels - self.width) * self.runs - self.unknown)
        lower = np.ceil((levels + self.width) * self.runs)
        ranks = (np.clip(each, 0, len(self.values) + 1).astype(int) for each in (upper, lower))
        low, high = (known[each] for each in ranks)
        return low, high

    def table(self) -> dict[str, Any]:
        """Some quantiles with their bounds, a row each."""
        ends = np.array([self.quantile(level) for level in _LEVELS])
        return {"level": np.array(_LEVELS), "low": ends[:, 0], "high": ends[:, 1]}

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        quantiles = {name: column.tolist() for name, column in self.table().items()}
        about = {"name": self.name, "unit": self.unit, "runs": self.runs, "unknown": self.unknown}
        ends = {"least": self.least, "most": self.most}
        return {**about, "confidence": self.confidence, "width": self.width, **ends, "quantiles": quantiles}

    def plot(self, ax: Any = None) -> Any:
        """The two step functions.

        Args:
            ax: Matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        ax = one_axes(ax, (7.0, 4.5))
        finite = np.unique(self.values[np.isfinite(self.values)])
        low, high = np.array([self.cdf(value) for value in finite]).reshape(-1, 2).T
        ax.fill_between(finite, low, high, step="post", color=BLUE, alpha=0.3, label="holds the CDF everywhere")
        for end in (self.least, self.most):
            if math.isfinite(end):
                ax.axvline(end, color=GREY, ls=":", label=f"end of the support: {end:.4g}")
        ax.set(xlabel=f"{self.name} [{self.unit}]" if self.unit else self.name, ylabel="CDF", ylim=(0.0, 1.0))
        ax.set_title(str(self).partition("\n")[0], fontsize=10)
        ax.legend(loc="best", fontsize=8)
        return ax

    def __str__(self) -> str:
        unit = f" [{self.unit}]" if self.unit not in ("", "-") else ""
        unknown = f", not known in {self.unknown}" if self.unknown else ""
        rows = [
            f"{self.name}{unit} in {self.runs} runs{unknown}: CDF to {self.width:.3g} everywhere with "
            f"{100 * self.confidence:g} % confidence"
        ]
        ends = self.table()
        rows += [
            f"{100 * level:6g} % quantile in [{low:.6g}, {high:.6g}]"
            for level, low, high in zip(*ends.values(), strict=True)
        ]
        return "\n".join(rows)


def next_run(values: Float[np.ndarray, " known"], unknown: int, probability: float, tail: Tail = "high") -> float:
    r"""A number that one further run does not pass with the given probability, over all runs together.

    It is the k-th smallest of n, with $k = \lceil p\,(n + 1) \rceil$: each place among n + 1 independent runs is as
    probable as another, so that the next is among the k smallest with probability k/(n + 1) at least.

    Args:
        values: Known values.
        unknown: Runs in which it is not known: as bad as any.
        probability: That the next run does not pass it, strictly between 0 and 1.
        tail: Which end is the worse one.

    Returns:
        The number; infinite if there are too few runs.

    Source: Wilks, Ann. Math. Stat. 12 (1941); split conformal prediction.
    """
    require_fraction("probability", probability)
    require(tail in ("high", "low"), f"Argument `tail` must be 'high' or 'low', but is {tail!r}.")
    sign = 1.0 if tail == "high" else -1.0
    ordered = np.sort(sign * np.asarray(values, np.float64))
    rank = math.ceil(probability * (len(ordered) + unknown + 1))
    return float(sign * ordered[rank - 1]) if rank <= len(ordered) else sign * math.inf

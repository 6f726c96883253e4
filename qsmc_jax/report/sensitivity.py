"""Sensitivity of the margin to the drawn numbers."""

import dataclasses
from collections.abc import Iterable
from typing import Any

import numpy as np

from qsmc_jax.display.plotting import BLUE, ORANGE, panels
from qsmc_jax.metrics.standard import record_of
from qsmc_jax.study.runs import Runs, concatenate

# Rows taken: the first ones, which are as random as any.
_ROWS = 20_000
_SHOWN = 3


@dataclasses.dataclass(frozen=True)
class Sensitivity:
    """Rank correlations of drawn columns with the margin, the strongest first.

    Attributes:
        names: Drawn columns that vary.
        correlation: Spearman's rank correlation of each with the margin; negative if large numbers leave little room.
        rows: The rows they are from.
    """

    names: tuple[str, ...]
    correlation: tuple[float, ...]
    rows: Runs

    @classmethod
    def of(cls, tables: Iterable[Runs]) -> "Sensitivity":
        """Of the first 20 000 rows; runs without a margin are left out."""
        kept, count = [], 0
        for table in tables:
            kept.append(table.take(slice(_ROWS - count)))
            count += len(kept[-1])
            if count >= _ROWS:
                break
        rows = concatenate(kept)
        rows = rows.take(np.isfinite(rows["margin"]))
        varies = [name for name in (*rows.names, "margin") if len(rows) > 2 and np.ptp(rows[name]) > 0.0]
        drawn = [name for name in varies if name != "margin"] if "margin" in varies else []
        found = {name: _rank_correlation(rows[name], rows["margin"]) for name in drawn}
        order = sorted(found, key=lambda name: -abs(found[name]))
        return cls(tuple(order), tuple(found[name] for name in order), rows)

    def plot(self) -> Any:
        """Bars of the correlations, and the margin against the strongest three; the axes."""
        shown = self.names[:_SHOWN]
        count = 1 + len(shown)
        axes = panels(None, count, count, (4.2 * count, 4.2))
        ax, top = axes[0], self.names[:10][::-1]
        values = dict(zip(self.names, self.correlation, strict=True))
        colours = [ORANGE if values[name] < 0.0 else BLUE for name in top]
        ax.barh(range(len(top)), [values[name] for name in top], color=colours)
        ax.set_yticks(range(len(top)), top)
        ax.axvline(0.0, color="black", lw=0.8)
        ax.set(title="Sensitivity of the margin", xlabel="Spearman rank correlation [-]", xlim=(-1.05, 1.05))
        for ax, name in zip(axes[1:], shown, strict=True):
            ax.scatter(self.rows[name][:5000], self.rows["margin"][:5000], s=4, alpha=0.35, color=BLUE, rasterized=True)
            ax.set(title=f"rank correlation {values[name]:+.2f}", xlabel=name, ylabel=record_of("margin").axis)
        return axes


def _rank_correlation(x: np.ndarray, y: np.ndarray) -> float:
    """Spearman's: the correlation of the ranks."""
    return float(np.corrcoef(_ranks(x), _ranks(y))[0, 1])


def _ranks(values: np.ndarray) -> np.ndarray:
    """Ranks from 1, equal values sharing the mean of theirs; SciPy's take a third of a second to import."""
    _, place, counts = np.unique(values, return_inverse=True, return_counts=True)
    return (np.cumsum(counts) - 0.5 * (counts - 1))[place]

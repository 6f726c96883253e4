"""The picture of a comparison: for each study the probability of leaving the funnel, and medians, with intervals."""

from typing import Any

import numpy as np

from qsmc_jax.display.plotting import SERIES, panels

_COLUMNS = 3
# Medians that differ by less are drawn on a linear axis, which is easier to read.
_WIDE = 50.0  # so many times from the least to the largest: logarithmic


def plot_comparison(result: Any, ax: Any = None) -> Any:
    """A panel for the violation probability and one for the median of each metric, a line a study in each.

    Args:
        result: What `compare` returned.
        ax: One matplotlib `Axes` and one more for each figure; None for a new figure, which also gets a heading.

    Returns:
        The axes, (1 + metrics,).
    """
    count, names = 1 + len(result.metrics), [study.name for study in result.studies]
    columns, rows = min(count, _COLUMNS), -(-count // _COLUMNS)
    axes = panels(ax, count, columns, (5.0 * columns, 0.6 + (1.1 + 0.32 * len(names)) * rows))
    _probability(axes[0], result)
    for each, metric in zip(axes[1:], result.metrics, strict=True):
        _median(each, result, metric)
    for number, each in enumerate(axes):
        # In a new figure the rows of panels share the names; where given axes stand is not known.
        is_named = ax is not None or number % columns == 0
        each.set_yticks(range(len(names)), names if is_named else [""] * len(names))
        each.set_ylim(len(names) - 0.5, -0.5)
    sure = f"all {result.intervals} intervals hold together with {100 * result.confidence:g} % confidence"
    if ax is None:
        heading = f"{result.runs} runs of each on the same random numbers, seed {result.seed}; {sure}"
        axes[0].figure.suptitle(heading, fontsize=10)
    return axes


def _probability(ax: Any, result: Any) -> None:
    for row, study in enumerate(result.studies):
        _point(ax, row, study.estimate, study.low, study.high)
    least = min(study.high for study in result.studies)
    if least < 0.05:
        ax.set_xscale("symlog", linthresh=least)
    ax.set(title="probability of leaving the funnel", xlim=(-0.1 * least, 1.1))


def _median(ax: Any, result: Any, metric: str) -> None:
    found = [(row, study.medians[metric]) for row, study in enumerate(result.studies) if metric in study.medians]
    for row, estimate in found:
        _point(ax, row, estimate.median, estimate.low, estimate.high)
    ends = np.array([[e.low, e.median, e.high] for _, e in found])
    ends = ends[np.isfinite(ends)]
    least = np.abs(ends[ends != 0.0]).min(initial=np.inf)
    if ends.size and ends.max() > _WIDE * least:
        # A metric that may be negative, such as the excess variation, is linear around zero.
        ax.set_xscale("log") if ends.min() > 0.0 else ax.set_xscale("symlog", linthresh=_around_zero(ends))
        ax.xaxis.set_minor_formatter("")
    ax.set(title=f"median: {result.records[metric].axis}")


def _around_zero(ends: np.ndarray) -> float:
    """Where a symmetric logarithmic axis becomes linear: some ten times the largest negative end, or a thousandth.

    A power of ten, since ticks below it would run into the one at zero.
    """
    size = -10.0 * ends.min() if ends.min() < 0.0 else 1e-3 * ends.max()
    return float(10.0 ** np.ceil(np.log10(size)))


def _point(ax: Any, row: int, middle: float, low: float, high: float) -> None:
    """A dot with its interval; what is infinite or unknown is written instead."""
    colour = SERIES[row % len(SERIES)]
    text = {"ha": "center", "va": "bottom", "fontsize": 8, "color": colour}
    if not np.isfinite(middle):
        word = "unknown" if np.isnan(middle) else f"infinite; at least {low:.3g}"
        ax.annotate(word, (0.5, row), xycoords=("axes fraction", "data"), **text)
        return
    reach = [[middle - low if np.isfinite(low) else 0.0], [high - middle if np.isfinite(high) else 0.0]]
    ax.errorbar([middle], [row], xerr=np.maximum(reach, 0.0), fmt="o", color=colour, capsize=3.0)
    if not np.isfinite(high):
        ax.annotate(r"to $\infty$", (middle, row), (0, 4), textcoords="offset points", **text)

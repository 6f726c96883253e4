"""The picture of a search for a critical value: every test made, and what it found."""

from typing import Any

import numpy as np

from qsmc_jax.display.plotting import BLUE, GREEN, GREY, ORANGE, RED, one_axes
from qsmc_jax.display.scales import spans_decade
from qsmc_jax.metrics.claims import breaching

_MARKS = {"below": (BLUE, "o"), "above": (RED, "s"), "open": (GREY, "d")}


def plot_critical(result: Any, ax: Any = None) -> Any:
    """Every test of a search with its interval, and the probability that was to be shown.

    Args:
        result: What `critical_value` returned.
        ax: Matplotlib `Axes` to draw in; None for a new figure.

    Returns:
        The axes.
    """
    ax = one_axes(ax, (8.0, 5.4))
    table = result.table()
    estimate = table["violated"] / np.maximum(table["runs"] - table["inadmissible"], 1)
    reach = np.abs([estimate - table["low"], table["high"] - estimate])
    for finding, (colour, mark) in _MARKS.items():
        rows = table["finding"] == finding
        if rows.any():
            ends = reach[:, rows]
            ax.errorbar(table["value"][rows], estimate[rows], ends, fmt=mark, color=colour, capsize=3, label=finding)
    ax.axhline(result.below, color=ORANGE, ls="--", label=f"to be shown: below {result.below:g}")
    if result.shown is not None:
        ax.axvline(result.shown, color=GREEN, ls=":", label=f"{result.side} shown: {result.shown:.4g}")
    low, high = result.between
    if spans_decade(low, high):
        ax.set_xscale("log")
    ax.set_yscale("symlog", linthresh=result.below)
    label = f"probability of {breaching(result.claim)} (linear below {result.below:g})"
    ax.set(xlabel=result.name, ylabel=label, ylim=(-0.05 * result.below, 1.1))
    sure = f"all findings right together with {100 * result.confidence:g} % confidence"
    ax.set_title(f"{len(result.tests)} tests, {result.runs} runs, seed {result.seed}; {sure}", fontsize=10)
    ax.legend(loc="best", fontsize=8)
    return ax

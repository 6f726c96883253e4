"""The picture of a falsification: how bad the worst run so far was."""

from typing import Any

import numpy as np

from qsmc_jax.display.plotting import BLUE, GREY, RED, one_axes


def plot_falsification(result: Any, ax: Any = None) -> Any:
    """The worst so far over the simulations, and the worst of the random runs.

    Args:
        result: What `falsify` returned.
        ax: Matplotlib `Axes` to draw in; None for a new figure.

    Returns:
        The axes.
    """
    ax = one_axes(ax, (8.0, 4.5))
    table = result.table()
    simulations, values = table["simulations"], table[result.column]
    known = np.isfinite(values)
    if known.any():
        ends = np.append(simulations[known], result.simulations), np.append(values[known], values[known][-1])
        ax.step(*ends, where="post", color=BLUE, label="worst so far")
    if np.isfinite(result.random_value):
        ax.axhline(result.random_value, color=GREY, ls=":", label=f"worst random run: {result.random_value:.4g}")
    if np.isfinite(result.value):
        ax.axhline(result.value, color=RED, ls="--", label=f"confirmed: {result.value:.6g}")
    if result.first_violation_at is not None:
        ax.axvline(result.first_violation_at, color=RED, ls=":", label="first violation")
    ax.set(xlabel="simulations", ylabel=result.record.axis, xlim=(0, result.simulations))
    ax.set_title(result.conclusion().partition(";")[0].partition(":")[0], fontsize=10)
    ax.legend(loc="best", fontsize=8)
    return ax

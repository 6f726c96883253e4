"""The picture of a proof."""

from typing import Any

import numpy as np

from qsmc_jax.display.plotting import BLUE, GREY, ORANGE, panels


def plot_proof(proof: Any, ax: Any = None) -> Any:
    """The tubes of sliding variable and input, which hold every run, and the funnel.

    Args:
        proof: What `certify` returned.
        ax: Two matplotlib `Axes`; None for a new figure.

    Returns:
        The axes.
    """
    axes, table = panels(ax, 2, 1, (8.0, 6.4)), proof.table()
    axes[0].set_title(proof.verdict if proof.is_proved else "NOT_PROVED: there is no tube to draw", fontsize=10)
    axes[0].set(ylabel="sliding variable [x^(n-1)]")
    axes[1].set(xlabel="t [s]", ylabel="u [input]")
    if not proof.is_proved:
        return axes

    def steps(name: str) -> np.ndarray:
        return np.append(table[name], table[name][-1])

    t = np.append(table["t"], table["until"][-1])
    for axis, name in ((axes[0], "sigma"), (axes[1], "u")):
        low, high = (steps(f"{name}_{end}") for end in ("min", "max"))
        axis.fill_between(t, low, high, step="post", color=BLUE, alpha=0.35, label="holds every run")
    for sign in (-1.0, 1.0):
        label = "funnel, at its widest" if sign > 0.0 else None
        axes[0].plot(t, sign * steps("rho"), drawstyle="steps-post", color=GREY, lw=1.0, label=label)
        label = f"|u| <= {proof.peak_u:.4g}" if sign > 0.0 else None
        axes[1].axhline(sign * proof.peak_u, color=ORANGE, ls="--", lw=1.0, label=label)
    for axis in axes:
        axis.legend(loc="best", fontsize=8)
        axis.set_xscale("symlog", linthresh=1e-2)
        axis.set_xlim(0.0, t[-1])
    return axes

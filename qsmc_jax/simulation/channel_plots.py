"""Pictures of a run with several inputs: a colour a channel, and all channels in one funnel of width 1."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from qsmc_jax.display.plotting import GREY, ORANGE, RED, SERIES, one_axes, panels

# How the runs are drawn: the first, and all others.
_FIRST, _OTHERS = "-", "--"


def plot_channels(runs: Sequence[Any], labels: Sequence[str], ax: Any = None) -> Any:
    """Outputs with references, errors, inputs, and sigma/rho of all channels, of one or several runs of one loop.

    Args:
        runs: Trajectories; those after the first are dashed.
        labels: One label a run, empty for none.
        ax: Four matplotlib `Axes` to draw in, in reading order; None for a new figure.

    Returns:
        The axes, (4,): outputs, errors, inputs, sigma/rho.
    """
    axes = panels(ax, 4, 2, (11.0, 7.0))
    outputs, errors, inputs, funnel = axes
    firsts = first_errors(runs[0].loop)
    for run, name in zip(runs, labels, strict=True):
        style = _style(run, runs)
        for i, first in enumerate(firsts):
            colour, label = SERIES[i % len(SERIES)], _named(name, run, runs, i)
            outputs.plot(run.ts, run.e[:, first] + run.desired[:, first], style, color=colour, label=label)
            errors.plot(run.ts, run.e[:, first], style, color=colour)
            inputs.plot(run.ts, run.u[:, i], style, color=colour)
    for i, first in enumerate(firsts):
        label = "$x_{des}$" if i == 0 else None
        outputs.plot(runs[0].ts, runs[0].desired[:, first], ":", color=GREY, label=label)
    outputs.set(title="Outputs and references", xlabel="t [s]", ylabel="y")
    outputs.legend(loc="best", fontsize=8)
    errors.set(title="Tracking errors", xlabel="t [s]", ylabel="$e$")
    inputs.set(title="Inputs", xlabel="t [s]", ylabel="u")
    _ratios(funnel, runs, labels)
    return axes


def plot_ratios(run: Any, ax: Any = None) -> Any:
    """Where in its funnel each channel is.

    Args:
        run: A trajectory.
        ax: Matplotlib `Axes` to draw in; None for a new figure.

    Returns:
        The axes.
    """
    ax = one_axes(ax, (6.0, 3.6))
    _ratios(ax, [run], [""])
    return ax


def ratios(run: Any) -> np.ndarray:
    """Where in its funnel each channel is at the times, (times, m), inside for |z| < 1 [-].

    Args:
        run: A trajectory.
    """
    low, high = run.edges
    return (run.sigma - 0.5 * (low + high)) / run.rho


def first_errors(loop: Any) -> list[int]:
    """The columns of the errors in which the channels begin.

    Args:
        loop: The loop.
    """
    orders = [channel.order for channel in loop.channels]
    return [sum(orders[:i]) for i in range(len(orders))]


def _style(run: Any, runs: Sequence[Any]) -> str:
    return _FIRST if run is runs[0] else _OTHERS


def _named(name: str, run: Any, runs: Sequence[Any], channel: int) -> str | None:
    """What a line is called; runs that have no name are told by the first."""
    return f"channel {channel}{f', {name}' if name else ''}" if name or run is runs[0] else None


def _ratios(ax: Any, runs: Sequence[Any], labels: Sequence[str]) -> None:
    for run, name in zip(runs, labels, strict=True):
        for i, row in enumerate(ratios(run).T):
            label = _named(name, run, runs, i)
            ax.plot(run.ts, row, _style(run, runs), color=SERIES[i % len(SERIES)], label=label)
    draw_unit_funnel(ax, runs[0].reaching_time)


def draw_unit_funnel(ax: Any, t_r: float, name: str = "$t_r$") -> None:
    """The edges of a funnel of width 1, and the latest reaching time.

    Args:
        ax: Matplotlib `Axes`.
        t_r: The reaching time [s].
        name: What it is called.
    """
    for sign in (-1.0, 1.0):
        ax.axhline(sign, color=RED, label=r"$\pm\rho$" if sign > 0 else None)
    ax.axvline(t_r, ls=":", color=ORANGE, label=f"{name} = {t_r:.4g} s")
    ax.set(title="Sliding variables in their funnels", xlabel="t [s]", ylabel=r"$\sigma / \rho$ [-]", ylim=(-1.1, 1.1))
    ax.legend(loc="best", fontsize=8)

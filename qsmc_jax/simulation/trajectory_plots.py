"""Pictures of one run: the paper's four, and its Figure 1."""

from typing import Any

import numpy as np

from qsmc_jax.base.checks import require
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.display.plotting import BLUE, GREEN, GREY, ORANGE, RED, SERIES, one_axes, panels
from qsmc_jax.simulation.channel_plots import plot_channels, plot_ratios


def plot_trajectory(*runs: Any, labels: tuple[str, ...] | None = None, ax: Any = None) -> Any:
    """Output and reference, errors, input, and sigma inside its funnel, of one or several runs of one loop.

    Args:
        *runs: Trajectories of one plant and reference, say from several starts.
        labels: One label a run; None for none.
        ax: Four matplotlib `Axes` to draw in, in reading order; None for a new figure.

    Returns:
        The axes, (4,): output, errors, input, sliding variable.
    """
    names = labels or ("",) * len(runs)
    if len(runs[0].loop.channels) > 1:
        return plot_channels(runs, names, ax)
    axes = panels(ax, 4, 2, (11.0, 7.0))
    outputs, errors, inputs, funnel = axes
    for run, colour, label in zip(runs, _colours(len(runs)), names, strict=True):
        _output(outputs, run, colour, label)
        _input(inputs, run, colour)
        funnel.plot(run.ts, run.sigma, color=colour)
    _errors(errors, runs)
    first = runs[0]
    outputs.plot(first.ts, first.desired[:, 0], "--", color=GREY, label="$x_{des}$")
    outputs.set(title="Output and reference", xlabel="t [s]", ylabel="y")
    outputs.legend(loc="best", fontsize=8)
    inputs.set(title="Input", xlabel="t [s]", ylabel="u")
    for run, colour in zip(runs[1:], _colours(len(runs))[1:], strict=True):
        if not np.array_equal(run.rho, first.rho):
            for edge in run.edges:
                funnel.plot(run.ts, edge, "--", color=colour, lw=1.0)
    _funnel(funnel, first)
    return axes


def plot_phase_plane(run: Any, ax: Any = None) -> Any:
    """The paper's Figure 1: e against its derivative, and the surfaces |sigma| = rho(t) closing in on epsilon.

    Args:
        run: A trajectory of a plant of order 2.
        ax: Matplotlib `Axes` to draw in; None for a new figure.

    Returns:
        The axes.

    Raises:
        InputError: The plant is not of order 2.
    """
    order = run.loop.order if len(run.loop.channels) == 1 else tuple(each.order for each in run.loop.channels)
    require(order == 2, f"The phase plane needs a plant of order 2, but this one has order {order}. Use `plot()`.")
    ax = one_axes(ax, (7.0, 5.5))
    c = float(run.loop.control.surface.c[0])
    reach = 1.1 * max(np.nanmax(np.abs(run.e[:, 0])), float(run.bandwidth))
    e = np.linspace(-reach, reach, 2)
    times = np.linspace(0.0, run.reaching_time, 6)
    for i, edge in enumerate(run.edges):
        for j, (t, sigma) in enumerate(zip(times, np.interp(times, run.ts, edge), strict=True)):
            label = r"the funnel's edges, t = 0 ... $t_r$" if i == j == 0 else None
            ax.plot(e, sigma - c * e, color=GREY, alpha=0.3 + 0.1 * np.searchsorted(times, t), lw=1.0, label=label)
    for sign in (-1.0, 1.0):
        ax.plot(
            e, sign * run.bandwidth - c * e, "--", color=GREEN, label=r"$|\sigma| = \varepsilon$" if sign > 0 else None
        )
    ax.plot(e, -c * e, color=BLUE, label=r"$\sigma = 0$")
    ax.plot(run.e[:, 0], run.e[:, 1], color=RED, label="run")
    ax.plot(*run.e[0], "o", color=RED)
    height = 1.2 * np.nanmax(np.abs(run.e[:, 1])) + float(run.bandwidth)
    ax.set(xlim=(-reach, reach), ylim=(-height, height), xlabel="$e$", ylabel=r"$\dot e$ [1/s]", title="Phase plane")
    ax.legend(loc="best", fontsize=8)
    return ax


def plot_funnel(run: Any, ax: Any = None) -> Any:
    """The sliding variable in its funnel.

    Args:
        run: A trajectory.
        ax: Matplotlib `Axes` to draw in; None for a new figure.

    Returns:
        The axes.
    """
    if len(run.loop.channels) > 1:
        return plot_ratios(run, ax)
    ax = one_axes(ax, (6.0, 3.6))
    ax.plot(run.ts, run.sigma, color=BLUE, label=r"$\sigma$")
    _funnel(ax, run)
    return ax


def draw_edges(
    ax: Any, ts: np.ndarray, edges: tuple[np.ndarray, np.ndarray], funnel: AbstractFunnel, eps: float
) -> None:
    """The two edges of a funnel and of the bandwidth, in the axes given.

    Args:
        ax: Matplotlib `Axes`.
        ts: Times [s].
        edges: The edges at the times.
        funnel: Whose they are.
        eps: The bandwidth.
    """
    name = r"$\pm\rho$" if is_centred(funnel) else r"$m \pm \rho$"
    for sign, edge in zip((-1.0, 1.0), edges, strict=True):
        ax.plot(ts, edge, color=RED, label=name if sign > 0 else None)
        ax.axhline(sign * eps, ls="--", color=GREEN, label=r"$\pm\varepsilon$" if sign > 0 else None)


def is_centred(funnel: AbstractFunnel) -> bool:
    """Whether a funnel lies around 0, whatever its numbers."""
    return isinstance(funnel.centre(0.0), float)


def _colours(count: int) -> list[str]:
    return [SERIES[i % len(SERIES)] for i in range(count)]


def _output(ax: Any, run: Any, colour: str, label: str) -> None:
    ax.plot(run.ts, run.e[:, 0] + run.desired[:, 0], color=colour, label=label or "y")


def _errors(ax: Any, runs: tuple[Any, ...]) -> None:
    """The tracking error of each run; of a single run, the derivatives too."""
    if len(runs) == 1:
        for i in range(runs[0].loop.order):
            ax.plot(runs[0].ts, runs[0].e[:, i], color=SERIES[i % len(SERIES)], label=f"$e^{{({i})}}$")
        ax.legend(loc="best", fontsize=8)
    else:
        for run, colour in zip(runs, _colours(len(runs)), strict=True):
            ax.plot(run.ts, run.e[:, 0], color=colour)
    ax.set(title="Tracking error", xlabel="t [s]", ylabel="$e^{(i)}$" if len(runs) == 1 else "$e$")


def _input(ax: Any, run: Any, colour: str) -> None:
    ax.plot(run.ts, run.u, color=colour)


def _funnel(ax: Any, run: Any) -> None:
    """The funnel, the bandwidth and the reaching time around the sliding variable, on a scale that shows both ends."""
    eps, t_r = float(run.bandwidth), run.reaching_time
    draw_edges(ax, run.ts, run.edges, run.loop.control.funnel, eps)
    ax.axvline(t_r, ls=":", color=ORANGE, label=f"$t_r$ = {t_r:.4g} s")
    ax.set_yscale("symlog", linthresh=2.0 * eps)
    ax.set(title="Sliding variable in its funnel", xlabel="t [s]", ylabel=r"$\sigma$ (linear below 2 $\varepsilon$)")
    ax.legend(loc="best", fontsize=8)

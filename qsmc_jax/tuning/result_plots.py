"""Pictures of a search for gains: its course, its sensitivities, its landscape, and the loop before and after."""

from typing import Any

import numpy as np

from qsmc_jax.base.checks import require
from qsmc_jax.display.plotting import BLUE, GREEN, GREY, ORANGE, RED, SERIES, one_axes, panels
from qsmc_jax.display.scales import spans_decade


def plot_tuning(result: Any, ax: Any = None) -> Any:
    """Objective, constraints and gains along the search, and the sensitivities at its end.

    Args:
        result: What `tune` returned.
        ax: Four matplotlib `Axes` to draw in, in reading order; None for a new figure, which also gets a heading.

    Returns:
        The axes, (4,): objective, constraints, gains, sensitivities.
    """
    axes = panels(ax, 4, 2, (12.0, 8.0))
    objective, constraints, gains, sensitivities = axes
    simulations = np.array([each.n_simulations for each in result.history])
    is_kept = np.array([each.is_feasible for each in result.history])
    _draw_objective(objective, result, simulations, is_kept)
    _draw_constraints(constraints, result, simulations)
    for name, colour in zip(result.parameters, _cycle(len(result.parameters)), strict=True):
        values = np.array([each.gains[name] for each in result.history]) / result.before.gains[name]
        label = f"{name}: {result.before.gains[name]:.4g} -> {result.gains[name]:.4g}"
        gains.plot(simulations, values, ".-", color=colour, lw=0.8, label=label)
    gains.axhline(1.0, color=GREY, lw=0.8)
    gains.set(ylabel="gain over the study's own [-]", yscale="log")
    gains.legend(fontsize=8)
    for each in (objective, constraints, gains):
        each.set(xlabel="simulations spent [-] (a gradient: 1 + gains)")
    _draw_sensitivity(sensitivities, result)
    if ax is None:
        axes[0].figure.suptitle(result.conclusion(), fontsize=9, wrap=True)
    return axes


def _draw_objective(ax: Any, result: Any, simulations: np.ndarray, is_kept: np.ndarray) -> None:
    values = np.array([each.objective for each in result.history])
    ax.plot(simulations[is_kept], values[is_kept], "o", color=BLUE, ms=4, label="constraints kept")
    ax.plot(simulations[~is_kept], values[~is_kept], "x", color=RED, ms=5, label="a constraint violated")
    best = np.minimum.accumulate(np.where(is_kept, values, np.inf))
    ax.step(simulations, np.where(np.isfinite(best), best, np.nan), where="post", color=GREEN, label="best so far")
    if np.isfinite(result.before.objective):
        ax.axhline(result.before.objective, color=GREY, lw=0.8, label="the study's own gains")
    if result.certificate is not None and np.isfinite(result.certificate.objective):
        ax.axhline(result.certificate.objective, color=ORANGE, ls="--", label="tuned gains on fresh runs")
    ax.set(ylabel=str(result.objective), yscale="log" if (values[np.isfinite(values)] > 0.0).all() else "linear")
    ax.legend(fontsize=8)


def _draw_constraints(ax: Any, result: Any, simulations: np.ndarray) -> None:
    for i, constraint in enumerate(result.constraints):
        excess = 100.0 * np.array([each.excess[i] for each in result.history])
        ax.plot(simulations, excess, ".-", color=SERIES[i % len(SERIES)], lw=0.8, label=str(constraint))
    ax.axhspan(0.0, max(ax.get_ylim()[1], 1.0), color=RED, alpha=0.08, label="passed")
    ax.set_yscale("symlog", linthresh=10.0)
    ax.set(ylabel="excess over the bound [%] (linear within 10)")
    ax.legend(fontsize=8)


def _draw_sensitivity(ax: Any, result: Any) -> None:
    """Grouped bars with their signs: what one percent more of each gain does."""
    judged = [str(result.objective), *(str(constraint.objective) for constraint in result.constraints)]
    width, place = 0.8 / len(result.parameters), np.arange(len(judged))
    for j, (name, colour) in enumerate(zip(result.parameters, _cycle(len(result.parameters)), strict=True)):
        bars = ax.barh(place + (j + 0.5) * width - 0.4, result.sensitivity[:, j], width, color=colour, label=name)
        ax.bar_label(bars, fmt="%+.2g", fontsize=8, padding=2)
    ax.axvline(0.0, color=GREY, lw=0.8)
    ax.set_yticks(place, judged, fontsize=8)
    ax.invert_yaxis()
    ax.margins(x=0.2)
    ax.set(xlabel="change per change of the gain at the tuned gains [%/%]")
    ax.legend(fontsize=8)


def plot_contour(made: Any, tuned: Any, ax: Any = None) -> Any:
    """Contours of the objective over two gains, where constraints are kept, the path of a search and what it chose."""
    ax = one_axes(ax, (8.5, 6.5))
    x, y = made.grids
    values = made.values[0].T
    finite = values[np.isfinite(values)]
    require(finite.size > 0, "There is nothing to draw: the objective is known in no cell of the landscape.")
    is_wide = spans_decade(finite.min(), finite.max())
    levels = np.geomspace(finite.min(), finite.max(), 25) if is_wide else np.linspace(finite.min(), finite.max(), 25)
    norm = "log" if is_wide else "linear"
    filled = ax.contourf(x, y, np.ma.masked_invalid(values), levels=levels, norm=norm, cmap="viridis")
    ax.figure.colorbar(filled, ax=ax, label=str(made.objectives[0]), format="%.3g")
    ax.contourf(x, y, made.is_feasible.T.astype(float), levels=[-0.5, 0.5], colors="white", alpha=0.45, hatches=["//"])
    ax.plot([], [], "s", color="lightgrey", label="a constraint violated (hatched)")
    if tuned is not None:
        _draw_search(ax, made.names, tuned)
    for axis, grid in (("x", x), ("y", y)):
        if spans_decade(grid[0], grid[-1]):
            ax.set(**{f"{axis}scale": "log"})
    ax.set(xlabel=made.names[0], ylabel=made.names[1])
    ax.set_title("; ".join(map(str, made.constraints)) or "no constraints", fontsize=9)
    ax.legend(fontsize=8, loc="upper left")
    return ax


def _draw_search(ax: Any, names: tuple[str, str], tuned: Any) -> None:
    """The path of a search, the gains it began at, and those it chose, which need not be the best in training."""
    walk = np.array([[each.gains[name] for name in names] for each in tuned.history if each.start >= 0])
    ax.plot(*walk.reshape(-1, 2).T, ".-", color=ORANGE, lw=1.0, label="path of the search")
    start, chosen = ([gains[name] for name in names] for gains in (tuned.before.gains, tuned.gains))
    label = "chosen, certified" if tuned.is_certified else "chosen, not certified"
    ax.plot(*chosen, "*", color=RED, ms=15, clip_on=False, zorder=5, label=label)
    ax.plot(*start, "D", color="white", mec="black", label="the study's own gains")


def plot_pareto(made: Any, ax: Any = None) -> Any:
    """The second objective against the first over the grid: passed, dominated and efficient cells."""
    ax = one_axes(ax, (8.5, 6.0))
    points = made.values[:2].reshape(2, -1)
    kept, efficient = made.is_feasible.reshape(-1), made.is_efficient.reshape(-1)
    ax.plot(*points[:, ~kept], "x", color=RED, ms=4, alpha=0.5, label="a constraint violated")
    ax.plot(*points[:, kept & ~efficient], "o", color=GREY, ms=4, alpha=0.5, label="dominated")
    front = points[:, efficient]
    front = front[:, np.argsort(front[0])]
    ax.step(*front, "o-", where="post", color=BLUE, label="efficient: no cell is better in both")
    for (label, point), colour, mark in zip(made.marked.items(), (ORANGE, GREEN), ("D", "*"), strict=False):
        ax.plot(*point[:2], mark, color=colour, ms=12, mec="black", label=label)
    for axis, values in (("x", points[0]), ("y", points[1])):
        known = values[np.isfinite(values)]
        if known.size and spans_decade(known.min(), known.max()):
            ax.set(**{f"{axis}scale": "log"})
    ax.set(xlabel=str(made.objectives[0]), ylabel=str(made.objectives[1]))
    ax.legend(fontsize=8)
    return ax


def _cycle(count: int) -> tuple[str, ...]:
    return tuple(SERIES[i % len(SERIES)] for i in range(count))

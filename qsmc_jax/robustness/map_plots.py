"""Pictures of a robustness map: a curve with its band, or a coloured grid with the borders of what is sure."""

import itertools as it
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from qsmc_jax.display.plotting import BLUE, GREEN, GREY, ORANGE, PURPLE, RED, SKY, panels
from qsmc_jax.display.scales import spans_decade
from qsmc_jax.metrics.claims import breaching
from qsmc_jax.statistics.intervals import zero_failure_bound

Scales = Mapping[str, tuple[float, str]]

# Line of each kind of threshold.
_LINES = {"local": (PURPLE, ":"), "sufficient": (GREEN, "-."), "necessary": (RED, "--")}
# Above this an interval without any violation is too wide for a logarithmic axis to show more than a linear one.
_WIDEST_FOR_LOG = 0.05
# How much wider than the interval without any violation a level to be drawn must be.
_CLEAR = 1.5


def plot_map(result: Any, scales: Scales, ax: Any = None) -> Any:
    """The probability of violating a claim over one name or two, and the medians of what else is known.

    Args:
        result: What `robustness_map` returned.
        scales: Factor and label of the axes that are to be dimensionless.
        ax: One matplotlib `Axes` and one more for each known median; None for a new figure, which also gets a heading.

    Returns:
        The axes, (1 + known medians,).
    """
    medians = {name: values for name, values in result.medians.items() if np.isfinite(values).any()}
    count = 1 + len(medians)
    columns = min(count, 2)
    axes = panels(ax, count, columns, (7.0 * columns, 5.2 * -(-count // columns)))
    draw = (_curve, _median_curve) if len(result.names) == 1 else (_mesh, _median_mesh)
    draw[0](axes[0], result, scales)
    for each, (name, values) in zip(axes[1:], medians.items(), strict=True):
        draw[1](each, result, scales, name, values)
    for each in axes:
        _thresholds(each, result, scales)
        if each.get_legend_handles_labels()[0]:
            each.legend(loc="best", fontsize=8)
    sure = f"intervals hold together with {100 * result.confidence:g} % confidence"
    lines = "; lines: limits of the nominal run" if result.thresholds else ""
    if ax is None:
        heading = f"{result.runs} runs in each of {result.low.size} cells, seed {result.seed}; {sure}{lines}"
        axes[0].figure.suptitle(heading, fontsize=10)
    return axes


def _curve(ax: Any, result: Any, scales: Scales) -> None:
    shown, values = result.shown, _values(result, scales, 0)
    ax.fill_between(values, shown.low, shown.high, color=SKY, alpha=0.4, lw=0.0, label="simultaneous interval")
    ax.plot(values, shown.estimate, ".-", color=BLUE, label="violated / admissible runs")
    if np.any(shown.undecided):
        share = shown.undecided / np.maximum(shown.total, 1)
        ax.plot(values, share, "x:", color=GREY, label="undecided / admissible runs")
    _horizontal(ax, result, scales)
    ax.set_ylabel(_probability(result))
    least = zero_failure_bound(result.runs, result.confidence)
    if least < _WIDEST_FOR_LOG:
        ax.set_yscale("symlog", linthresh=least)
        ax.set_ylabel(f"{_probability(result)} (linear below {least:.1g})")
    ax.set_ylim(-0.05 * least, 1.1)


def _median_curve(ax: Any, result: Any, scales: Scales, name: str, medians: np.ndarray) -> None:
    ax.plot(_values(result, scales, 0), medians, ".-", color=ORANGE)
    _horizontal(ax, result, scales)
    ax.set_ylabel(f"median: {result.study.record_of(name).axis}")
    if _spans_decades(medians):
        ax.set_yscale("log")


def _mesh(ax: Any, result: Any, scales: Scales) -> None:
    from matplotlib.collections import LineCollection
    from matplotlib.colors import LinearSegmentedColormap, Normalize, SymLogNorm

    shown = result.shown
    least = zero_failure_bound(result.runs, result.confidence)
    norm = SymLogNorm(least, vmin=0.0, vmax=1.0) if least < _WIDEST_FOR_LOG else Normalize(0.0, 1.0)
    colours = LinearSegmentedColormap.from_list("white to blue", ["white", SKY, BLUE, "#00263d"]).with_extremes(
        bad=GREY
    )
    edges = _coloured(ax, result, scales, shown.estimate, colours, norm, _probability(result))
    borders = [(shown.low > 0.0, "-", "a run is violated")]
    level = _level(float(shown.high.min()))
    if level is not None:
        borders.append((shown.high < level, ":", f"surely below {level:g}"))
    for mask, style, label in borders:
        segments = list(_border(mask, *edges))
        if segments:
            ax.add_collection(LineCollection(segments, colors=ORANGE, linestyles=style, linewidths=2.2, label=label))
    if not np.all(np.isfinite(shown.estimate)):
        ax.plot([], [], "s", color=GREY, label="no admissible run")


def _median_mesh(ax: Any, result: Any, scales: Scales, name: str, medians: np.ndarray) -> None:
    from matplotlib import colormaps
    from matplotlib.colors import LogNorm

    norm = LogNorm() if _spans_decades(medians) else None
    colours = colormaps["cividis"].with_extremes(bad=GREY)
    _coloured(ax, result, scales, medians, colours, norm, f"median: {result.study.record_of(name).axis}")


def _coloured(
    ax: Any, result: Any, scales: Scales, values: np.ndarray, colours: Any, norm: Any, label: str
) -> tuple[np.ndarray, np.ndarray]:
    """A coloured cell for each value, with its colour bar and axes; the edges of the cells."""
    edges = _edges(_values(result, scales, 0)), _edges(_values(result, scales, 1))
    known = np.where(np.isfinite(values), values, np.nan)
    ax.grid(visible=False)
    mesh = ax.pcolormesh(*edges, np.ma.masked_invalid(known.T), cmap=colours, norm=norm)
    ax.figure.colorbar(mesh, ax=ax, label=label)
    _horizontal(ax, result, scales)
    ax.set_ylabel(_label(result, scales, 1))
    if _is_geometric(result.grids[1]):
        ax.set_yscale("log")
    ax.set(xlim=edges[0][[0, -1]], ylim=edges[1][[0, -1]])
    return edges


def _border(mask: np.ndarray, x: np.ndarray, y: np.ndarray) -> Iterator[tuple[tuple[float, float], ...]]:
    """The edges between cells in the mask and cells outside it, each with its two ends."""
    for i, j in it.product(*map(range, mask.shape)):
        if i and mask[i, j] != mask[i - 1, j]:
            yield (x[i], y[j]), (x[i], y[j + 1])
        if j and mask[i, j] != mask[i, j - 1]:
            yield (x[i], y[j]), (x[i + 1], y[j])


def _thresholds(ax: Any, result: Any, scales: Scales) -> None:
    """A line for each threshold that lies in the picture."""
    for threshold in result.thresholds:
        colour, style = _LINES[threshold.kind]
        for axis, line, limits in zip(
            result.names, (ax.axvline, ax.axhline), (ax.get_xlim(), ax.get_ylim()), strict=False
        ):
            value = threshold.value * scales.get(axis, (1.0, ""))[0]
            if axis == threshold.axis_name and limits[0] <= value <= limits[1]:
                line(value, color=colour, ls=style, lw=1.6, label=f"{threshold.name} ({threshold.kind})")


def _horizontal(ax: Any, result: Any, scales: Scales) -> None:
    ax.set_xlabel(_label(result, scales, 0))
    if _is_geometric(result.grids[0]):
        ax.set_xscale("log")


def _values(result: Any, scales: Scales, axis: int) -> np.ndarray:
    """The values of one name, as drawn."""
    return result.grids[axis] * scales.get(result.names[axis], (1.0, ""))[0]


def _label(result: Any, scales: Scales, axis: int) -> str:
    name = result.names[axis]
    return scales[name][1] if name in scales else name


def _edges(values: np.ndarray) -> np.ndarray:
    """Edges of the cells around the values: half way to the neighbours, in the logarithm if they are geometric."""
    if len(values) == 1:
        reach = 0.5 * abs(values[0]) or 0.5
        return np.array([values[0] - reach, values[0] + reach])
    if _is_geometric(values):
        return np.exp(_halfway(np.log(values)))
    return _halfway(values)


def _halfway(values: np.ndarray) -> np.ndarray:
    middle = 0.5 * (values[1:] + values[:-1])
    return np.concatenate([[2.0 * values[0] - middle[0]], middle, [2.0 * values[-1] - middle[-1]]])


def _is_geometric(values: np.ndarray) -> bool:
    """Whether the values (three at least) have a constant ratio."""
    if len(values) < 3 or values[0] <= 0.0:
        return False
    return bool(np.ptp(np.diff(np.log(values))) < 1e-3 * np.log(values[-1] / values[0]))


def _spans_decades(values: np.ndarray) -> bool:
    known = values[np.isfinite(values)]
    return spans_decade(known.min(), known.max())


def _level(least: float) -> float | None:
    """The least of 0.5, 0.2, 0.1, 0.05 ... that is clearly above the least upper end; None if there is none."""
    levels = [mantissa * 10.0**-power for power in range(1, 17) for mantissa in (5, 2, 1)]
    return min((level for level in levels if level >= _CLEAR * least), default=None)


def _probability(result: Any) -> str:
    return f"probability of {breaching(result.claim)}"

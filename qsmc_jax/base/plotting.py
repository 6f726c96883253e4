"""What all pictures share: colours that everyone can tell apart, and figures outside any global state."""

from typing import Any

# Okabe and Ito's palette, safe for colour-blind readers.
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, GREY = "#CC79A7", "#56B4E9", "#555555"
SERIES = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)


def new_figure(rows: int, columns: int, size: tuple[float, float]) -> tuple[Any, Any]:
    """A matplotlib figure with a grid of axes, laid out so that no label is clipped. It is never shown by itself.

    Args:
        rows: Rows of axes.
        columns: Columns of axes.
        size: Width and height [inch].

    Returns:
        The figure and an array of axes, (rows, columns).
    """
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, layout="constrained")
    axes = figure.subplots(rows, columns, squeeze=False)
    for ax in axes.flat:
        ax.grid(alpha=0.3)
    return figure, axes


def one_axes(ax: Any, size: tuple[float, float]) -> tuple[Any, Any]:
    """The figure and axes to draw in: those given, or else new ones.

    Args:
        ax: Matplotlib `Axes`, or None.
        size: Width and height of a new figure [inch].
    """
    if ax is not None:
        return ax.figure, ax
    figure, axes = new_figure(1, 1, size)
    return figure, axes[0, 0]

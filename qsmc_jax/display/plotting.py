"""What all pictures share: colours that everyone can tell apart, and the axes they are drawn in."""

from collections.abc import Callable
from contextvars import ContextVar
from io import BytesIO
from typing import Any

import numpy as np

from qsmc_jax.base.checks import require

# Okabe and Ito's palette, safe for colour-blind readers.
BLUE, ORANGE, GREEN, RED = "#0072B2", "#E69F00", "#009E73", "#D55E00"
PURPLE, SKY, GREY = "#CC79A7", "#56B4E9", "#555555"
SERIES = (BLUE, ORANGE, GREEN, PURPLE, SKY, RED)

_is_off_screen: ContextVar[bool] = ContextVar("is_off_screen", default=False)


def off_screen(draw: Callable[[], Any]) -> Any:
    """The figure that a call draws, kept out of pyplot: no window and no notebook shows it. For files and reports.

    Args:
        draw: Draws a picture and returns its axes.

    Returns:
        The matplotlib `Figure`.
    """
    token = _is_off_screen.set(True)
    try:
        return np.ravel(draw())[0].figure
    finally:
        _is_off_screen.reset(token)


def as_png(draw: Callable[[], Any], dpi: int) -> bytes:
    """The picture that a call draws, off screen, as the content of a PNG file.

    Args:
        draw: Draws a picture and returns its axes.
        dpi: Dots per inch.
    """
    content = BytesIO()
    off_screen(draw).savefig(content, format="png", dpi=dpi)
    return content.getvalue()


def one_axes(ax: Any, size: tuple[float, float]) -> Any:
    """The axes to draw in: those given, or else those of a new figure.

    Args:
        ax: Matplotlib `Axes`, or None.
        size: Width and height of a new figure [inch].
    """
    return panels(ax, 1, 1, size)[0]


def panels(ax: Any, count: int, columns: int, size: tuple[float, float]) -> np.ndarray:
    """The axes of a picture with several panels: those given, or else those of a new figure, labels unclipped.

    Args:
        ax: `count` matplotlib `Axes` in reading order, in an array of any shape; None for a new figure.
        count: Number of panels.
        columns: Panels beside each other in a new figure.
        size: Width and height of a new figure [inch].

    Returns:
        The axes, (count,).

    Raises:
        InputError: `ax` holds another number of axes.
    """
    if ax is not None:
        given = np.ravel(np.asarray(ax, dtype=object))
        require(
            len(given) == count and all(hasattr(each, "plot") for each in given),
            f"ax must be matplotlib Axes, {count} for this picture, but is {ax!r}. Leave it out for a new figure.",
        )
        return given
    axes = _new_figure(size).subplots(-(-count // columns), columns, squeeze=False).flat
    for spare in axes[count:]:
        spare.set_visible(False)
    for each in axes[:count]:
        each.grid(alpha=0.3)
    return axes[:count]


def _new_figure(size: tuple[float, float]) -> Any:
    """A figure that pyplot knows, so that notebooks and `plt.show` show it; off screen one that it does not."""
    if _is_off_screen.get():
        from matplotlib.figure import Figure

        return Figure(figsize=size, layout="constrained")
    from matplotlib import pyplot as plt

    return plt.figure(figsize=size, layout="constrained")

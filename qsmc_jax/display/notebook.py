"""What Jupyter shows of a result, and the tables of pandas and xarray."""

import base64
import html
import importlib
import importlib.util
from collections.abc import Callable, Mapping
from typing import Any

from qsmc_jax.base.checks import require
from qsmc_jax.display.plotting import as_png

_STYLE = "line-height:1.25;font-size:85%;margin:0.2em 0"


def as_html(text: str, draw: Callable[[], Any] | None = None) -> str:
    """A text as it is, and below it a small picture.

    Args:
        text: The text.
        draw: Draws it and returns its axes; None for no picture.
    """
    written = f'<pre style="{_STYLE}">{html.escape(text)}</pre>'
    if draw is None:
        return written
    return f'{written}<img src="data:image/png;base64,{base64.b64encode(as_png(draw, dpi=80)).decode()}">'


def as_frame(columns: Mapping[str, Any], index: str) -> Any:
    """A `pandas.DataFrame` of columns of one length.

    Args:
        columns: One-dimensional arrays by name.
        index: The column that becomes the index.

    Raises:
        InputError: pandas is not installed.
    """
    return _optional("pandas").DataFrame(dict(columns)).set_index(index)


def as_dataset(variables: Mapping[str, Any], coordinates: Mapping[str, Any], attributes: Mapping[str, Any]) -> Any:
    """An `xarray.Dataset`.

    Args:
        variables: (dimensions, values, attributes) by name.
        coordinates: Values of the dimensions, by name.
        attributes: Of the whole.

    Raises:
        InputError: xarray is not installed.
    """
    return _optional("xarray").Dataset(dict(variables), dict(coordinates), dict(attributes))


def _optional(package: str) -> Any:
    require(
        importlib.util.find_spec(package) is not None,
        f"This needs {package}, which is not installed: pip install 'qsmc_jax[notebook]'.",
    )
    return importlib.import_module(package)

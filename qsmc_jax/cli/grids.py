"""Values and ranges as a user writes them: `name=lo:hi:log:N`, `name=lo:hi:lin:N`, `name=v1,v2,v3`, `lo:hi`."""

from typing import TYPE_CHECKING

from qsmc_jax.base.errors import InputError

if TYPE_CHECKING:
    import numpy as np

# More is a slip of the pen: a thousand values of a thousand runs each.
_MOST_VALUES = 1000


def parse_grids(texts: list[str]) -> "dict[str, np.ndarray]":
    """The values of each name, from texts like `sample_period=1e-4:1e-1:log:24`.

    Raises:
        InputError: A text is not of that form, or a name comes twice.
    """
    grids = {}
    for text in texts:
        name, separator, values = (part.strip() for part in text.partition("="))
        if not (name and separator and values):
            raise _bad_grid(text)
        if name in grids:
            raise InputError(f"Argument `--over` must name each name once, but has `{name}` twice.")
        grids[name] = _range(text, values) if ":" in values else _list(text, values)
    return grids


def parse_interval(text: str | None) -> tuple[float, float] | None:
    """Two ends, from a text like `1e-4:1e-1`; None for None.

    Raises:
        InputError: The text is not of that form.
    """
    if text is None:
        return None
    try:
        low, high = map(float, text.split(":"))
    except ValueError:
        raise InputError(
            f"Argument `--between` must be lo:hi with two numbers, such as 1e-4:0.1, but is `{text}`."
        ) from None
    return low, high


def _list(text: str, values: str) -> "np.ndarray":
    import numpy as np

    try:
        return np.array([float(part) for part in values.split(",")])
    except ValueError:
        raise _bad_grid(text) from None


def _range(text: str, values: str) -> "np.ndarray":
    import numpy as np

    try:
        low_text, high_text, kind, count_text = values.split(":")
        low, high, count = float(low_text), float(high_text), int(count_text)
    except ValueError:
        raise _bad_grid(text) from None
    if kind not in ("lin", "log"):
        raise _bad_grid(text)
    if not (2 <= count <= _MOST_VALUES and low < high and (kind == "lin" or low > 0.0)):
        raise InputError(
            f"Argument `--over` must have lo < hi, lo > 0 for log, and 2 to {_MOST_VALUES} values, but is `{text}`."
        )
    return np.geomspace(low, high, count) if kind == "log" else np.linspace(low, high, count)


def _bad_grid(text: str) -> InputError:
    return InputError(
        "Argument `--over` must be name=lo:hi:log:N, name=lo:hi:lin:N or name=v1,v2,v3, such as "
        f"sample_period=1e-4:0.1:log:24, but is `{text}`."
    )

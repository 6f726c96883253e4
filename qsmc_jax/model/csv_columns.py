"""Two columns of numbers of a text file, and what is wrong with it."""

import csv
import math
from pathlib import Path

import numpy as np

from qsmc_jax.base.checks import is_whole, nearest, require
from qsmc_jax.base.errors import InputError


def read_columns(path: str | Path, time: str | int, value: str | int) -> tuple[np.ndarray, np.ndarray]:
    """Times and values of a file, a row each.

    Args:
        path: The file, in UTF-8, its cells separated by commas. Empty lines are passed over.
        time: Column of the times, by its name in the first row or by its number, from 0. By numbers, a first row in
            which neither cell is a number is taken for names.
        value: Column of the values.

    Returns:
        Times, increasing, and values, at least two of each.

    Raises:
        InputError: Something is not as it should be; it says in which column of which row.
    """
    rows = _rows(Path(path))
    require(len(rows) > 0, f"File `{path}` must have rows, but is empty.")
    (_, first), columns = rows[0], []
    for argument, column in (("time", time), ("value", value)):
        columns.append(_number_of(argument, column, [name.strip() for name in first], path))
    is_named = isinstance(time, str) or isinstance(value, str)
    is_header = is_named or not any(_is_number(first[i]) for i in columns if i < len(first))
    samples = rows[1:] if is_header else rows
    require(len(samples) >= 2, f"File `{path}` must have at least two rows of numbers, but has {len(samples)}.")
    found = np.array(
        [[_cell(path, line, row, i, first if is_header else []) for i in columns] for line, row in samples]
    )
    times, lines = found[:, 0], [line for line, _ in samples]
    for k in np.flatnonzero(np.diff(times) <= 0.0)[:1]:
        says = "repeats the time" if times[k + 1] == times[k] else "is before that"
        raise InputError(
            f"Row {lines[k + 1]} of column {_told(columns[0], first if is_header else [])} of `{path}` must be a later "
            f"time than the row above, but {times[k + 1]:.12g} {says}. Sort the rows, and keep one a time."
        )
    return times, found[:, 1]


def _rows(path: Path) -> list[tuple[int, list[str]]]:
    """The rows that are not empty, with their line numbers."""
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            reader = csv.reader(file)
            return [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except OSError as error:
        raise InputError(f"File `{path}` can't be read: {error.strerror or error}.") from None
    except (UnicodeDecodeError, csv.Error) as error:
        raise InputError(f"File `{path}` must be a text in UTF-8, separated by commas, but: {error}.") from None


def _number_of(argument: str, column: str | int, names: list[str], path: str | Path) -> int:
    if isinstance(column, str):
        if column not in names:
            has = ", ".join(f"`{name}`" for name in names)
            hint = nearest(column, names)
            raise InputError(
                f"Argument `{argument}` must be a column of `{path}`, but is `{column}`. It has {has}.{hint}"
            )
        return names.index(column)
    require(is_whole(column), f"Argument `{argument}` must be the name of a column or its number, but is {column!r}.")
    require(
        0 <= column < len(names),
        f"Argument `{argument}` must be below the number of columns of `{path}`, {len(names)}, and not negative, "
        f"but is {column}.",
    )
    return column


def _cell(path: str | Path, line: int, row: list[str], column: int, names: list[str]) -> float:
    text = row[column].strip() if column < len(row) else ""
    where = f"Row {line} of column {_told(column, names)} of `{path}`"
    require(text != "", f"{where} must be a number, but is empty.")
    require(_is_number(text), f"{where} must be a number, but is {text!r}.")
    number = float(text)
    require(math.isfinite(number), f"{where} must be finite, but is {text!r}.")
    return number


def _told(column: int, names: list[str]) -> str:
    return f"`{names[column].strip()}`" if column < len(names) else str(column)


def _is_number(text: str) -> bool:
    try:
        float(text)
    except ValueError:
        return False
    return True

"""A result folder that appears whole or not at all."""

import shutil
import warnings
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from qsmc_jax.base.atomic import remove_leftovers, temporary_beside
from qsmc_jax.base.checks import require
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.json_numbers import to_json
from qsmc_jax.display.plotting import as_png
from qsmc_jax.report.saved import RESULT, as_bytes


class ResultFolder:
    """A new folder, filled under a temporary name beside it and renamed when everything is in it.

    Use it as a context: leaving without `commit` removes what was written, and nothing that existed before is touched.
    """

    def __init__(self, path: Path):
        """Makes the temporary folder.

        Raises:
            InputError: The folder exists already, or can't be made.
        """
        self.path = path
        advice = "Choose another folder, or move this one away."
        require(not path.exists(), f"Argument `--out` must be a new folder, but `{path}` exists. {advice}")
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            remove_leftovers(path.parent, path.name)
            self._temporary = temporary_beside(path)
            self._temporary.mkdir()
        except OSError as error:
            raise InputError(
                f"Argument `--out` must be a folder that can be made, but `{path}` can't: {error}."
            ) from None

    def __enter__(self) -> "ResultFolder":
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        shutil.rmtree(self._temporary, ignore_errors=True)

    def add_table(self, name: str, columns: Mapping[str, Any]) -> None:
        """Writes a table of NumPy columns as one Parquet file."""
        pq.write_table(pa.table(dict(columns)), self._temporary / name, compression="zstd")

    def add_file(self, name: str, content: bytes) -> None:
        """Writes a file as it is."""
        (self._temporary / name).write_bytes(content)

    def add_json(self, name: str, content: Mapping[str, Any]) -> None:
        """Writes a JSON file; for numbers that JSON does not know see `to_json`."""
        (self._temporary / name).write_text(to_json(content) + "\n", encoding="utf-8")

    def add_result(self, result: Any) -> None:
        """Writes the result for `qj.load`; one that can't be kept is a warning: its numbers are there."""
        try:
            (self._temporary / RESULT).write_bytes(as_bytes(result))
        except InputError as error:
            warnings.warn(f"`{RESULT}` is left out: {error}", stacklevel=2)

    def add_picture(self, name: str, draw: Callable[[], Any]) -> None:
        """Writes the picture that a call draws, as PNG; one that can't be drawn is a warning: the numbers are there."""
        try:
            (self._temporary / name).write_bytes(as_png(draw, dpi=150))
        except OSError:
            raise
        except Exception as error:  # noqa: BLE001  # whatever a picture may raise
            warnings.warn(f"Picture `{name}` could not be drawn: {type(error).__name__}: {error}", stacklevel=2)

    def commit(self) -> None:
        """Gives the folder its name."""
        self._temporary.rename(self.path)

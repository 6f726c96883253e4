"""Loading the study that a user names, and the overrides that go with it."""

import json
import runpy
import traceback
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from qsmc_jax.study.study import Study


def load_study(path: Path, overrides: list[str]) -> "Study":
    """Runs a study file and returns its `study`, with the overrides substituted.

    Args:
        path: A Python file that defines `study = qsmc_jax.Study(...)`.
        overrides: Texts `name=value`; a value is a number, or numbers with commas between them. `@path` stands for
            the gains in the result of `qsmc tune`, its folder or its JSON file.

    Raises:
        ValueError: The file is missing, raises, or has no `study`; or an override is wrong.
    """
    from qsmc_jax.study.study import Study

    names = _run(path)
    if not isinstance(names.get("study"), Study):
        found = "no `study`" if "study" not in names else f"a `study` that is a `{type(names['study']).__name__}`"
        raise ValueError(f"File `{path}` must define `study = qsmc_jax.Study(scenario, bandwidth)`, but has {found}.")
    return names["study"].substitute(**_values(overrides))


def load_studies(path: Path, overrides: list[str]) -> "dict[str, Study]":
    """Runs a study file and returns its `studies`, with the overrides substituted in each.

    Args:
        path: A Python file that defines `studies`, a dictionary of `qsmc_jax.Study` by name.
        overrides: As for `load_study`; every study must have the names.

    Raises:
        ValueError: The file is missing, raises, or has no `studies`; or an override is wrong.
    """
    from qsmc_jax.study.study import Study

    studies = _run(path).get("studies")
    is_named = isinstance(studies, dict) and all(isinstance(name, str) for name in studies)
    if not (studies and is_named and all(isinstance(study, Study) for study in studies.values())):
        raise ValueError(f"File `{path}` must define `studies`, a dictionary of `qsmc_jax.Study` by name, but has not.")
    values = _values(overrides)
    return {name: study.substitute(**values) for name, study in studies.items()}


def _run(path: Path) -> dict[str, Any]:
    """The names that the file defines; whatever it raises is told with its line, without our own frames."""
    if not path.is_file():
        raise ValueError(f"Argument `STUDY` must be a Python file, but there is no file `{path}`.")
    try:
        return runpy.run_path(str(path))
    except Exception as error:
        lines = [frame.lineno for frame in _frames(error) if frame.filename == str(path)]
        place = f", line {lines[-1]}" if lines else ""
        raise ValueError(f"File `{path}`{place}: {type(error).__name__}: {error}") from None


def _frames(error: BaseException | None) -> Iterator[traceback.FrameSummary]:
    """The calls that led to an error, then those that led to what it was raised from: the last is nearest the cause."""
    while error is not None:
        yield from traceback.extract_tb(error.__traceback__)
        error = error.__cause__


def _values(overrides: list[str]) -> dict[str, Any]:
    """The numbers to substitute, later ones over earlier."""
    values: dict[str, Any] = {}
    for override in overrides:
        values.update(_gains(Path(override[1:])) if override.startswith("@") else [_parse(override)])
    return values


def _gains(path: Path) -> dict[str, float]:
    """The gains that a tuning wrote."""
    file = path / "tuning.json" if path.is_dir() else path
    try:
        return {
            str(name): float(value) for name, value in json.loads(file.read_text(encoding="utf-8"))["gains"].items()
        }
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        reason = f"{type(error).__name__}: {error}"
        raise ValueError(
            f"Argument `-S @...` must name a result of `qsmc tune`, but `{file}` is none: {reason}."
        ) from None


def _parse(override: str) -> tuple[str, Any]:
    name, separator, text = override.partition("=")
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not (name and separator and values):
        raise ValueError(f"Argument `-S` must be name=value with a number, such as mu=2.5, but is `{override}`.")
    return name.strip(), values[0] if len(values) == 1 else values

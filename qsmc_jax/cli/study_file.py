"""Loading the study that a user names, and the overrides that go with it."""

import dataclasses
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any

from qsmc_jax.base.errors import InputError
from qsmc_jax.base.script import run_script
from qsmc_jax.cli.blame import frames_of, told, users_line
from qsmc_jax.cli.opened import files_read

if TYPE_CHECKING:
    from qsmc_jax.study.study import Study


@dataclasses.dataclass(frozen=True)
class Source:
    """A study's file, read once: what is run is what is hashed and kept.

    Attributes:
        path: The file, as the user named it.
        content: Its bytes.
        files: Hashes of the other files it reads, by name; known once it was run.
    """

    path: Path
    content: bytes
    files: dict[str, str] = dataclasses.field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> "Source":
        """Reads the file.

        Args:
            path: A Python file.

        Raises:
            InputError: There is no such file, or it can't be read.
        """
        if not path.is_file():
            raise InputError(f"Argument `STUDY` must be a Python file, but there is no file `{path}`.")
        try:
            return cls(path, path.read_bytes())
        except OSError as error:
            raise InputError(f"File `{path}` can't be read: {error.strerror}.") from None

    def run(self) -> dict[str, Any]:
        """The names that the file defines; whatever it raises is told with its line, without our own frames.

        Raises:
            InputError: It raises something, not by a defect of ours.
        """
        file = str(self.path)
        try:
            program = compile(self.content, file, "exec", dont_inherit=True)
        except (SyntaxError, ValueError) as error:
            raise InputError(f"File `{file}`: {told(error)}") from None
        try:
            with files_read(self.path.parent) as files:
                names = run_script(program, file)
        except (Exception, SystemExit) as error:
            if not (isinstance(error, InputError) or users_line(error)):
                raise
            lines = [frame.lineno for frame in frames_of(error) if frame.filename == file]
            place = f", line {lines[-1]}" if lines else ""
            raise InputError(f"File `{file}`{place}: {told(error)}") from error
        self.files.update(files)
        return names


def load_study(source: Source, overrides: list[str]) -> "Study":
    """Runs a study file and returns its `study`, with the overrides substituted.

    Args:
        source: A Python file that defines `study = qsmc_jax.Study(...)`.
        overrides: Texts `name=value`; a value is a number, or numbers with commas between them. `@path` stands for
            the gains in the result of `qsmc tune`, its folder or its JSON file.

    Raises:
        InputError: The file raises, or has no `study`; or an override is wrong.
    """
    from qsmc_jax.study.study import Study

    names = source.run()
    if not isinstance(names.get("study"), Study):
        found = "no `study`" if "study" not in names else f"a `study` that is a `{type(names['study']).__name__}`"
        raise InputError(
            f"File `{source.path}` must define `study = qsmc_jax.Study(scenario, bandwidth)`, but has {found}."
        )
    return names["study"].substitute(**_values(overrides))


def load_studies(source: Source, overrides: list[str]) -> "dict[str, Study]":
    """Runs a study file and returns its `studies`, with the overrides substituted in each.

    Args:
        source: A Python file that defines `studies`, a dictionary of `qsmc_jax.Study` by name.
        overrides: As for `load_study`; every study must have the names.

    Raises:
        InputError: The file raises, or has no `studies`; or an override is wrong.
    """
    from qsmc_jax.study.study import Study

    studies = source.run().get("studies")
    is_named = isinstance(studies, dict) and all(isinstance(name, str) for name in studies)
    if not (studies and is_named and all(isinstance(study, Study) for study in studies.values())):
        raise InputError(
            f"File `{source.path}` must define `studies`, a dictionary of `qsmc_jax.Study` by name, but has not."
        )
    values = _values(overrides)
    return {name: study.substitute(**values) for name, study in studies.items()}


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
        raise InputError(
            f"Argument `-S @...` must name a result of `qsmc tune`, but `{file}` is none: {reason}."
        ) from None


def _parse(override: str) -> tuple[str, Any]:
    name, separator, text = override.partition("=")
    try:
        values = [float(part) for part in text.split(",")]
    except ValueError:
        values = []
    if not (name and separator and values):
        raise InputError(f"Argument `-S` must be name=value with a number, such as mu=2.5, but is `{override}`.")
    return name.strip(), values[0] if len(values) == 1 else values

"""The run folder of a campaign: manifest, study, blocks of rows, and a note for each session of work."""

import dataclasses
import datetime
import json
import os
import platform
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from qsmc_jax.base.checks import require, require_count
from qsmc_jax.base.errors import InputError
from qsmc_jax.campaign.atomic import write_whole
from qsmc_jax.campaign.blocks import BlockFile, block_files, gaps, write_block
from qsmc_jax.campaign.recipe import Recipe, Solved, fingerprint, require_same
from qsmc_jax.study.draw import DrawSpec
from qsmc_jax.study.runs import Runs
from qsmc_jax.verification.stopping import LOOK

SCHEMA = 2
FILE_RUNS = LOOK


@dataclasses.dataclass(frozen=True)
class RunFolder:
    """A folder with a manifest. Reading it runs nothing that is in it.

    Attributes:
        path: The folder.

    Examples:
        >>> import pathlib
        >>> import tempfile
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> recipe = qj.campaign.Recipe(qj.Study(scenario, bandwidth=0.1), source=b"study = ...")
        >>> with tempfile.TemporaryDirectory() as place:
        ...     folder = qj.campaign.prepare(pathlib.Path(place, "run"), recipe)
        ...     qj.campaign.RunFolder.open(folder.path).missing(0, 128)
        [range(0, 128)]
    """

    path: Path

    @classmethod
    def create(
        cls, path: Path, recipe: Recipe, study_file: str, file_runs: int, provenance: Mapping[str, Any]
    ) -> "RunFolder":
        """Makes the folder.

        Args:
            path: A new or empty folder.
            recipe: What decides its rows.
            study_file: The study's file, as the user named it.
            file_runs: Runs in each block file, at least 1.
            provenance: Versions, machine and time, plain values.

        Raises:
            InputError: The folder has something else in it, or can't be made.
        """
        require_count("file_runs", file_runs)
        try:
            path.mkdir(parents=True, exist_ok=True)
            is_empty = not any(path.iterdir())
            require(
                is_empty,
                f"Argument `--out` must be a new folder or one of this study, but `{path}` holds something else.",
            )
            (path / "blocks").mkdir()
            (path / "sessions").mkdir()
        except OSError as error:
            message = f"Argument `--out` must be a folder that can be made, but `{path}` can't: {error.strerror}."
            raise InputError(message) from None
        folder = cls(path)
        write_whole(path / "study.py", recipe.source)
        folder.write_json(
            "manifest.json",
            {
                "schema": SCHEMA,
                "fingerprint": fingerprint(recipe.identity),
                "identity": recipe.identity,
                "study_file": study_file,
                "study_path": str(Path(study_file).resolve()),
                "file_runs": file_runs,
                "asked_for": [],
                "is_anytime": False,
                "provenance": dict(provenance),
            },
        )
        return folder

    @classmethod
    def open(cls, path: Path) -> "RunFolder":
        """A folder that exists.

        Args:
            path: The folder.

        Raises:
            InputError: It is none, or of a newer version of this package.
        """
        folder = cls(path)
        require(folder.exists, f"Argument `RUN` must be the folder of a campaign, but `{path}` has no `manifest.json`.")
        require(
            folder.manifest.get("schema") == SCHEMA,
            f"Folder `{path}` has schema {folder.manifest.get('schema')!r}, but this version reads {SCHEMA}.",
        )
        return folder

    @property
    def exists(self) -> bool:
        """Whether there is a manifest."""
        return (self.path / "manifest.json").is_file()

    @property
    def manifest(self) -> dict[str, Any]:
        """What is known of the whole campaign."""
        return self.read_json("manifest.json")

    def read_json(self, name: str) -> dict[str, Any]:
        """A JSON file of the folder.

        Args:
            name: Its name, relative to the folder.

        Raises:
            InputError: It is missing or damaged.
        """
        try:
            return json.loads((self.path / name).read_text(encoding="utf-8"))
        except (OSError, ValueError) as error:
            raise InputError(f"File `{self.path / name}` can't be read: {error}.") from None

    def check(self, recipe: Recipe) -> None:
        """Raises, with the keys that differ, unless the recipe is the folder's own.

        Args:
            recipe: What is asked for.
        """
        require_same(self.manifest["identity"], recipe.identity, str(self.path))

    def ask_for(self, runs: int, is_anytime: bool) -> bool:
        """Notes how many runs are asked for; from the second number on, or with a stopping rule, one has looked.

        Args:
            runs: How many.
            is_anytime: Whether there is a stopping rule.

        Returns:
            Whether intervals must hold at any time.
        """
        manifest = self.manifest
        asked_for = manifest["asked_for"]
        changed = {
            **manifest,
            "asked_for": asked_for if runs in asked_for else [*asked_for, runs],
            "is_anytime": manifest["is_anytime"] or is_anytime or asked_for not in ([], [runs]),
        }
        if changed != manifest:
            self.write_json("manifest.json", changed)
        return changed["is_anytime"]

    def sound_files(self, start: int, stop: int) -> list[BlockFile]:
        """Files with runs of a range whose bytes are as they were written; others are put aside, with a warning.

        Args:
            start: First run.
            stop: Run after the last.
        """
        sound = []
        for file in block_files(self.path / "blocks"):
            if file.start < stop and file.stop > start:
                if file.is_sound:
                    sound.append(file)
                else:
                    self._put_aside(file)
        return sound

    def missing(self, start: int, stop: int) -> list[range]:
        """What of the runs start ... stop - 1 is still to be solved.

        Args:
            start: First run.
            stop: Run after the last.
        """
        return gaps(self.sound_files(start, stop), start, stop)

    def add(self, solved: Solved, specs: tuple[DrawSpec, ...]) -> None:
        """Writes rows of consecutive runs as a block file.

        Args:
            solved: The rows, and what they cost.
            specs: The names that they were drawn by.
        """
        about = {"escalated": solved.escalated, "defects": solved.defects}
        write_block(self.path / "blocks", solved.rows, about, specs)

    def tables(self, start: int = 0, stop: int | None = None) -> Iterator[Runs]:
        """Rows of the runs start ... stop - 1 that there are, in order, each once; damaged files are passed over.

        Args:
            start: First run.
            stop: Run after the last; None for all.
        """
        reached = start
        for file in block_files(self.path / "blocks"):
            if (stop is not None and file.start >= stop) or file.stop <= reached:
                continue
            if not file.is_sound:
                warnings.warn(f"File `{file.path}` is damaged and passed over.", stacklevel=2)
                continue
            table = file.read()
            index = table["index"]
            yield table.take((index >= reached) & (index < (file.stop if stop is None else stop)))
            reached = file.stop

    def effort(self, stop: int) -> dict[str, Any]:
        """Escalated runs and defects of the blocks up to a run.

        Args:
            stop: Run after the last.
        """
        escalated, defects = [0, 0], set()
        for file in block_files(self.path / "blocks"):
            if file.start < stop:
                about = file.about()
                escalated = [a + b for a, b in zip(escalated, about["escalated"], strict=True)]
                defects.update(index for index in about["defects"] if index < stop)
        return {"escalated": tuple(escalated), "defects": tuple(sorted(defects))}

    def sessions(self) -> list[dict[str, Any]]:
        """The notes of all sessions, the oldest first."""
        return [self.read_json(f"sessions/{path.name}") for path in sorted((self.path / "sessions").glob("[!.]*.json"))]

    def begin_session(self, provenance: Mapping[str, Any]) -> "Session":
        """A note for the work of this process.

        Args:
            provenance: Versions, machine and time, plain values.
        """
        began = datetime.datetime.now(datetime.UTC)
        name = f"{began:%Y%m%dT%H%M%S%f}-{platform.node()}-{os.getpid()}.json"
        return Session(self.path / "sessions" / name, {"began": began.isoformat(), "provenance": dict(provenance)})

    def write_json(self, name: str, content: Mapping[str, Any]) -> None:
        """Writes a JSON file of the folder.

        Args:
            name: Its name, relative to the folder.
            content: Plain values.
        """
        write_whole(self.path / name, json.dumps(content, indent=2, allow_nan=False).encode() + b"\n")

    def _put_aside(self, file: BlockFile) -> None:
        aside = self.path / "damaged"
        warnings.warn(f"File `{file.path}` is damaged: moved to `{aside}`, its runs are solved again.", stacklevel=4)
        try:
            aside.mkdir(exist_ok=True)
            os.replace(file.path, aside / file.path.name)
        except FileNotFoundError:
            pass  # another worker was quicker
        except OSError as error:
            message = f"File `{file.path}` is damaged and can't be moved to `{aside}`: {error.strerror}."
            raise InputError(message) from None


@dataclasses.dataclass
class Session:
    """What one process did, kept up to date in a file of its own.

    Attributes:
        path: The file.
        about: When and where it began.
        runs: Runs solved.
        steps: Solver steps of their first solves.
        paid: Steps made by all lanes for them.
        seconds: Time taken [s].
    """

    path: Path
    about: dict[str, Any]
    runs: int = 0
    steps: int = 0
    paid: int = 0
    seconds: float = 0.0

    def add(self, solved: Solved) -> None:
        """Counts rows that were solved and written."""
        self.runs += len(solved.rows)
        self.steps += solved.steps
        self.paid += solved.paid
        self.seconds += solved.seconds
        self.write("running")

    def write(self, state: str) -> None:
        """Writes the note: "running", "interrupted" or "done"."""
        counts = {name: getattr(self, name) for name in ("runs", "steps", "paid", "seconds")}
        updated = datetime.datetime.now(datetime.UTC).isoformat()
        content = {**self.about, "updated": updated, "state": state, **counts}
        write_whole(self.path, json.dumps(content, indent=2).encode())

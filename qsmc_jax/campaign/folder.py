"""The run folder of a campaign: manifest, study, blocks of rows, and a note for each session of work."""

import dataclasses
import datetime
import json
import logging
import os
import shutil
import warnings
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from qsmc_jax.base.atomic import is_dead, machine, remove_leftovers, temporary_beside, write_whole
from qsmc_jax.base.checks import require, require_count
from qsmc_jax.base.errors import InputError
from qsmc_jax.campaign.blocks import Block, BlockError, BlockFile, block_files, gaps, write_block
from qsmc_jax.campaign.config import CampaignConfig, Solved, fingerprint, require_same
from qsmc_jax.campaign.documents import IDENTITY, MANIFEST, REQUEST, SESSION, SUMMARY, read_document, require_keys
from qsmc_jax.metrics.record import Record
from qsmc_jax.study.runs import Runs
from qsmc_jax.verification.stopping import LOOK

_LOG = logging.getLogger(__name__)

SCHEMA = 4
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
        >>> config = qj.campaign.CampaignConfig(qj.Study(scenario, bandwidth=0.1), source=b"study = ...")
        >>> with tempfile.TemporaryDirectory() as place:
        ...     folder = qj.campaign.prepare(pathlib.Path(place, "run"), config)
        ...     qj.campaign.RunFolder.open(folder.path).missing(0, 128)
        [range(0, 128)]
    """

    path: Path

    @classmethod
    def create(
        cls, path: Path, config: CampaignConfig, study_file: str, file_runs: int, provenance: Mapping[str, Any]
    ) -> "RunFolder":
        """Makes the folder, or opens it if it is the same campaign's.

        Args:
            path: A new or empty folder, or that of the same campaign.
            config: What decides its rows.
            study_file: The study's file, as the user named it.
            file_runs: Runs in each block file, at least 1.
            provenance: Versions, machine and time, plain values.

        Raises:
            InputError: The folder has something else in it, or can't be made, or is of another study.
        """
        require_count("file_runs", file_runs)
        remove_leftovers(path.parent, path.name)
        new = temporary_beside(path)
        try:
            is_free = not path.exists() or (path.is_dir() and not any(path.iterdir()))
            if cls(path).exists:  # it is there already, or somebody else has just made it
                return cls._joined(path, config)
            require(
                is_free,
                f"Argument `--out` must be a new folder or one of this study, but `{path}` holds something else.",
            )
            path.parent.mkdir(parents=True, exist_ok=True)
            new.mkdir()
            for name in ("blocks", "sessions", "requests"):
                (new / name).mkdir()
            write_whole(new / "study.py", config.source)
            manifest = {
                "schema": SCHEMA,
                "fingerprint": fingerprint(config.identity),
                "identity": config.identity,
                "study_file": study_file,
                "study_path": str(Path(study_file).resolve()),
                "machine": machine(),
                "files": dict(config.files),
                "file_runs": file_runs,
                "provenance": dict(provenance),
            }
            cls(new).write_json("manifest.json", manifest)
            # In one go: whoever finds the folder finds it whole. One that somebody else has just made is his.
            os.rename(new, path)
        except OSError as error:
            shutil.rmtree(new, ignore_errors=True)
            if cls(path).exists:
                return cls._joined(path, config)
            message = f"Argument `--out` must be a folder that can be made, but `{path}` can't: {error.strerror}."
            raise InputError(message) from None
        except BaseException:
            shutil.rmtree(new, ignore_errors=True)
            raise
        return cls(path)

    @classmethod
    def _joined(cls, path: Path, config: CampaignConfig) -> "RunFolder":
        """The folder that is there, if it is of the same campaign."""
        made = cls.open(path)
        made.check(config)
        return made

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
        schema = read_document(path / "manifest.json", {"schema": int})["schema"]
        made_by = "a newer version of qsmc_jax: use that" if schema > SCHEMA else "an older version: begin anew"
        require(
            schema == SCHEMA,
            f"Folder `{path}` has schema {schema}, but this version reads {SCHEMA}. It is of {made_by}.",
        )
        return folder

    @property
    def exists(self) -> bool:
        """Whether there is a manifest."""
        return (self.path / "manifest.json").is_file()

    @property
    def manifest(self) -> dict[str, Any]:
        """What is known of the whole campaign; never changed."""
        path = self.path / "manifest.json"
        manifest = read_document(path, MANIFEST)
        require_keys(manifest["identity"], IDENTITY, f"Key `identity` of file `{path}`")
        return manifest

    @property
    def fingerprint(self) -> str:
        """What decides the rows, as a short hash."""
        return self.manifest["fingerprint"]

    def summary(self) -> dict[str, Any] | None:
        """What was found in the end; None if that is not known yet."""
        path = self.path / "summary.json"
        return read_document(path, SUMMARY) if path.is_file() else None

    def check(self, config: CampaignConfig) -> None:
        """Raises, with the keys that differ, unless the config is the folder's own.

        Args:
            config: What is asked for.
        """
        manifest = self.manifest
        there, now = manifest["files"], config.files
        changed = [f"`{name}`" for name in {**there, **now} if there.get(name) != now.get(name)]
        hint = f" Of what the study read, {', '.join(changed)} is not what it was." if changed else ""
        require_same(manifest["identity"], config.identity, str(self.path), hint)

    def ask_for(self, runs: int, is_anytime: bool) -> bool:
        """Notes how many runs are asked for; from the second number on, or with a stopping rule, one has looked.

        Args:
            runs: How many.
            is_anytime: Whether there is a stopping rule.

        Returns:
            Whether intervals must hold at any time.
        """
        require_count("runs", runs)
        name = f"{runs:012d}{'-anytime' if is_anytime else ''}.json"
        if not (self.path / "requests" / name).exists():
            self.write_json(f"requests/{name}", {"runs": runs, "is_anytime": is_anytime})
        return self.is_anytime

    def _requests(self) -> list[dict[str, Any]]:
        paths = sorted((self.path / "requests").glob("[!.]*.json"))
        return [read_document(path, REQUEST) for path in paths]

    @property
    def asked_for(self) -> list[int]:
        """Numbers of runs asked for, ascending; each request is a file of its own, so that none is lost."""
        return sorted({each["runs"] for each in self._requests()})

    @property
    def is_anytime(self) -> bool:
        """Whether intervals must hold at any time: somebody may have looked before deciding how many runs."""
        return len(self.asked_for) > 1 or any(each["is_anytime"] for each in self._requests())

    def sound_files(self, start: int, stop: int) -> list[BlockFile]:
        """Files with runs of a range that are what they should be; others are put aside, with a warning.

        Args:
            start: First run.
            stop: Run after the last.
        """
        sound, owner = [], self.fingerprint
        for file in block_files(self.path / "blocks"):
            if file.start < stop and file.stop > start:
                try:
                    file.read(owner)
                except BlockError as fault:
                    self._put_aside(file, str(fault))
                else:
                    sound.append(file)
        return sound

    def missing(self, start: int, stop: int) -> list[range]:
        """What of the runs start ... stop - 1 is still to be solved.

        Args:
            start: First run.
            stop: Run after the last.
        """
        return gaps(self.sound_files(start, stop), start, stop)

    def add(self, solved: Solved, records: Mapping[str, Record]) -> None:
        """Writes rows of consecutive runs as a block file.

        Args:
            solved: The rows, and what they cost.
            records: What is known of the columns that the study alone has.
        """
        about = {"escalated": solved.escalated, "defects": solved.defects}
        write_block(self.path / "blocks", solved.rows, about, records, self.fingerprint)
        _LOG.info("wrote %d rows from run %d on", len(solved.rows), solved.rows["index"][0])

    def schema(self) -> Any:
        """The columns as pyarrow has them, with descriptions and units; there must be a block."""
        import pyarrow.parquet as pq

        return pq.read_schema(block_files(self.path / "blocks")[0].path)

    def tables(self, start: int = 0, stop: int | None = None) -> Iterator[Runs]:
        """Rows of the runs start ... stop - 1 that there are, in order, each once; damaged files are skipped.

        Args:
            start: First run.
            stop: Run after the last; None for all.
        """
        reached, owner = start, self.fingerprint
        for file in block_files(self.path / "blocks"):
            if (stop is not None and file.start >= stop) or file.stop <= reached:
                continue
            block = _read(file, owner)
            if block is not None:
                index = block.rows["index"]
                yield block.rows.take((index >= reached) & (index < (file.stop if stop is None else stop)))
                reached = file.stop

    def blocks(self, most: int | None = None) -> Iterator[tuple[BlockFile, Block]]:
        """The blocks, by their range; files that are not the campaign's are skipped with a warning.

        Args:
            most: Of more than so many, some that are spread evenly; None for all.
        """
        files, owner = block_files(self.path / "blocks"), self.fingerprint
        stride = -(-len(files) // most) if most else 1
        for file in files[:: max(stride, 1)]:
            block = _read(file, owner)
            if block is not None:
                yield file, block

    def cost(self, stop: int) -> dict[str, Any]:
        """Escalated runs and defects of the blocks up to a run.

        Args:
            stop: Run after the last.
        """
        escalated, defects = [0, 0], set()
        for file, block in self.blocks():
            if file.start < stop:
                escalated = [a + b for a, b in zip(escalated, block.about["escalated"], strict=True)]
                defects.update(index for index in block.about["defects"] if index < stop)
        return {"escalated": tuple(escalated), "defects": tuple(sorted(defects))}

    def sessions(self) -> list[dict[str, Any]]:
        """The notes of all sessions, the oldest first."""
        return [read_document(path, SESSION) for path in sorted((self.path / "sessions").glob("[!.]*.json"))]

    def sweep(self) -> None:
        """Removes what processes left behind that died on this machine, and notes that their sessions ended."""
        for place in (self.path, *(self.path / name for name in ("blocks", "sessions", "requests", "figures"))):
            remove_leftovers(place)
        for path in (self.path / "sessions").glob("[!.]*.json"):
            note = read_document(path, SESSION)
            if note["state"] == "running" and is_dead(note.get("machine", ""), note.get("process")):
                write_whole(path, json.dumps({**note, "state": "interrupted"}, indent=2).encode())

    def begin_session(self, provenance: Mapping[str, Any]) -> "Session":
        """A note for the work of this process.

        Args:
            provenance: Versions, machine and time, plain values.
        """
        self.sweep()
        began = datetime.datetime.now(datetime.UTC)
        name = f"{began:%Y%m%dT%H%M%S%f}-{machine()}-{os.getpid()}.json"
        about = {"began": began.isoformat(), "machine": machine(), "process": os.getpid()}
        return Session(self.path / "sessions" / name, {**about, "provenance": dict(provenance)})

    def write_json(self, name: str, content: Mapping[str, Any]) -> None:
        """Writes a JSON file of the folder.

        Args:
            name: Its name, relative to the folder.
            content: Plain values.
        """
        write_whole(self.path / name, json.dumps(content, indent=2, allow_nan=False).encode() + b"\n")

    def _put_aside(self, file: BlockFile, fault: str) -> None:
        aside = self.path / "damaged"
        warnings.warn(f"File `{file.path}` {fault}: moved to `{aside}`, its runs are solved again.", stacklevel=4)
        try:
            aside.mkdir(exist_ok=True)
            os.replace(file.path, aside / file.path.name)
        except FileNotFoundError:
            pass  # another worker was quicker
        except OSError as error:
            message = f"File `{file.path}` {fault} and can't be moved to `{aside}`: {error.strerror}."
            raise InputError(message) from None


def _read(file: BlockFile, owner: str) -> Block | None:
    """What is in a file; None, with a warning, if it is no block of the campaign."""
    try:
        return file.read(owner)
    except BlockError as fault:
        warnings.warn(f"File `{file.path}` {fault}: passed over.", stacklevel=3)
        return None


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

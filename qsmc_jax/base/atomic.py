"""Files that appear whole or not at all."""

import contextlib
import os
import platform
import shutil
import uuid
from pathlib import Path
from typing import Any

from qsmc_jax.base.errors import InputError


def write_whole(path: Path, content: bytes) -> None:
    """Writes under a temporary name beside it, flushes to the disk, and renames.

    Args:
        path: The file; one that exists is replaced.
        content: All of it.

    Raises:
        InputError: The disk is full, or the folder can't be written to. Nothing is left behind.
    """
    temporary = temporary_beside(path)
    try:
        with temporary.open("wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        os.replace(temporary, path)
        _flush_folder(path.parent)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink()
        raise InputError(
            f"File `{path}` can't be written: {error.strerror}. What was written before is whole: make room, or make "
            "the folder writable, and give the same command again."
        ) from None


def temporary_beside(path: Path) -> Path:
    """A new hidden name beside a file or folder, which says what process it is of."""
    return path.with_name(f".{path.name[:100]}.{machine()}.{os.getpid()}.{uuid.uuid4().hex[:8]}.tmp")


def remove_leftovers(folder: Path, name: str = "") -> None:
    """Removes temporary files and folders of processes of this machine that are dead.

    Args:
        folder: Where to look.
        name: Of what they are temporary; empty for all.
    """
    if not folder.is_dir():
        return
    for path in folder.glob(".*.tmp"):
        parts = path.name.rsplit(".", 4)
        is_ours = len(parts) == 5 and parts[2].isdigit() and (not name or parts[0] == f".{name[:100]}")
        if is_ours and is_dead(parts[1], int(parts[2])):
            shutil.rmtree(path, ignore_errors=True) if path.is_dir() else path.unlink(missing_ok=True)


def machine() -> str:
    """The name of this machine, short and without dots, to stand in names of files."""
    return platform.node().replace(".", "_")[:40]


def is_dead(where: str, process: Any) -> bool:
    """Whether a process is known to be gone: it was of this machine, and has ended."""
    if where != machine() or not isinstance(process, int):
        return False
    try:
        os.kill(process, 0)
    except ProcessLookupError:
        return True
    except OSError:
        return False
    return False


def _flush_folder(folder: Path) -> None:
    """Has the new name survive a power failure, where the system can be asked to."""
    if hasattr(os, "O_DIRECTORY"):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

"""Files that appear whole or not at all."""

import contextlib
import os
import uuid
from pathlib import Path

from qsmc_jax.base.errors import InputError


def write_whole(path: Path, content: bytes) -> None:
    """Writes under a temporary name beside it, flushes to the disk, and renames.

    Args:
        path: The file; one that exists is replaced.
        content: All of it.

    Raises:
        InputError: The disk is full, or the folder can't be written to. Nothing is left behind.
    """
    temporary = path.with_name(f".{path.name}.{os.getpid()}-{uuid.uuid4().hex[:8]}.tmp")
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


def _flush_folder(folder: Path) -> None:
    """Has the new name survive a power failure, where the system can be asked to."""
    if hasattr(os, "O_DIRECTORY"):
        descriptor = os.open(folder, os.O_RDONLY | os.O_DIRECTORY)
        try:
            os.fsync(descriptor)
        finally:
            os.close(descriptor)

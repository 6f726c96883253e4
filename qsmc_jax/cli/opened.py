"""What a study reads apart from its own file: data, and modules that it imports."""

import contextlib
import functools as ft
import hashlib
import os
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from qsmc_jax.cli.blame import is_library

# Files opened for reading while somebody wants to know.
_WATCHED: list[set[str]] = []
_SYSTEM = ("/proc/", "/sys/", "/dev/", "/etc/")


@contextlib.contextmanager
def files_read(beside: Path) -> Iterator[dict[str, str]]:
    """Yields a dictionary that has, in the end, a hash of each file read inside, by its name seen from a folder.

    Modules of Python count if they lie in that folder, whether they are read now or were imported before.

    Args:
        beside: The folder.
    """
    _install()
    found: dict[str, str] = {}
    opened: set[str] = set()
    _WATCHED.append(opened)
    try:
        yield found
    finally:
        _WATCHED.remove(opened)
        folder = beside.resolve()
        modules = {str(getattr(module, "__file__", None) or "") for module in list(sys.modules.values())}
        inside = {file for file in modules if file.endswith(".py") and folder in Path(file).resolve().parents}
        for file in sorted(opened | inside):
            if not (is_library(file) or file.startswith(_SYSTEM) or file.endswith((".pyc", ".so"))):
                with contextlib.suppress(OSError):
                    content = Path(file).read_bytes()
                    found[os.path.relpath(file, folder)] = hashlib.sha256(content).hexdigest()[:16]


@ft.cache
def _install() -> None:
    """Has Python tell of every file that is opened; a hook can't be removed, so it is there once."""
    sys.addaudithook(_hear)


def _hear(event: str, arguments: tuple[Any, ...]) -> None:
    if _WATCHED and event == "open":
        path, _, flags = arguments
        is_read = not (isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR))
        if is_read and isinstance(path, str | bytes | os.PathLike):
            for opened in _WATCHED:
                opened.add(os.path.abspath(os.fsdecode(path)))

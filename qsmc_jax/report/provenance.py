"""Where a result comes from: what is needed to get it again."""

import datetime
import hashlib
import importlib.metadata
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

_PACKAGES = ("qsmc_jax", "jax", "jaxlib", "diffrax", "equinox", "numpy", "scipy")


def provenance(study_file: Path, source: bytes, command: list[str]) -> dict[str, Any]:
    """Study file and its hash, command, time, versions, machine and the state of its repository, as plain values.

    Args:
        study_file: The study that was run.
        source: Its bytes.
        command: The command line.
    """
    return {
        "study": study_file.name,
        "study_sha256": hashlib.sha256(source).hexdigest(),
        "command": command,
        "time_utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cpu": _cpu(),
        "cores": os.cpu_count(),
        "git": _git(study_file.resolve().parent),
        "precision": "float64",
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"


def _cpu() -> str:
    """The name of the processor, as far as the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor()


def _git(folder: Path) -> dict[str, Any] | None:
    """Commit of the repository that a folder is in, and whether files differ from it; None outside of one."""

    def ask(*arguments: str) -> str:
        command = ["git", "-C", str(folder), *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=True, timeout=10).stdout.strip()

    try:
        return {"commit": ask("rev-parse", "HEAD"), "is_dirty": bool(ask("status", "--porcelain"))}
    except (OSError, subprocess.SubprocessError):
        return None

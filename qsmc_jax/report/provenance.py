"""Where a result comes from: what is needed to get it again."""

import datetime
import hashlib
import importlib.metadata
import platform
from pathlib import Path
from typing import Any

_PACKAGES = ("qsmc_jax", "jax", "jaxlib", "diffrax", "equinox", "numpy", "scipy")


def provenance(study_file: Path, command: list[str]) -> dict[str, Any]:
    """Study file and its hash, command, time, versions and machine, as plain texts.

    Args:
        study_file: The study that was run.
        command: The command line.
    """
    return {
        "study": study_file.name,
        "study_sha256": hashlib.sha256(study_file.read_bytes()).hexdigest(),
        "command": command,
        "time_utc": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "precision": "float64",
        "versions": {name: _version(name) for name in _PACKAGES},
    }


def _version(package: str) -> str:
    try:
        return importlib.metadata.version(package)
    except importlib.metadata.PackageNotFoundError:
        return "not installed"

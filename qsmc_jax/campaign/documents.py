"""The JSON files of a folder, read with a check of what is in them."""

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from qsmc_jax.base.errors import InputError

Number = (int, float)
# What must be in each kind of file.
MANIFEST = {
    "schema": int,
    "fingerprint": str,
    "identity": dict,
    "study_file": str,
    "study_path": str,
    "machine": str,
    "files": dict,
    "file_runs": int,
    "provenance": dict,
}
IDENTITY = {"study_code": str, "contents": dict, "values": dict, "seed": int, "rtol": Number, "atol": Number}
REQUEST = {"runs": int, "is_anytime": bool}
SESSION = {"began": str, "updated": str, "state": str, "runs": int, "steps": int, "paid": int, "seconds": Number}
SUMMARY = {
    "verdict": str,
    "runs": int,
    "seed": int,
    "confidence": Number,
    "bandwidth": (*Number, list),
    "values": dict,
}
SUMMARY |= {"conclusion": str, "interval": str, "claims": list, "worst": list, "numerical_error": dict, "firmer": dict}
SUMMARY |= {"escalated": list, "defects": list, "steps": int, "occupancy": Number, "solve_seconds": Number}
SUMMARY |= {"provenance": dict}


def read_document(path: Path, keys: Mapping[str, Any]) -> dict[str, Any]:
    """A JSON file.

    Args:
        path: The file.
        keys: The type, or types, of what must be there, by name.

    Raises:
        InputError: It is missing, damaged, or something else; the key is named.
    """
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError, RecursionError) as error:
        raise InputError(f"File `{path}` can't be read: {error}.") from None
    if not isinstance(content, dict):
        raise InputError(f"File `{path}` must hold a JSON object, but holds a `{type(content).__name__}`.")
    require_keys(content, keys, f"File `{path}`")
    return content


def require_keys(content: Mapping[str, Any], keys: Mapping[str, Any], place: str) -> None:
    """Raises, with the key, unless what must be there is, and of its type.

    Args:
        content: What was read.
        keys: The type, or types, of what must be there, by name.
        place: Where it was read, as the subject of the message.
    """
    for key, kinds in keys.items():
        if key not in content:
            raise InputError(f"{place} must have the key `{key}`, but has not.")
        if not isinstance(content[key], kinds) or (isinstance(content[key], bool) and kinds is not bool):
            wanted = " or ".join(kind.__name__ for kind in (kinds if isinstance(kinds, tuple) else (kinds,)))
            raise InputError(f"{place} must have a `{key}` of type {wanted}, but has {content[key]!r:.80}.")

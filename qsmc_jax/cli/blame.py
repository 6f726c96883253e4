"""Whose mistake an error is: that of the user's study, or ours."""

import os
import sysconfig
import traceback
from collections.abc import Iterator
from pathlib import Path

from qsmc_jax.base.errors import InputError

# Of what other errors say, so much is shown.
_LONGEST = 400
_OURS = str(Path(__file__).resolve().parents[1]) + os.sep
_LIBRARIES = tuple({sysconfig.get_path(name) + os.sep for name in ("stdlib", "platstdlib", "purelib", "platlib")})


def users_line(error: BaseException) -> str | None:
    """Where the user's own code was when it came to an error, as "file.py, line 3"; None if it was not there last.

    Frames of libraries say nothing: they fail by what they are given. Of the others the innermost decides.

    Args:
        error: The error, with its traceback.
    """
    frames = [frame for frame in frames_of(error) if not is_library(frame.filename)]
    if not frames or frames[-1].filename.startswith(_OURS):
        return None
    return f"{frames[-1].filename}, line {frames[-1].lineno}"


def frames_of(error: BaseException | None) -> Iterator[traceback.FrameSummary]:
    """The calls that led to an error, then those that led to what it was raised from: the last is nearest the cause."""
    while error is not None:
        yield from traceback.extract_tb(error.__traceback__)
        error = error.__cause__


def told(error: BaseException) -> str:
    """The error in one line: whose name, unless it is one of ours, says what kind it is."""
    if isinstance(error, InputError):
        return str(error)
    if isinstance(error, SystemExit):
        return "a study must not end the program, but calls `sys.exit`."
    text = " ".join(str(error).split())
    return f"{type(error).__name__}: {text[:_LONGEST]}" if text else type(error).__name__


def is_library(file: str) -> bool:
    """Whether a file is that of a library, Python's own included; ours are none."""
    is_ours = file.startswith(_OURS)
    return not is_ours and (file.startswith(("<", *_LIBRARIES)) or "site-packages" in file)

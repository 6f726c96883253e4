"""The outermost layer of the program: whatever happens in a command ends in one exit code that means one thing."""

import contextlib
import os
import platform
import sys
import tempfile
import time
import traceback
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from typer.core import TyperGroup

from qsmc_jax.base.errors import InputError
from qsmc_jax.cli.blame import told, users_line
from qsmc_jax.cli.console import answers, say, say_json
from qsmc_jax.cli.exit_codes import BAD_INPUT, HELD, INTERNAL_ERROR, UNDECIDED
from qsmc_jax.cli.interrupts import Interruption
from qsmc_jax.cli.verbosity import LEVELS, telling

# What Python and the library that reads arguments make of Ctrl-C.
_INTERRUPTED = 130
# Options of the program that may also stand after a command.
_ANYWHERE = ("--debug", *LEVELS)


class Program(TyperGroup):
    """All commands of the program, and what becomes of their errors."""

    def main(  # pyright: ignore[reportIncompatibleMethodOverride]
        self, args: Sequence[str] | None = None, *others: Any, standalone_mode: bool = True, **options: Any
    ) -> Any:
        words = list(sys.argv[1:] if args is None else args)
        with answers() as has_answered, telling(_options(words)):
            try:
                code = super().main(_global_first(words), *others, standalone_mode=False, **options)
                if code == _INTERRUPTED:
                    raise KeyboardInterrupt
            except BaseException as error:  # noqa: BLE001  # there is nothing further out
                code = _end(error, words, has_answered())
        code = code if isinstance(code, int) else HELD
        if standalone_mode:
            sys.exit(code)
        return code


def _options(words: Sequence[str]) -> list[str]:
    """The words that may be options: those after `--` are not."""
    return list(words[: words.index("--")] if "--" in words else words)


def _global_first(words: Sequence[str]) -> list[str]:
    """The words with the program's own options before the command."""
    options = [word for word in _options(words) if word in _ANYWHERE]
    rest = [word for word in _options(words) if word not in _ANYWHERE]
    return [*dict.fromkeys(options), *rest, *words[len(_options(words)) :]]


def _end(error: BaseException, words: Sequence[str], has_answered: bool) -> int:
    """Says what went wrong in one line, and returns the exit code."""
    # What reads the arguments has something against them, and says so itself.
    show: Callable[[], None] | None = getattr(error, "show", None)
    if show is not None:
        kind, code, text = "bad input", BAD_INPUT, error.format_message()  # pyright: ignore
    elif isinstance(error, BrokenPipeError) or isinstance(error.__context__, BrokenPipeError):
        if "--help" in _options(words):  # whoever reads it in part has had what he wanted
            return HELD
        kind, code, text = "interrupted", UNDECIDED, "interrupted: whoever read what it prints has gone."
    elif isinstance(error, KeyboardInterrupt | Interruption) or type(error).__name__ == "Abort":
        kind, code, text = "interrupted", UNDECIDED, str(error) or "interrupted; nothing half-done was kept."
    elif isinstance(error, InputError | OSError):
        kind, code, text = "bad input", BAD_INPUT, str(error)
    elif where := users_line(error):
        kind, code, text = "bad input", BAD_INPUT, f"{where}: {told(error)}"
    else:
        kind, code, text = "internal error", INTERNAL_ERROR, _defect(error, words)
    if "--debug" in _options(words) and kind != "interrupted":
        traceback.print_exception(error, file=sys.stderr)
    show() if show is not None else say(f"qsmc: {text}", is_error=True)
    # One document: a verdict that is printed stands, whatever fails afterwards.
    if "--json" in _options(words) and not has_answered:
        say_json({"error": {"kind": kind, "message": text}, "exit_code": code})
    return code


def _defect(error: BaseException, words: Sequence[str]) -> str:
    """One sentence about a defect of ours, with the file that a report of it needs."""
    text = f"{told(error).rstrip('.')}. This is a defect of qsmc_jax, not of your study."
    log = None
    with contextlib.suppress(OSError, RuntimeError, ImportError):
        log = _write_log(error, words)
    return f"{text} " + (f"Please report it with the log: {log}" if log else "Please report it with what --debug says.")


def _write_log(error: BaseException, words: Sequence[str]) -> Path:
    """The traceback, with the command and the versions that it takes to see it again, in a file of its own."""
    import importlib.metadata as metadata

    names = ("qsmc_jax", "jax", "jaxlib", "diffrax", "equinox", "numpy")
    versions = []
    for name in names:
        with contextlib.suppress(metadata.PackageNotFoundError):
            versions.append(f"{name} {metadata.version(name)}")
    head = [f"qsmc {' '.join(map(repr, words))}", f"python {platform.python_version()}", ", ".join(versions)]
    text = "\n".join([*head, "", *traceback.format_exception(error)])
    number, path = tempfile.mkstemp(prefix=time.strftime("%Y%m%d-%H%M%S-"), suffix=".log", dir=_log_folder(), text=True)
    with os.fdopen(number, "w", encoding="utf-8") as file:
        file.write(text)
    return Path(path)


def _log_folder() -> Path:
    """The user's folder for logs; the one for temporary files where it can't be made."""
    import platformdirs

    try:
        folder = Path(platformdirs.user_log_dir("qsmc_jax"))
        folder.mkdir(parents=True, exist_ok=True)
    except (OSError, RuntimeError):
        return Path(tempfile.gettempdir())
    return folder

"""What the command line shows while it works, on standard error, and what it says in the end, on standard output."""

import contextlib
import os
import re
import sys
from collections.abc import Callable, Iterator, Mapping
from typing import Any

# Control characters, and marks that turn the direction of writing.
_COMMANDING = re.compile("[\x00-\x08\x0b-\x1f\x7f-\x9f\u202a-\u202e\u2066-\u2069]")
# Where results go; the last one counts.
_RESULTS: list[Any] = []
# How many were printed.
_COUNT = {"answers": 0}


@contextlib.contextmanager
def results_to(file: Any) -> Iterator[None]:
    """Has `say` print to a file, wherever standard output goes meanwhile."""
    _RESULTS.append(file)
    try:
        yield
    finally:
        _RESULTS.pop()


@contextlib.contextmanager
def answers() -> Iterator[Callable[[], bool]]:
    """Yields a function that says whether a result was printed inside."""
    before = _COUNT["answers"]
    yield lambda: _COUNT["answers"] > before


def say(text: str, *, is_error: bool = False) -> None:
    """Prints a text; signs that would command the terminal, from a file of somebody else's, as they are written.

    A reader who has gone, as in `qsmc ... | head`, changes nothing.
    """
    _COUNT["answers"] += not is_error
    text = _COMMANDING.sub(lambda sign: f"\\u{ord(sign[0]):04x}", text)
    file = sys.stderr if is_error else (_RESULTS or [sys.stdout])[-1]
    try:
        print(text, file=file, flush=True)
    except BrokenPipeError:
        # What is left in the buffer would fail once more when Python ends.
        os.dup2(os.open(os.devnull, os.O_WRONLY), file.fileno())


def say_json(content: Mapping[str, Any]) -> None:
    """Prints one JSON document."""
    from qsmc_jax.base.json_numbers import to_json

    say(to_json(content))

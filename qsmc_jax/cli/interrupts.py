"""Ctrl-C for work that is kept: the first finishes the block in hand, the second stops at once."""

import contextlib
import signal
import threading
from collections.abc import Callable, Iterator
from typing import Any

from qsmc_jax.cli.console import say


@contextlib.contextmanager
def finishing() -> Iterator[Callable[[], bool]]:
    """Yields a function that says whether to stop after the block in hand."""
    told = threading.Event()

    def tell(number: int, frame: Any) -> None:
        if told.is_set():
            raise KeyboardInterrupt
        told.set()
        say("qsmc: finishing the block in hand; once more to stop at once.", is_error=True)

    if threading.current_thread() is not threading.main_thread():
        yield told.is_set
        return
    before = {number: signal.signal(number, tell) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield told.is_set
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

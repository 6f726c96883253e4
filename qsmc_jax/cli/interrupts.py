"""Ctrl-C and its like: the first time work ends in order, the second time at once, whatever is under way.

`SIGTERM` and `SIGHUP` count as Ctrl-C. Python runs a handler between two of its own instructions only, and a long block
or a compilation is one; so a thread listens too, and ends the process where nothing else does.
"""

import contextlib
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from qsmc_jax.cli.console import say
from qsmc_jax.cli.exit_codes import UNDECIDED

_SIGNALS = [getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGHUP") if hasattr(signal, name)]
# Seconds that a second signal leaves for ending in order.
_PATIENCE = 1.0


@contextlib.contextmanager
def obeying() -> Iterator[None]:
    """The first signal is a `KeyboardInterrupt`; a second one ends the process within two seconds."""
    with _handled_by(_interrupt), _listening():
        yield


class Interruption(Exception):
    """Work that was told to stop and has ended in order; says what is kept."""


@contextlib.contextmanager
def finishing() -> Iterator[Callable[[], bool]]:
    """Yields a function that says whether to stop after the current block; for work that is kept."""
    told = threading.Event()

    def tell(number: int, frame: Any) -> None:
        if told.is_set():
            raise KeyboardInterrupt
        told.set()
        say("qsmc: finishing the current block; once more to stop at once.", is_error=True)

    with _handled_by(tell):
        yield told.is_set


def _interrupt(number: int, frame: Any) -> None:
    raise KeyboardInterrupt


@contextlib.contextmanager
def _handled_by(handler: Callable[[int, Any], None]) -> Iterator[None]:
    """Signals go to a function; but for those that whoever started the program wants ignored, as `nohup` does.

    Only the main thread hears of signals.
    """
    is_main = threading.current_thread() is threading.main_thread()
    wanted = [number for number in _SIGNALS if is_main and signal.getsignal(number) != signal.SIG_IGN]
    before = {number: signal.signal(number, handler) for number in wanted}
    try:
        yield
    finally:
        for number, previous in before.items():
            signal.signal(number, previous)


@contextlib.contextmanager
def _listening() -> Iterator[None]:
    """A thread hears of every signal as it comes, while the main thread may be out of Python's reach."""
    heard, told = os.pipe()
    os.set_blocking(told, False)
    before = signal.set_wakeup_fd(told, warn_on_full_buffer=False)
    threading.Thread(target=_listen, args=(heard,), daemon=True).start()
    try:
        yield
    finally:
        signal.set_wakeup_fd(before)
        os.close(told)


def _listen(heard: int) -> None:
    count = 0
    with contextlib.suppress(OSError):
        while byte := os.read(heard, 1):
            count += byte[0] in _SIGNALS
            if count == 2:
                time.sleep(_PATIENCE)
                os.write(2, b"qsmc: stopped at once; what was written before is whole.\n")
                os._exit(UNDECIDED)
    os.close(heard)

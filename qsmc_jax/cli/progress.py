"""What is shown of long work, on standard error: a line that moves on a terminal, elsewhere one now and then."""

import contextlib
import sys
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

from qsmc_jax.cli.console import say
from qsmc_jax.cli.verbosity import is_quiet

# Seconds from one line to the next where there is no terminal.
HEARTBEAT = 30.0


@contextlib.contextmanager
def progress_bar(task: str) -> Iterator[Callable[[int, int], None]]:
    """A bar with rate and time left, to be called as `progress(done, total)`; "compiling, 3 s" until the first call."""
    with _shown("compiling", has_bar=True) as show:
        yield lambda done, total: show(task, done, total)


@contextlib.contextmanager
def waiting(task: str) -> Iterator[None]:
    """A line with the seconds so far."""
    with _shown(task):
        yield


@contextlib.contextmanager
def live_line(task: str) -> Iterator[Callable[[str], None]]:
    """The same, with a text that can be replaced while work goes on."""
    with _shown(task) as show:
        yield lambda text: show(f"{task}: {text}")


@contextlib.contextmanager
def _shown(first: str, *, has_bar: bool = False) -> Iterator[Callable[..., None]]:
    if is_quiet():
        yield lambda *_: None
        return
    with _moving(first, has_bar) if sys.stderr.isatty() else _beating(first) as show:
        yield show


@contextlib.contextmanager
def _beating(first: str) -> Iterator[Callable[..., None]]:
    """For a log: a line of its own every half minute."""
    begin, now, ended = time.monotonic(), [first], threading.Event()

    def show(text: str, done: int = 0, total: int = 0) -> None:
        now[0] = f"{text}, {done} of {total} runs" if total else text

    def beat() -> None:
        while not ended.wait(HEARTBEAT):
            say(f"qsmc: {now[0]}, {time.monotonic() - begin:.0f} s", is_error=True)

    threading.Thread(target=beat, daemon=True).start()
    try:
        yield show
    finally:
        ended.set()


@contextlib.contextmanager
def _moving(first: str, has_bar: bool) -> Iterator[Callable[..., None]]:
    """For a terminal: one line, gone at the end."""
    from rich.console import Console
    from rich.progress import (
        BarColumn,
        MofNCompleteColumn,
        Progress,
        ProgressColumn,
        SpinnerColumn,
        TimeRemainingColumn,
    )
    from rich.text import Text

    class Told(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(task.description if task.total else f"{task.description}, {task.elapsed or 0.0:.0f} s")

    class Rate(ProgressColumn):
        def render(self, task: Any) -> Text:
            return Text(f"{task.speed:.0f} runs/s" if task.speed else "")

    columns = (SpinnerColumn(), Told())
    columns += (BarColumn(), MofNCompleteColumn(), Rate(), TimeRemainingColumn()) if has_bar else ()
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        shown = bar.add_task(first, total=None)

        def show(text: str, done: int = 0, total: int = 0) -> None:
            bar.update(shown, description=text, completed=done, total=total or None)

        yield show

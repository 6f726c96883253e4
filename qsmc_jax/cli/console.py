"""What the command line shows while it works, on standard error, and what it says in the end, on standard output."""

import contextlib
from collections.abc import Callable, Iterator


def say(text: str, *, is_error: bool = False) -> None:
    """Prints a text as it is."""
    import typer

    typer.echo(text, err=is_error)


@contextlib.contextmanager
def progress_bar(task: str, *, quiet: bool) -> Iterator[Callable[[int, int], None] | None]:
    """A bar with rate and time left, to be called as `progress(done, total)`; "compiling" until the first call."""
    if quiet:
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, MofNCompleteColumn, Progress, SpinnerColumn, TextColumn, TimeRemainingColumn

    columns = (
        SpinnerColumn(),
        TextColumn("{task.description}"),
        BarColumn(),
        MofNCompleteColumn(),
        TextColumn("{task.fields[rate]}"),
        TimeRemainingColumn(),
    )
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        shown = bar.add_task("compiling", total=None, rate="")

        def update(done: int, total: int) -> None:
            speed = bar.tasks[0].speed
            rate = f"{speed:.0f} runs/s" if speed else ""
            bar.update(shown, description=task, completed=done, total=total, rate=rate)

        yield update


@contextlib.contextmanager
def waiting(task: str, *, quiet: bool) -> Iterator[None]:
    """A spinner for work of a few seconds."""
    if quiet:
        yield
        return
    from rich.console import Console

    with Console(stderr=True).status(task):
        yield


@contextlib.contextmanager
def live_line(task: str, *, quiet: bool) -> Iterator[Callable[[str], None] | None]:
    """A spinner with a text that can be replaced while work goes on."""
    if quiet:
        yield None
        return
    from rich.console import Console

    with Console(stderr=True).status(task) as status:
        yield lambda text: status.update(f"{task}: {text}")

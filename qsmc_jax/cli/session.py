"""What every command runs in: bad input and interruptions end in one sentence and an exit code."""

import contextlib
import warnings
from collections.abc import Iterator

import typer

from qsmc_jax.cli.cache import keep_compiled_programs
from qsmc_jax.cli.console import say

BAD_INPUT, UNDECIDED = 2, 3


@contextlib.contextmanager
def session(cache: bool) -> Iterator[None]:
    """Bad input ends in one sentence and exit code 2, an interruption in 3; never in a traceback."""
    if cache:
        keep_compiled_programs()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("always", UserWarning)
            warnings.showwarning = lambda message, *_: say(f"qsmc: {message}", is_error=True)
            yield
    except ValueError as error:
        say(f"qsmc: {error}", is_error=True)
        raise typer.Exit(BAD_INPUT) from None
    except KeyboardInterrupt:
        say("qsmc: interrupted; nothing half-done was kept.", is_error=True)
        raise typer.Exit(UNDECIDED) from None

"""What every command runs in: bad input and interruptions end in one sentence and an exit code."""

import contextlib
import sys
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
    finally:
        _say_if_slow()


def _say_if_slow() -> None:
    """Says once, after a command that solved something, that solves are slow with this version of JAX, if they are."""
    solver = sys.modules.get("qsmc_jax.base.vectorise")
    if solver is not None and solver.why_not_vectorised():
        say(f"qsmc: {solver.why_not_vectorised()}", is_error=True)

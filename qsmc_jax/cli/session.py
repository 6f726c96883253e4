"""What every command runs in: compiled programs kept, warnings in one line, a study's own output out of the way."""

import contextlib
import sys
import warnings
from collections.abc import Iterator

from qsmc_jax.cli.cache import keep_compiled_programs
from qsmc_jax.cli.console import results_to
from qsmc_jax.cli.verbosity import warn


@contextlib.contextmanager
def session(cache: bool) -> Iterator[None]:
    """Standard output is for what the command says in the end: all that a study prints goes to standard error.

    Args:
        cache: Whether compiled programs are kept in the user's cache folder.
    """
    if cache:
        keep_compiled_programs()
    with warnings.catch_warnings(), results_to(sys.stdout), contextlib.redirect_stdout(sys.stderr):
        warnings.simplefilter("always", UserWarning)
        warnings.showwarning = lambda message, *_: warn(str(message))
        try:
            yield
        finally:
            _say_if_slow()


def _say_if_slow() -> None:
    """Says once, after a command that solved something, that solves are slow with this version of JAX, if they are."""
    solver = sys.modules.get("qsmc_jax.tracing.vectorise")
    if solver is not None and solver.why_not_vectorised():
        warn(solver.why_not_vectorised())

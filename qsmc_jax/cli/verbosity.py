"""How much the program prints apart from results: `--quiet` errors only, `--verbose` all that the package logs."""

import contextlib
import logging
from collections.abc import Iterator, Sequence

from qsmc_jax.cli.console import say

LEVELS = {"--quiet": logging.ERROR, "--verbose": logging.INFO}
_LOGGER = logging.getLogger("qsmc_jax")


class _OnTerminal(logging.Handler):
    """Prints on standard error, as all that is no result."""

    def emit(self, record: logging.LogRecord) -> None:
        say(f"qsmc: {record.getMessage()}", is_error=True)


@contextlib.contextmanager
def telling(words: Sequence[str]) -> Iterator[None]:
    """Inside, the package's logger tells what the options among the words ask for; the last one counts."""
    before, handler = (_LOGGER.level, _LOGGER.propagate), _OnTerminal()
    _LOGGER.setLevel(next((LEVELS[word] for word in reversed(words) if word in LEVELS), logging.WARNING))
    _LOGGER.propagate = False
    _LOGGER.addHandler(handler)
    try:
        yield
    finally:
        _LOGGER.removeHandler(handler)
        _LOGGER.level, _LOGGER.propagate = before


def is_quiet() -> bool:
    """Whether nothing but results and errors is wanted."""
    return not _LOGGER.isEnabledFor(logging.WARNING)


def warn(text: str) -> None:
    """Says what the user should know, unless he wants errors only."""
    _LOGGER.warning("%s", text)

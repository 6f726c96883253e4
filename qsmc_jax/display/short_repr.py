"""What results show of themselves in a console: their verdict, not their arrays."""

from typing import Any


def short_repr(self: Any) -> str:
    """The class and the first line of the text of what it belongs to; to be a class's `__repr__`."""
    return f"<{type(self).__name__}: {str(self).partition(chr(10))[0]}>"

"""Room on Python's stack for deep calls, which tracing makes by the thousand."""

from collections.abc import Callable
from typing import Any, TypeVar

_T = TypeVar("_T")

# CPython keeps the frames of calls in pieces of 16 KiB and gives one back to the system as soon as the first call in it
# returns: a call that is made again and again just where a piece ends maps memory each time, which was a third of the
# time of tracing. A frame that is larger than a piece gets one of its own, twice as large at most, the rest of which is
# for the calls in it: here some 500 KiB, more than Python's limit of recursion lets anybody use.
_SLOTS = 65_000

_call: Any = lambda fn, args, kwargs: fn(*args, **kwargs)  # noqa: E731  # a function would be checked at every call
_call.__code__ = _call.__code__.replace(co_stacksize=_SLOTS)


def with_room(fn: Callable[..., _T], *args: Any, **kwargs: Any) -> _T:
    """What a function returns that calls deeply; the same as calling it, faster.

    Args:
        fn: The function.
        *args: Its arguments.
        **kwargs: Its arguments by name.
    """
    return _call(fn, args, kwargs)

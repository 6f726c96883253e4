"""What is worked out once and kept, also if several threads ask for it at the same time."""

import functools as ft
import threading
import weakref
from collections.abc import Callable
from typing import Any


def kept(maxsize: int) -> Callable[[Callable[..., Any]], Any]:
    """A decorator like `functools.lru_cache`: of equal calls at the same time, one works and the others wait.

    Args:
        maxsize: How many results are kept.
    """

    def decorate(fn: Callable[..., Any]) -> Any:
        working, locks = threading.Lock(), weakref.WeakValueDictionary[Any, threading.Lock]()
        results = ft.lru_cache(maxsize)(fn)

        @ft.wraps(fn)
        def wrapped(*key: Any) -> Any:
            with working:
                lock = locks.setdefault(key, threading.Lock())
            with lock:
                return results(*key)

        wrapped.cache_clear = results.cache_clear  # pyright: ignore[reportAttributeAccessIssue]
        return wrapped

    return decorate

"""Results that are kept, with threads that ask at the same time."""

import threading
from concurrent.futures import ThreadPoolExecutor

import pytest

from qsmc_jax.base.kept import kept


def test_of_equal_calls_at_once_one_works():
    begun, calls = threading.Barrier(4), []

    @kept(maxsize=2)
    def square(number):
        calls.append(number)
        threading.Event().wait(0.05)
        return number**2

    def ask(number):
        begun.wait()
        return square(number)

    with ThreadPoolExecutor(4) as pool:
        assert list(pool.map(ask, (3, 3, 3, 4))) == [9, 9, 9, 16]
    assert sorted(calls) == [3, 4]
    square.cache_clear()
    assert square(3) == 9
    assert sorted(calls) == [3, 3, 4]


def test_different_calls_do_not_wait_for_each_other_and_a_failed_one_is_made_again():
    other_is_done, failures = threading.Event(), iter((True, False))

    @kept(maxsize=2)
    def waits(name):
        if name == "second":
            other_is_done.set()
            return name
        assert other_is_done.wait(10.0)
        if next(failures):
            raise ZeroDivisionError
        return name

    with ThreadPoolExecutor(2) as pool:
        first, second = pool.submit(waits, "first"), pool.submit(waits, "second")
        assert second.result() == "second"
        with pytest.raises(ZeroDivisionError):
            first.result()
    assert waits("first") == "first"

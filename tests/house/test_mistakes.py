"""Likely mistakes get an `InputError` that names the argument, what it is, and what to do."""

import json
import re
import subprocess
import sys

import pytest

import places
from mistakes import MISTAKES

ROOT = places.ROOT


@pytest.fixture(scope="module")
def said():
    done = subprocess.run(
        [sys.executable, "-m", "tests.mistakes"], cwd=ROOT, capture_output=True, text=True, check=True
    )
    return json.loads(done.stdout)


@pytest.mark.parametrize("name", MISTAKES)
def test_a_mistake_is_told_what_to_do(said, name):
    kind, message = said[name]
    assert kind in ("InputError", "MissingColumnError"), message
    assert re.search(MISTAKES[name][1], message), message

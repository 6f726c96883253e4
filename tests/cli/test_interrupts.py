"""Signals end any command: the first in order, the second at once, whatever the process is doing."""

import signal
import subprocess
import sys
import time

import pytest

import places

STUDY = places.STUDY

pytestmark = pytest.mark.stress

# Out of Python's reach for half a minute, as a compilation is.
LONG = """
import jax, jax.numpy as jnp
import qsmc_jax as qj

def wait(x):
    return jax.lax.fori_loop(0, 2 * 10**9, lambda i, y: jnp.sin(y) + x, x)

print("out of reach", flush=True)
jax.jit(wait)(1.0).block_until_ready()
"""


def started(tmp_path, text, *arguments):
    path = tmp_path / "study.py"
    path.write_text(text)
    command = [sys.executable, "-u", "-m", "qsmc_jax", "verify", str(path), *arguments]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    for line in process.stderr:
        if "out of reach" in line:
            break
    time.sleep(1.0)
    return process


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_second_signal_ends_the_program_within_two_seconds(tmp_path, sent):
    process = started(tmp_path, LONG)
    process.send_signal(sent)
    time.sleep(0.5)
    begin = time.monotonic()
    process.send_signal(sent)
    process.communicate(timeout=10)
    assert process.returncode == 3
    assert time.monotonic() - begin < 2.0


@pytest.mark.parametrize("sent", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_a_first_signal_ends_it_in_order(tmp_path, sent):
    waiting = "import sys, time\nprint('out of reach', flush=True)\ntime.sleep(30)\n"
    process = started(tmp_path, waiting, "--json")
    process.send_signal(sent)
    out, err = process.communicate(timeout=10)
    assert process.returncode == 3
    assert '"kind": "interrupted"' in out
    assert "Traceback" not in err


def test_what_nohup_ignores_stays_ignored(tmp_path):
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        process = started(tmp_path, "import time\nprint('out of reach', flush=True)\ntime.sleep(3)\n")
    finally:
        signal.signal(signal.SIGHUP, before)
    process.send_signal(signal.SIGHUP)
    process.communicate(timeout=20)
    assert process.returncode == 2  # the study ends, and has none

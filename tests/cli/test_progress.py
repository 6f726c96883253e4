"""What is said besides results: progress on a terminal, a line now and then in a log, nothing with `--quiet`."""

import logging
import os
import subprocess
import sys
import time
from pathlib import Path

import pytest
from typer.testing import CliRunner

import places
from qsmc_jax.cli import progress
from qsmc_jax.cli.main import app
from qsmc_jax.cli.progress import live_line, progress_bar, waiting
from qsmc_jax.cli.verbosity import telling

STUDY = str(places.STUDY)
SMALL = ["--runs", "64", "--block", "64", "--no-cache"]


def qsmc(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


@pytest.fixture
def quick(monkeypatch):
    """Heartbeats every 20 ms."""
    monkeypatch.setattr(progress, "HEARTBEAT", 0.02)


def said_within(capsys, text, seconds=5.0):
    """Waits until a text was said on standard error."""
    said, begin = "", time.monotonic()
    while text not in said and time.monotonic() - begin < seconds:
        time.sleep(0.01)
        said += capsys.readouterr().err
    return text in said


def test_without_a_terminal_a_line_now_and_then_says_where_work_stands(quick, capsys):
    with progress_bar("solving") as told:
        assert said_within(capsys, "qsmc: compiling, 0 s")
        told(512, 10_000)
        assert said_within(capsys, "qsmc: solving, 512 of 10000 runs, 0 s")
    with waiting("drawing"):
        assert said_within(capsys, "qsmc: drawing, 0 s")
    with live_line("tuning") as tell:
        tell("evaluation 3")
        assert said_within(capsys, "qsmc: tuning: evaluation 3, 0 s")
    capsys.readouterr()
    time.sleep(0.1)
    assert capsys.readouterr().err == ""


def test_a_beat_ends_with_work_that_fails(quick, capsys):
    with pytest.raises(KeyError), waiting("drawing"):
        raise KeyError
    time.sleep(0.05)
    capsys.readouterr()
    time.sleep(0.1)
    assert capsys.readouterr().err == ""


@pytest.mark.slow
def test_quiet_is_quiet_wherever_the_option_stands(quick, tmp_path):
    warns = tmp_path / "study.py"
    warns.write_text("import warnings\nwarnings.warn('careful')\n" + Path(STUDY).read_text())
    loud = qsmc("verify", warns, *SMALL)
    assert "qsmc: careful" in loud.stderr
    for arguments in (["--quiet", "verify", warns, *SMALL], ["verify", warns, *SMALL, "--quiet"]):
        done = qsmc(*arguments)
        assert done.stderr == ""
        assert done.stdout.splitlines()[:5] == loud.stdout.splitlines()[:5]
        assert done.exit_code == loud.exit_code
    assert "must be a multiple" in qsmc("verify", STUDY, "--block", "3", "--quiet").stderr.replace("positive ", "")


@pytest.mark.slow
def test_verbose_tells_what_is_compiled_checked_and_written(tmp_path):
    done = qsmc("verify", STUDY, *SMALL, "--out", tmp_path / "run", "--verbose")
    for part in (
        "qsmc: compiled Block in",
        "qsmc: solving",
        "another way, as a check",
        "qsmc: wrote 64 rows from run 0",
    ):
        assert part in done.stderr, done.stderr
    assert "qsmc: compiled" not in qsmc("verify", STUDY, *SMALL).stderr


def test_the_logger_is_left_as_it_was():
    logger = logging.getLogger("qsmc_jax")
    before = logger.level, logger.propagate, list(logger.handlers)
    with telling(["--quiet", "--verbose"]):
        assert logger.level == logging.INFO
    assert (logger.level, logger.propagate, list(logger.handlers)) == before


@pytest.mark.skipif(not hasattr(os, "openpty"), reason="needs a pseudo-terminal")
def test_a_terminal_sees_how_long_it_compiles():
    """`compiling, 0 s` on a terminal, and nothing of it on standard output."""
    ours, theirs = os.openpty()
    program = (
        "import time\nfrom qsmc_jax.cli.progress import progress_bar\n"
        "with progress_bar('solving') as told:\n    time.sleep(0.5)\n    told(3, 9)\n    time.sleep(0.5)\nprint('done')"
    )
    command = [sys.executable, "-c", program]
    environment = {**os.environ, "TERM": "xterm", "COLUMNS": "100"}
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=theirs, env=environment, text=True) as process:
        os.close(theirs)
        shown = b""
        try:
            while part := os.read(ours, 4096):
                shown += part
        except OSError:  # the other end is closed
            pass
        assert process.stdout is not None
        assert process.stdout.read() == "done\n"
    os.close(ours)
    assert b"compiling, 0 s" in shown
    assert b"3/9" in shown

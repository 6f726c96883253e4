"""Each exit code means one thing, and with `--json` each outcome is one JSON document."""

import json
import math
import os
import subprocess
import sys
from pathlib import Path

import pytest
from typer.testing import CliRunner

import places
import qsmc_jax as qj
from qsmc_jax.base.json_numbers import to_json
from qsmc_jax.cli.blame import told, users_line
from qsmc_jax.cli.main import app

STUDY = str(places.STUDY)
SMALL = ["--runs", "64", "--block", "64", "--no-cache"]
HEAD = """
import sys
import jax.numpy as jnp
import qsmc_jax as qj

def scenario(draw):
    {}
    return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=3.0)

study = qj.Study(scenario, bandwidth=0.5)
"""


@pytest.fixture(autouse=True)
def logs(tmp_path, monkeypatch):
    """Logs of defects go where the test can look."""
    folder = tmp_path / "logs"
    monkeypatch.setattr("platformdirs.user_log_dir", lambda *_, **__: str(folder))
    return folder


def qsmc(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments)])


def written(tmp_path, text):
    path = tmp_path / "study.py"
    path.write_text(text)
    return path


def only_json(text):
    """The document, in which no number is a text or one that JSON does not know."""

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(text, parse_constant=refuse)


THE_USERS = {
    "sys.exit when loaded": "import sys\nsys.exit()",
    "sys.exit(0) when loaded": "import sys\nsys.exit(0)",
    "sys.exit(1) in the scenario": HEAD.format("sys.exit(1)"),
    "an error of another library": HEAD.format("jnp.zeros(2) @ jnp.zeros(3)"),
    "an error of Python": HEAD.format("{}['nothing']"),
    "a recursion": "def f(x):\n    return f(x)\nf(1)",
    "an abort": "raise KeyError('x')",
    "a byte that is no text": "x = '\0'",
    "an exit by name": "raise SystemExit(0)",
}


@pytest.mark.parametrize("command", ["verify", "simulate", "map", "tune"])
@pytest.mark.parametrize("text", THE_USERS.values(), ids=THE_USERS)
def test_what_a_study_does_wrong_is_bad_input(tmp_path, logs, command, text):
    more = {"map": ["--over", "mu=1:2:2"], "tune": ["mu"]}.get(command, [])
    done = qsmc(command, written(tmp_path, text), *more, "--json")
    assert done.exit_code == 2, done.output
    assert only_json(done.stdout)["error"]["kind"] == "bad input"
    assert only_json(done.stdout)["exit_code"] == 2
    assert "Traceback" not in done.stderr
    assert not logs.exists()


@pytest.mark.parametrize("broken", [None, {}.__getitem__, json.loads], ids=["ours", "Python's", "a library's"])
def test_a_defect_of_ours_is_neither_a_verdict_nor_bad_input(logs, monkeypatch, broken):
    monkeypatch.setattr("qsmc_jax.verification.verify.BatchSolver", broken)
    done = qsmc("verify", STUDY, *SMALL, "--json")
    assert done.exit_code == 70, done.output
    said = only_json(done.stdout)
    assert said["error"]["kind"] == "internal error"
    assert "This is a defect of qsmc_jax" in said["error"]["message"]
    assert "Traceback" not in done.stderr
    (log,) = logs.iterdir()
    assert str(log) in done.stderr
    assert "Traceback" in log.read_text()
    assert "'verify'" in log.read_text()
    debug = qsmc("verify", STUDY, *SMALL, "--debug")
    assert debug.exit_code == 70
    assert "Traceback" in debug.stderr


@pytest.mark.parametrize("place", ["qsmc_jax_mine", "mine"])
def test_a_folder_named_like_ours_is_the_users(tmp_path, place):
    file = Path(qj.__file__).parents[1] / place / "study.py"
    with pytest.raises(ZeroDivisionError) as raised:
        exec(compile("1 / 0", str(file), "exec"))
    assert users_line(raised.value) == f"{file}, line 1"
    assert told(raised.value) == "ZeroDivisionError: division by zero"


FUTURE = """
from __future__ import annotations
import dataclasses
from typing import ClassVar
import qsmc_jax as qj

@dataclasses.dataclass
class Numbers:
    gain: ClassVar[float] = 1.0

class Mine(qj.AbstractPlant):
    order: ClassVar[int] = 1

    def drift(self, t, x):
        return -x[0]

    def gain(self, t, x):
        return Numbers.gain

def scenario(draw):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.1))
    loop = qj.ClosedLoop(Mine(), qj.references.Constant(0.0), qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.2, shape=(1,)), t1=4.0)

study = qj.Study(scenario, bandwidth=0.5)
"""


def test_annotations_may_be_texts(tmp_path):
    """Python looks for what they name in the module of the class."""
    done = qsmc("simulate", written(tmp_path, FUTURE), "--json", "--no-cache")
    assert done.exit_code == 0, done.output


def test_what_fails_after_the_verdict_is_no_second_document(tmp_path, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("qsmc_jax.report.folder.ResultFolder.add_table", full)
    done = qsmc("simulate", STUDY, "--json", "--no-cache", "--out", tmp_path / "run")
    assert done.exit_code == 2
    assert only_json(done.stdout)["verdict"] == "HELD"
    assert "No space left on device" in done.stderr


def test_a_campaign_that_is_interrupted_or_prepared_is_json_too(tmp_path, monkeypatch):
    command = ["verify", STUDY, "--out", tmp_path / "run", "--json", *SMALL]
    prepared = qsmc(*command, "--prepare")
    assert prepared.exit_code == 0, prepared.output
    assert only_json(prepared.stdout) == {"prepared": str(tmp_path / "run"), "runs": 64}
    monkeypatch.setattr("qsmc_jax.campaign.campaign.run_campaign", lambda *_, **__: None)
    stopped = qsmc(*command)
    assert stopped.exit_code == 3
    assert only_json(stopped.stdout)["error"]["kind"] == "interrupted"
    assert "The same command goes on" in only_json(stopped.stdout)["error"]["message"]


def test_an_interruption_is_not_an_answer(monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("qsmc_jax.verification.verify.BatchSolver", interrupt)
    done = qsmc("verify", STUDY, *SMALL, "--json")
    assert done.exit_code == 3
    assert only_json(done.stdout)["error"]["kind"] == "interrupted"
    assert only_json(done.stdout)["exit_code"] == 3


@pytest.mark.parametrize("arguments", [["--nothing"], [], ["--runs", "many"], ["--runs", "0"], ["--rtol", "-1"]])
def test_bad_arguments_are_json_too(arguments):
    study = [STUDY] if arguments else []
    done = qsmc("verify", *study, *arguments, "--json")
    assert done.exit_code == 2
    assert only_json(done.stdout)["error"]["kind"] == "bad input"


def test_what_a_study_prints_is_not_in_the_way(tmp_path):
    text = HEAD.format("print('traced')") + "print('loaded')\n"
    done = qsmc("simulate", written(tmp_path, text), "--json", "--no-cache")
    assert done.exit_code == 0, done.output
    assert only_json(done.stdout)["verdict"] == "HELD"
    assert "loaded" in done.stderr
    assert "traced" in done.stderr


def test_a_byte_order_mark_is_read(tmp_path):
    path = tmp_path / "study.py"
    path.write_bytes(b"\xef\xbb\xbf" + HEAD.format("pass").encode())
    assert qsmc("simulate", path, "--json", "--no-cache").exit_code == 0


def test_numbers_that_json_does_not_know_are_stated():
    text = to_json({"a": math.inf, "b": math.nan, "c": [1.0, -math.inf], "d": {"e": 2}, "f": True})
    expected = {"a": None, "b": None, "c": [1.0, None], "d": {"e": 2}, "f": True, "infinite": {"a": 1, "c": -1}}
    assert only_json(text) == expected


@pytest.mark.slow
def test_a_reader_who_has_gone_changes_nothing(tmp_path):
    """As in `qsmc ... | head`: the exit code is still that of the verdict."""
    command = f"{sys.executable} -m qsmc_jax simulate {STUDY} -S gain_sign=-1 --no-cache"
    done = subprocess.run(["bash", "-c", f"{command} | true; exit ${{PIPESTATUS[0]}}"], capture_output=True, text=True)
    assert done.returncode == 1, done.stderr
    assert "Traceback" not in done.stderr


def test_version_and_module():
    done = subprocess.run([sys.executable, "-m", "qsmc_jax", "--version"], capture_output=True, text=True, check=True)
    assert done.stdout.startswith("qsmc_jax ")


@pytest.mark.parametrize(
    ("options", "argument"),
    [(["--runs", "0"], "runs"), (["--block", "63"], "block"), (["--confidence", "nan"], "confidence")],
)
def test_a_folder_is_not_prepared_for_what_cannot_be_done(tmp_path, options, argument):
    done = qsmc("verify", STUDY, "--out", tmp_path / "run", "--prepare", "--no-cache", *options)
    assert done.exit_code == 2, done.output
    assert f"`{argument}`" in done.output
    assert not (tmp_path / "run").exists()


@pytest.mark.slow
def test_without_docstrings_and_without_a_home(tmp_path):
    """`python -OO`, as a user whom no password file knows and who has no home."""
    environment = {"PATH": "", "XDG_CACHE_HOME": "", "HOME": "", "PYTHONPATH": str(places.ROOT)}
    command = [sys.executable, "-OO", "-m", "qsmc_jax", "verify", STUDY, *SMALL, "--out", str(tmp_path / "run")]
    done = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def read_by_nobody(*arguments):
    """The program with standard output that nobody reads any more, as after `qsmc ... | head`."""
    reader, writer = os.pipe()
    os.close(reader)
    try:
        return subprocess.run([sys.executable, "-m", "qsmc_jax", *arguments], stdout=writer, stderr=subprocess.PIPE)
    finally:
        os.close(writer)


@pytest.mark.parametrize("arguments", [["--help"], ["verify", "--help"], ["init", "--help"], ["--version"]])
def test_help_that_nobody_reads_to_the_end_is_no_error(arguments):
    ended = read_by_nobody(*arguments)
    assert (ended.returncode, ended.stderr) == (0, b"")


def test_a_reader_who_goes_interrupts(monkeypatch):
    def gone(*_, **__):
        try:
            raise BrokenPipeError
        except BrokenPipeError:
            raise SystemExit(1)  # noqa: B904  # so does the library that draws tables

    monkeypatch.setattr("qsmc_jax.verify", gone)
    result = qsmc("verify", STUDY, *SMALL, "--json")
    assert result.exit_code == 3
    assert only_json(result.stdout)["error"]["kind"] == "interrupted"

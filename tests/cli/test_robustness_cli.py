"""The commands `map`, `critical` and `compare`: exit codes, files, and errors in one sentence."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import places
from qsmc_jax.cli.grids import parse_grids
from qsmc_jax.cli.main import app
from tests import coin_study

STUDY = str(places.COIN_STUDY)
SMALL = ["--block", "64"]


def qsmc(*arguments):
    """Runs the command in this process, without touching the user's cache folder."""
    return CliRunner().invoke(app, [*map(str, arguments), "--no-cache"])


@pytest.fixture(autouse=True)
def compiled_once(monkeypatch):
    """A study file that was run before is not run again, so that its program is compiled once for all tests."""
    from qsmc_jax.cli import study_file

    run = study_file.Source.run
    is_coin = lambda source: str(source.path) == STUDY  # noqa: E731
    monkeypatch.setattr(study_file.Source, "run", lambda source: vars(coin_study) if is_coin(source) else run(source))


def files(folder):
    return sorted(path.name for path in folder.iterdir())


@pytest.mark.slow
def test_map_writes_numbers_table_and_picture(tmp_path):
    out = tmp_path / "result"
    grid = ["--over", "p=0.01:0.64:log:3", "--over", "flip=0,1"]
    done = qsmc("map", STUDY, *grid, "--runs", 64, *SMALL, "--out", out)
    assert done.exit_code == 0, done.output
    assert "All 6 intervals hold together with 95 % confidence" in done.output
    assert files(tmp_path) == ["result"]
    assert files(out) == ["map.json", "map.parquet", "map.png", "result.npz"]
    content, table = json.loads((out / "map.json").read_text()), pq.read_table(out / "map.parquet").to_pydict()
    assert table["p"] == pytest.approx([0.01, 0.01, 0.08, 0.08, 0.64, 0.64])
    assert table["funnel.violated"] == np.ravel(content["claims"]["funnel"]["violated"]).tolist()
    assert content["provenance"]["study_sha256"]


def test_critical_writes_numbers_table_and_picture(tmp_path):
    out = tmp_path / "result"
    done = qsmc("critical", STUDY, "--name", "p", "--below", 0.3, "--steps", 2, *SMALL, "--out", out)
    assert done.exit_code == 0, done.output
    assert "FOUND: at p = " in done.output
    assert files(out) == ["critical.json", "critical.parquet", "critical.png", "result.npz"]
    content, table = (
        json.loads((out / "critical.json").read_text()),
        pq.read_table(out / "critical.parquet").to_pydict(),
    )
    assert table["value"][:3] == [0.0, 1.0, 0.5]
    assert table["finding"][:2] == ["below", "above"]
    assert content["shown"] < 0.3


def test_compare_writes_numbers_table_and_picture(tmp_path):
    out = tmp_path / "result"
    done = qsmc("compare", STUDY, "--runs", 64, *SMALL, "--out", out)
    assert done.exit_code == 0, done.output
    assert "ratio to `slow`, run by run" in done.output
    assert files(out) == ["comparison.json", "comparison.parquet", "comparison.png", "result.npz"]
    table = pq.read_table(out / "comparison.parquet").to_pydict()
    assert set(table["study"]) == {"slow", "fast", "bad"}
    assert set(table["kind"]) == {"probability", "median", "ratio"}


COMMANDS = {
    "map": ["map", STUDY, "--over", "p=0.1,0.5", "--runs", "64", *SMALL],
    "critical": ["critical", STUDY, "--name", "p", "--below", "0.3", "--steps", "0", *SMALL],
    "compare": ["compare", STUDY, "--runs", "64", *SMALL],
}


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_json_is_the_only_thing_on_standard_output(command):
    assert json.loads(qsmc(*command, "--json").stdout)["seed"] == 0


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_an_interruption_exits_3_and_writes_nothing(command, tmp_path, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("qsmc_jax.report.folder.ResultFolder.add_table", interrupt)
    done = qsmc(*command, "--out", tmp_path / "result")
    assert done.exit_code == 3
    assert files(tmp_path) == []


def test_critical_exits_3_when_nothing_could_be_shown():
    done = qsmc("critical", STUDY, "--name", "p", "--below", 0.3, "--between", "0.8:0.9", *SMALL)
    assert done.exit_code == 3
    assert "NOT FOUND" in done.output


def test_overrides_reach_every_study():
    """The side that is violated is exchanged in all three."""
    done = qsmc(*COMMANDS["compare"], "-S", "p=1", "--json")
    assert [study["violated"] for study in json.loads(done.stdout)["studies"]] == [64] * 3


def test_grids_are_read_as_they_are_written():
    grids = parse_grids(["a=1e-4:1e-1:log:4", "b = 1:10:lin:4", "c=1,2.5,7", "d=3"])
    assert grids["a"] == pytest.approx([1e-4, 1e-3, 1e-2, 1e-1])
    assert grids["b"].tolist() == [1.0, 4.0, 7.0, 10.0]
    assert grids["c"].tolist() == [1.0, 2.5, 7.0]
    assert grids["d"].tolist() == [3.0]


MAP, CRITICAL = ["map", STUDY, *SMALL], ["critical", STUDY, "--name", "p", *SMALL]
BAD = {
    "no values": ([*MAP, "--over", "p"], "`--over` must be name=lo:hi:log:N"),
    "no name": ([*MAP, "--over", "=1,2"], "`--over` must be name=lo:hi:log:N"),
    "not a number": ([*MAP, "--over", "p=a,b"], "`--over` must be name=lo:hi:log:N"),
    "too few parts": ([*MAP, "--over", "p=0:1"], "but is `p=0:1`"),
    "unknown spacing": ([*MAP, "--over", "p=0:1:square:3"], "but is `p=0:1:square:3`"),
    "log from 0": ([*MAP, "--over", "p=0:1:log:3"], "`--over` must have lo < hi, lo > 0 for log"),
    "reversed": ([*MAP, "--over", "p=1:0:lin:3"], "`--over` must have lo < hi"),
    "one value": ([*MAP, "--over", "p=0:1:lin:1"], "2 to 1000 values"),
    "too many values": ([*MAP, "--over", "p=0:1:lin:1001"], "2 to 1000 values"),
    "twice": ([*MAP, "--over", "p=0,1", "--over", "p=0,1"], "`--over` must name each name once, but has `p` twice"),
    "three names": ([*MAP, "--over", "p=0", "--over", "flip=0", "--over", "scale=1"], "one or two names, but has 3"),
    "unknown name": ([*MAP, "--over", "pp=0,1"], "Did you mean `p`?"),
    "outside bounds": ([*MAP, "--over", "p=0,2"], "`p` must lie in [0, 1], but is 2"),
    "runs": ([*MAP, "--over", "p=0,1", "--runs", "0"], "`runs` must be at least 1"),
    "no picture": ([*MAP, "--over", "p=0,1", "--dimensionless"], "`--dimensionless` is about the picture"),
    "below": ([*CRITICAL, "--below", "2"], "`below` must lie strictly between 0 and 1"),
    "between": ([*CRITICAL, "--below", "0.1", "--between", "0.5"], "`--between` must be lo:hi with two numbers"),
    "side": ([*CRITICAL, "--below", "0.1", "--side", "up"], "'up' is not one of"),
    "budget": ([*CRITICAL, "--below", "0.1", "--budget", "1"], "`budget_per_test` must be at least"),
    "critical name": (["critical", STUDY, "--name", "pp", "--below", "0.1"], "Did you mean `p`?"),
    "metric": ([*COMMANDS["compare"], "--metric", "speed"], "There is no column `speed`"),
    "override": ([*COMMANDS["compare"], "-S", "pp=1"], "There is no name `pp`"),
    "no file": (["compare", "missing.py"], "there is no file `missing.py`"),
}


@pytest.mark.parametrize(("arguments", "message"), BAD.values(), ids=BAD)
def test_bad_arguments_exit_2_with_one_sentence(arguments, message):
    done = qsmc(*arguments)
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert "Traceback" not in done.output


NO_STUDIES = {
    "none": "x = 1",
    "no dictionary": "studies = [1]",
    "no study in it": "studies = {'a': 1}",
    "empty": "studies = {}",
}


@pytest.mark.parametrize("text", NO_STUDIES.values(), ids=NO_STUDIES)
def test_a_file_without_studies_is_told(tmp_path, text):
    path = tmp_path / "study.py"
    path.write_text(text)
    done = qsmc("compare", path)
    assert done.exit_code == 2
    assert "must define `studies`, a dictionary of `qsmc_jax.Study` by name" in done.output


@pytest.mark.parametrize("command", COMMANDS.values(), ids=COMMANDS)
def test_an_existing_output_folder_is_refused_and_kept(command, tmp_path):
    (tmp_path / "precious.txt").write_text("data")
    done = qsmc(*command, "--out", tmp_path)
    assert done.exit_code == 2
    assert "must be a new folder" in done.output
    assert files(tmp_path) == ["precious.txt"]

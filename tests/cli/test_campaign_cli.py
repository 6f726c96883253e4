"""Commands on run folders, as a user gives them."""

import html.parser
import inspect
import json
import shutil
import subprocess
import warnings

import matplotlib.image
import numpy as np
import pyarrow.csv
import pyarrow.parquet as pq
import pytest
from scipy.io import netcdf_file
from typer.testing import CliRunner

import places
from qsmc_jax.campaign.folder import FILE_RUNS
from qsmc_jax.cli.main import app
from qsmc_jax.cli.verify_command import verify_study
from qsmc_jax.verification.stopping import LOOK

STUDY = places.STUDY
SMALL = ["--block", "64", "--file-runs", "64"]
BROWSERS = ("chromium", "chromium-browser", "google-chrome", "chrome")


def qsmc(*arguments):
    """Runs the command in this process, without touching the user's cache folder."""
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A finished campaign of 128 runs."""
    path = tmp_path_factory.mktemp("campaign") / "run"
    done = qsmc("verify", STUDY, "--runs", 128, *SMALL, "--out", path, "--no-cache")
    assert done.exit_code == 0, done.output
    return path


def table(run):
    return pq.read_table(run / "blocks").to_pydict()


@pytest.mark.slow
def test_status_says_how_far_it_is(run):
    done = qsmc("status", run)
    assert "128 of 128 runs (100 %), verdict HELD" in done.output
    assert json.loads(qsmc("status", run, "--json").output)["solved"] == 128


@pytest.mark.slow
def test_show_replays_a_run_and_the_worst(run, tmp_path):
    out = tmp_path / "shown"
    done = qsmc("show", run, "--run", 7, "--out", out, "--no-cache")
    assert done.exit_code == 0, done.output
    assert "it agrees" in done.output
    metrics = json.loads((out / "run.json").read_text())
    assert metrics["recorded"]["peak_ratio"] == table(run)["peak_ratio"][7]
    assert metrics["peak_ratio"] == pytest.approx(table(run)["peak_ratio"][7], rel=1e-4)
    done = qsmc("show", run, "--worst", 1, "--json", "--no-cache")
    worst = json.loads((run / "summary.json").read_text())["worst"][0]
    assert json.loads(done.stdout)["recorded"]["index"] == worst["index"]


@pytest.mark.slow
def test_the_study_is_run_where_it_was_named_and_never_in_the_folder(run, tmp_path):
    moved = tmp_path / "run"
    shutil.copytree(run, moved)
    manifest = json.loads((moved / "manifest.json").read_text())
    (moved / "manifest.json").write_text(json.dumps({**manifest, "study_path": str(moved / "study.py")}))
    done = qsmc("show", moved, "--run", 7, "--no-cache")
    assert done.exit_code == 2
    assert "Name the file by --study" in done.output
    assert qsmc("show", moved, "--run", 7, "--study", STUDY, "--no-cache").exit_code == 0
    changed = tmp_path / "changed.py"
    changed.write_text(STUDY.read_text().replace("-1.0, 1.2", "-1.0, 1.1"))
    done = qsmc("show", moved, "--run", 7, "--study", changed, "--no-cache")
    assert done.exit_code == 2
    assert "`study_code`" in done.output


def test_exported_rows_are_those_of_the_blocks(run, tmp_path):
    csv, netcdf = tmp_path / "rows.csv", tmp_path / "rows.nc"
    assert qsmc("export", run, "--to", "csv", "--out", csv).exit_code == 0
    assert qsmc("export", run, "--to", "netcdf", "--out", netcdf).exit_code == 0
    expected, found = table(run), pyarrow.csv.read_csv(csv).to_pydict()
    with netcdf_file(netcdf, mmap=False) as file:
        for name, values in expected.items():
            np.testing.assert_array_equal(np.array(found[name], float), np.array(values, float), err_msg=name)
            np.testing.assert_array_equal(file.variables[name][:].astype(float), np.array(values, float), err_msg=name)
        assert file.variables["verdict"].flag_meanings.split()[0] == b"HELD"
        assert file.variables["margin"].unit == b"-"
    assert "must be a new file" in qsmc("export", run, "--to", "csv", "--out", csv).output


@pytest.mark.slow
def test_fresh_begins_beside_and_compare_holds_the_two_against_each_other(run, tmp_path):
    first = tmp_path / "run"
    shutil.copytree(run, first)
    done = qsmc("verify", STUDY, "--runs", 64, "-S", "mu=2", *SMALL, "--out", first, "--no-cache")
    assert done.exit_code == 2
    assert "`values`" in done.output
    done = qsmc("verify", STUDY, "--runs", 64, "-S", "mu=2", *SMALL, "--out", first, "--fresh", "--no-cache")
    assert done.exit_code == 0, done.output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["run", "run-2"]
    done = qsmc("compare", first, tmp_path / "run-2", "--no-cache")
    assert "values: {} / {'mu': 2.0}" in done.output
    assert "Of 64 runs with the same draws" in done.output


@pytest.mark.slow
def test_a_rule_stops_early_and_says_so(tmp_path):
    done = qsmc("verify", STUDY, "--runs", 640, *SMALL, "--until-below", 0.03, "--out", tmp_path / "run", "--no-cache")
    assert done.exit_code == 0, done.output
    assert "Stopped after 128 runs: the violation probability is at most 0.03." in done.output
    assert "at any time" in done.output


@pytest.mark.slow
def test_a_worker_solves_its_shard(tmp_path):
    path = tmp_path / "run"
    assert qsmc("verify", STUDY, "--runs", 192, *SMALL, "--out", path, "--prepare", "--no-cache").exit_code == 0
    done = qsmc("worker", path, "--shard", "1/2", "--block", 64, "--no-cache")
    assert done.exit_code == 0, done.output
    assert "64 of 192 runs" in qsmc("status", path).output


BAD = {
    "no folder": (["status", "missing"], "has no `manifest.json`"),
    "shard": (["worker", "RUN", "--shard", "2/2", "--no-cache"], "must be i/n with 0 <= i < n, but is 2/2"),
    "shard text": (["worker", "RUN", "--shard", "two", "--no-cache"], "must be I/N such as 0/4, but is `two`"),
    "no such run": (["show", "RUN", "--run", "999", "--no-cache"], "has no row 999"),
    "neither": (["show", "RUN", "--no-cache"], "One of `--run` and `--worst`"),
    "two rules": (["verify", STUDY, "--until-below", "0.1", "--until-width", "0.1"], "Only one of"),
    "sprt": (["verify", STUDY, "--sprt", "0.1"], "must be P0,P1 such as 2e-3,1e-3, but is `0.1`"),
    "below": (["verify", STUDY, "--until-below", "2"], "must lie in (0, 1), but is 2"),
    "no out": (["verify", STUDY, "--fresh"], "need a folder: `--out`"),
    "file runs": (["verify", STUDY, "--out", "NEW", "--file-runs", "0"], "`file_runs` must be at least 1, but is 0"),
}


@pytest.mark.parametrize(("arguments", "message"), BAD.values(), ids=BAD)
def test_bad_input_exits_2_with_one_sentence(run, tmp_path, arguments, message):
    places = {"RUN": run, "NEW": tmp_path / "new"}
    done = qsmc(*(places.get(each, each) for each in map(str, arguments)))
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert "Traceback" not in done.output


class Page(html.parser.HTMLParser):
    """Texts, and what a browser would load."""

    def __init__(self):
        super().__init__()
        self.text, self.loaded = "", []

    def handle_data(self, data):
        self.text += data

    def handle_starttag(self, tag, attrs):
        self.loaded += [value for name, value in attrs if name in ("src", "href")]


def test_the_report_is_one_page_that_loads_nothing_and_says_the_verdict(run):
    (run / "report.html").unlink()
    assert qsmc("report", run).exit_code == 0
    page = Page()
    page.feed((run / "report.html").read_text())
    summary = json.loads((run / "summary.json").read_text())
    assert summary["conclusion"] in page.text
    assert f"qsmc show {run} --run {summary['worst'][0]['index']}" in page.text
    assert "Spearman" in page.text or "rank correlation" in page.text
    assert len(page.loaded) == 2
    assert all(each.startswith("data:image/png;base64,") for each in page.loaded)


def test_the_report_says_what_the_check_changed_and_how_to_solve_all_runs_so(run, tmp_path):
    there = tmp_path / "run"
    shutil.copytree(run, there)
    summary = json.loads((there / "summary.json").read_text())
    infinite = {"absolute": None, "relative": None, "infinite": {"absolute": 1, "relative": 1}}
    changes = {"energy_u": infinite, "steps": {"absolute": 0.0, "relative": 0.0}}
    error = {"checked": 9, "peak_ratio": 0.25, "changed": 2, "unchecked": 3, "metrics": changes}
    (there / "summary.json").write_text(json.dumps({**summary, "numerical_error": error}))
    assert qsmc("report", there).exit_code == 0
    page = Page()
    page.feed((there / "report.html").read_text())
    text = " ".join(page.text.split())
    assert "changed by 0.25 at most, and 2 verdicts changed; 3 more came to no verdict" in text
    assert f"qsmc verify {STUDY} --runs 128" in text
    assert "--rtol 1e-08 --max-steps 1000000 --method other --out firmer" in text
    assert "energy_u" in text.partition("metrics that changed most")[2].partition("Worst runs")[0]


@pytest.mark.slow
@pytest.mark.skipif(not any(map(shutil.which, BROWSERS)), reason="needs a Chromium browser")
def test_a_browser_shows_the_report(run, tmp_path):
    browser = next(filter(None, map(shutil.which, BROWSERS)))
    options = ["--headless", "--no-sandbox", "--disable-gpu", "--disable-dev-shm-usage", "--window-size=1100,3200"]
    address = (run / "report.html").as_uri()
    made = subprocess.run([browser, *options, "--dump-dom", address], capture_output=True, text=True, timeout=120)
    assert json.loads((run / "summary.json").read_text())["conclusion"] in made.stdout
    picture = tmp_path / "page.png"
    subprocess.run(
        [browser, *options, f"--screenshot={picture}", address], capture_output=True, timeout=120, check=True
    )

    pixels = matplotlib.image.imread(picture)[..., :3]
    assert pixels.shape[1] == 1100
    # Text and pictures from top to bottom: no long part of the page is empty.
    inked = (pixels < 0.9).any(axis=(1, 2))
    assert np.diff(np.flatnonzero(inked[:2000])).max() < 200


@pytest.mark.slow
def test_a_damaged_block_is_told_on_the_command_line(run, tmp_path):
    path = tmp_path / "run"
    shutil.copytree(run, path)
    block = sorted((path / "blocks").iterdir())[0]
    block.write_bytes(block.read_bytes()[:-1])
    with warnings.catch_warnings():
        done = qsmc("verify", STUDY, "--runs", 128, *SMALL, "--out", path, "--no-cache")
    assert done.exit_code == 0, done.output
    assert "is damaged: moved to" in done.output


def test_rules_look_as_often_with_a_folder_as_without_one():
    assert inspect.signature(verify_study).parameters["file_runs"].default == FILE_RUNS == LOOK

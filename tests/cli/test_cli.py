"""The command line: exit codes, files, and errors in one sentence. Each error is tried as a user would make it."""

import json
import os
import shutil
import subprocess
import sys
import time
from typing import get_args

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import places
from qsmc_jax.cli import options
from qsmc_jax.cli.main import app
from qsmc_jax.simulation import settings

STUDY = str(places.STUDY)
SMALL = ["--runs", "64", "--block", "64"]


def qsmc(*arguments):
    """Runs the command in this process, without touching the user's cache folder."""
    return CliRunner().invoke(app, [*map(str, arguments), "--no-cache"])


def test_verify_writes_rows_verdict_and_picture(tmp_path):
    out = tmp_path / "result"
    done = qsmc("verify", STUDY, *SMALL, "--out", out)
    assert done.exit_code == 0, done.output
    assert "HELD in all" in done.output
    assert sorted(p.name for p in tmp_path.iterdir()) == ["result"]
    files = ["blocks", "figures", "manifest.json", "report.html", "requests", "sessions", "study.py", "summary.json"]
    assert sorted(p.name for p in out.iterdir()) == files
    rows = pq.read_table(out / "blocks").to_pydict()
    verdict = json.loads((out / "summary.json").read_text())
    assert sorted(rows["index"]) == list(range(64))
    assert np.sum(np.array(rows["verdict"]) == 0) == verdict["claims"][0]["held"]
    assert verdict["provenance"]["study_sha256"]
    assert f"qsmc show {out} --run" in done.output


def test_json_is_the_only_thing_on_standard_output():
    done = qsmc("verify", STUDY, *SMALL, "--json")
    printed = json.loads(done.stdout)
    assert printed["verdict"] == "HELD"
    assert printed["provenance"]["study_sha256"]


def test_a_violation_exits_1():
    done = qsmc("verify", STUDY, *SMALL, "-S", "gain_sign=-1", "--method", "rodas5p")
    assert done.exit_code == 1
    assert "left the funnel at" in done.output
    # The violated runs were decided by the second solve, at a hundredth of the tolerance.
    assert "--rtol 1e-08 --method rodas5p" in done.output


def test_methods_are_those_of_the_settings():
    assert get_args(get_args(options.Method)[0]) == get_args(settings.Method)


def test_an_undecided_verification_exits_3():
    done = qsmc("verify", STUDY, *SMALL, "-S", "t1=1")
    assert done.exit_code == 3
    # The reaching time is that of the paper, the logarithm of 10 here.
    assert "The reaching time 2.303 s lies beyond the horizon 1 s: make `t1` longer." in done.output


def blocks_of(folder):
    return list((folder / "blocks").iterdir())


def test_a_hard_interruption_exits_3_and_keeps_no_half_block(tmp_path, monkeypatch):
    def interrupt(*_, **__):
        raise KeyboardInterrupt

    monkeypatch.setattr("qsmc_jax.campaign.config.CampaignConfig.solve", interrupt)
    done = qsmc("verify", STUDY, *SMALL, "--out", tmp_path / "result")
    assert done.exit_code == 3
    assert blocks_of(tmp_path / "result") == []


@pytest.mark.slow
def test_simulate_replays_the_row_of_a_run(tmp_path):
    # Another program: it rounds differently, and may refuse a step that the other just kept; so at a tight tolerance.
    out, tight = tmp_path / "result", ("--rtol", 1e-12)
    assert qsmc("verify", STUDY, *SMALL, *tight, "--seed", 3, "--out", out).exit_code == 0
    rows = pq.read_table(out / "blocks").to_pydict()
    row = rows["index"].index(5)
    run = tmp_path / "run"
    assert qsmc("simulate", STUDY, "--index", 5, *tight, "--seed", 3, "--out", run).exit_code == 0
    metrics = json.loads((run / "run.json").read_text())
    assert metrics["peak_ratio"] == pytest.approx(rows["peak_ratio"][row], rel=1e-9)
    assert sorted(p.name for p in run.iterdir()) == ["result.npz", "run.json", "run.png", "signals.parquet"]


def test_help_is_quick():
    command = [sys.executable, "-c", "from qsmc_jax.cli.main import app; app(['--help'])"]
    begin = time.perf_counter()
    done = subprocess.run(command, capture_output=True, text=True, check=True)
    assert "verify" in done.stdout
    assert "jax" not in _modules_after("import qsmc_jax.cli.main")
    assert time.perf_counter() - begin < 30


@pytest.mark.slow
@pytest.mark.parametrize(("option", "is_kept"), [("--cache", True), ("--no-cache", False)])
def test_compiled_programs_are_kept_only_if_wanted(tmp_path, option, is_kept):
    program = (
        f"from qsmc_jax.cli.main import app; app(['verify', {STUDY!r}, '--runs', '64', '--block', '64', '{option}'])"
    )
    environment = {**os.environ, "XDG_CACHE_HOME": str(tmp_path), "HOME": str(tmp_path), "LOCALAPPDATA": str(tmp_path)}
    subprocess.run([sys.executable, "-c", program], env=environment, check=True, capture_output=True)
    assert any(tmp_path.rglob("jit_*-cache")) == is_kept


def _modules_after(statement):
    program = f"{statement}; import sys; print(' '.join(sys.modules))"
    return subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True).stdout.split()


BROKEN = {
    "no study": ("x = 1", "must define `study = qsmc_jax.Study(scenario, bandwidth)`, but has no `study`"),
    "not a study": ("study = 3", "a `study` that is a `int`"),
    "raises": ("x = 1\n1 / 0", "line 2: ZeroDivisionError: division by zero"),
    "syntax": ("def (", "SyntaxError"),
    "in a function": (
        "import numpy as np\nimport qsmc_jax as qj\ndef scenario(draw):\n    x = np.exp(draw.uniform('a', -1.0, 0.0))\n"
        "    return qj.Scenario(qj.paper.example1(), x0=[x, x], t1=1.0)\n"
        "study = qj.Study(scenario, bandwidth=0.1)",
        "line 4: Argument `scenario` must be written with `jax.numpy`",
    ),
}


@pytest.mark.parametrize(("text", "message"), BROKEN.values(), ids=BROKEN)
def test_a_broken_study_file_is_told_with_its_line(tmp_path, text, message):
    path = tmp_path / "study.py"
    path.write_text(text)
    done = qsmc("verify", path, *SMALL)
    assert done.exit_code == 2
    assert message in done.output
    assert "Traceback" not in done.output


HEAD = """
import qsmc_jax as qj
from studies_for_tests import Integrator

def loop(funnel=(1.0, 1.0, 0.1), c=(), plant=None, reference=None):
    control = qj.QuasiSlidingControl(qj.SlidingSurface(list(c)), qj.Funnel(*funnel))
    plant, reference = plant or Integrator(1.0), reference or qj.references.Constant(0.0)
    return qj.ClosedLoop(plant, reference, qj.disturbances.Zero(), control)

def study_of(make, x0=(0.5,), bandwidth=0.2):
    return qj.Study(lambda draw: qj.Scenario(make(draw), x0=list(x0), t1=5.0), bandwidth)
"""

BAD = {
    "c too long": ("study = study_of(lambda d: loop(c=[1.0]))", "`c` of the sliding surface must have 0 coefficients"),
    "c not Hurwitz": ("study = study_of(lambda d: loop(c=[-1.0]))", "Hurwitz, but has the root 1"),
    "rho_inf = bandwidth": (
        "study = study_of(lambda d: loop(), bandwidth=0.1)",
        "`bandwidth` must lie strictly between",
    ),
    "bandwidth = rho0": ("study = study_of(lambda d: loop(), bandwidth=1.0)", "`bandwidth` must lie strictly between"),
    "rho0 < 0": ("study = study_of(lambda d: loop(funnel=(-1.0, 1.0, 0.1)))", "`rho0` must be positive"),
    "mu = 0": ("study = study_of(lambda d: loop(funnel=(1.0, 0.0, 0.1)))", "`mu` must be positive"),
    "rho_inf NaN": ("study = study_of(lambda d: loop(funnel=(1.0, 1.0, float('nan'))))", "`rho_inf` must be positive"),
    "x0 too long": ("study = study_of(lambda d: loop(), x0=(0.1, 0.1))", "`x0` must have shape (1,)"),
    "x0 inf": ("study = study_of(lambda d: loop(), x0=(float('inf'),))", "`x0` must be finite"),
    "two draws of one name": (
        "study = study_of(lambda d: loop(funnel=(d.uniform('a', 1.0, 2.0), d.uniform('a', 1.0, 2.0), 0.1)))",
        "`a` a second time",
    ),
    "not smooth": (
        "import jax.numpy as jnp\nkinked = qj.references.Smooth(lambda t: jnp.abs(t - 1.0))\n"
        "study = study_of(lambda d: loop(reference=kinked))",
        "must be smooth",
    ),
    "drift of the wrong shape": (
        "import jax.numpy as jnp\nclass P(qj.AbstractPlant):\n    order = 1\n"
        "    def drift(self, t, x):\n        return jnp.zeros(2)\n"
        "    def gain(self, t, x):\n        return 1.0\nstudy = study_of(lambda d: loop(plant=P()))",
        "`drift` of `P` must return one number, but returns shape (2,)",
    ),
}


@pytest.mark.parametrize(("text", "message"), BAD.values(), ids=BAD)
def test_bad_input_in_a_study_names_the_argument(tmp_path, text, message):
    path = tmp_path / "study.py"
    path.write_text(HEAD + text)
    done = qsmc("verify", path, *SMALL)
    assert done.exit_code == 2, done.output
    assert message in done.output.replace("\n", " ")
    assert "Traceback" not in done.output


ARGUMENTS = {
    "no file": (["missing.py"], "there is no file `missing.py`"),
    "runs": ([STUDY, "--runs", "0"], "`runs` must be at least 1"),
    "confidence": ([STUDY, "--confidence", "1"], "`confidence` must lie strictly between 0 and 1"),
    "seed": ([STUDY, "--seed", "-1"], "`seed` must be in [0, 2**63)"),
    "unknown name": ([STUDY, "-S", "muu=1"], "Did you mean `mu`?"),
    "outside bounds": ([STUDY, "-S", "mu=100"], "`mu` must lie in [0.5, 4], but is 100"),
    "not a number": ([STUDY, "-S", "mu=fast"], "must be name=value with a number"),
    "rtol": ([STUDY, "--rtol", "-1"], "`rtol` must be positive"),
    "threads": ([STUDY, "--threads", "0"], "`threads` must be at least 1"),
}


@pytest.mark.parametrize(("arguments", "message"), ARGUMENTS.values(), ids=ARGUMENTS)
def test_bad_arguments_exit_2_with_one_sentence(arguments, message):
    done = qsmc("verify", *arguments)
    assert done.exit_code == 2, done.output
    assert message in done.output
    assert "Traceback" not in done.output


def test_an_existing_output_folder_is_refused_and_kept(tmp_path):
    (tmp_path / "precious.txt").write_text("data")
    done = qsmc("verify", STUDY, *SMALL, "--out", tmp_path)
    assert done.exit_code == 2
    assert "must be a new folder or one of this study" in done.output
    assert (tmp_path / "precious.txt").read_text() == "data"


def test_an_output_folder_that_cannot_be_made_is_refused(tmp_path):
    (tmp_path / "file").write_text("not a folder")
    done = qsmc("verify", STUDY, *SMALL, "--out", tmp_path / "file" / "result")
    assert done.exit_code == 2
    assert "can't" in done.output


def test_a_failure_leaves_nothing_half_written(tmp_path):
    study = tmp_path / "study.py"
    shutil.copy(STUDY, study)
    done = qsmc("verify", study, *SMALL, "-S", "nothing=1", "--out", tmp_path / "result")
    assert done.exit_code == 2
    assert [p.name for p in tmp_path.iterdir()] == ["study.py"]

"""A newcomer's path: `qsmc init`, a verification of what it wrote, `qsmc doctor`."""

import json
import os
import platform
import runpy
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest
from typer.testing import CliRunner

from qsmc_jax.cli.main import app


def qsmc(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.mark.slow
def test_init_writes_a_study_that_holds_at_once(tmp_path):
    path = tmp_path / "my_study.py"
    done = qsmc("init", path)
    assert done.exit_code == 0, done.output
    assert f"qsmc verify {path}" in done.output
    done = qsmc("verify", path, "--runs", 64, "--block", 64, "--no-cache")
    assert done.exit_code == 0, done.output
    assert "HELD in all 64" in done.output


def test_the_plant_of_the_first_study_is_what_it_says(tmp_path):
    path = tmp_path / "my_study.py"
    qsmc("init", path)
    plant = runpy.run_path(str(path))["MyPlant"](mass=2.0, stiffness=3.0, damping=0.5)
    x = np.array([0.7, -0.2])
    assert float(plant.drift(0.0, x)) == pytest.approx(-(3.0 * (0.7 + 0.5 * 0.7**3) + 0.5 * -0.2) / 2.0)
    assert float(plant.gain(0.0, x)) == pytest.approx(0.5)


BAD = {
    "exists": ("there.py", "must be a new file"),
    "no Python file": ("study", "must be a Python file, such as `study.py`"),
    "no folder": ("missing/study.py", "can't be written"),
}


@pytest.mark.parametrize(("name", "message"), BAD.values(), ids=BAD)
def test_init_overwrites_nothing_and_says_why(tmp_path, name, message):
    (tmp_path / "there.py").write_text("precious")
    done = qsmc("init", tmp_path / name)
    assert done.exit_code == 2
    assert message in done.output
    assert (tmp_path / "there.py").read_text() == "precious"


@pytest.mark.slow
def test_doctor_says_what_there_is_and_tries_a_solve():
    program = "from qsmc_jax.cli.main import app; app(['doctor', '--no-cache', '--json'])"
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    facts = json.loads(done.stdout)
    assert facts["is_well"] is True
    assert facts["python"].startswith(platform.python_version())
    assert facts["jax"] == jax.__version__
    assert facts["devices"].startswith("cpu")
    assert facts["cores"] == os.cpu_count()
    assert "default is float32" in facts["precision"]
    assert facts["Example 1 of the paper"].startswith("HELD")
    assert facts["elementary functions under the batches' compiler options"] == "right"


def test_init_says_in_json_where_it_wrote(tmp_path):
    done = qsmc("init", tmp_path / "new.py", "--json")
    assert done.exit_code == 0
    assert Path(json.loads(done.stdout)["written"]).is_file()

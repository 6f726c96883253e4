"""The command `qsmc falsify`: exit codes, files, and errors in one sentence."""

import json

import pytest
from typer.testing import CliRunner

import places
import qsmc_jax as qj
from qsmc_jax.cli.main import app

STUDY = """
import sys
sys.path.insert(0, {tests!r})
from studies_for_tests import study
study = study.substitute(g=1.0, x0=[0.1])
"""


def qsmc(*arguments):
    return CliRunner().invoke(app, [*map(str, arguments), "--no-cache"])


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "study.py"
    path.write_text(STUDY.format(tests=str(places.ROOT / "tests")))
    return path


def test_a_violation_has_exit_code_1_and_none_0(file, tmp_path):
    for sign, code, verdict in ((-1, 1, "VIOLATED"), (1, 0, "HELD")):
        done = qsmc("falsify", file, "-S", f"gain_sign={sign}", "--budget", 40, "--json", "--out", tmp_path / verdict)
        assert done.exit_code == code, done.output
        said = json.loads(done.stdout)
        assert said["verdict"] == verdict
        assert said["simulations"] <= 40
        names = {path.name for path in (tmp_path / verdict).iterdir()}
        assert {"falsification.json", "falsification.parquet", "falsification.png", "result.npz"} == names


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--budget", "0"], "Argument `budget` must be at least 1, but is 0."),
        (["--of", "peek_u"], "is `peek_u`. Did you mean `peak_u`?"),
        (["--adversary", "-1"], "Argument `adversary` must be at least 0, but is -1."),
    ],
)
def test_bad_input_has_exit_code_2(file, arguments, message):
    done = qsmc("falsify", file, *arguments)
    assert done.exit_code == 2
    assert message in done.stderr


def test_several_inputs_have_an_adversary_each():
    import runpy

    from qsmc_jax.falsification.adversary import against

    study = runpy.run_path(str(places.ROOT / "studies" / "two_link_arm.py"))["study"]
    attacked = against(study, 1)
    levels = [spec.name for spec in attacked.specs if spec.name.endswith(".level")]
    assert levels == ["adversary.0.level", "adversary.1.level"]
    assert all(type(d) is qj.disturbances.Telegraph for d in attacked.nominal.loop.disturbances)

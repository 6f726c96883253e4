"""The commands `qsmc certify` and `qsmc check`: exit codes, files, and errors in one sentence."""

import json

import pytest
from typer.testing import CliRunner

import places
import qsmc_jax as qj
from proof import proofs
from qsmc_jax.cli.main import app

STUDY = """
import sys
sys.path.insert(0, {tests!r})
from proof import proofs
study = proofs.still(sign={sign}, bound={bound})
"""


def qsmc(*arguments):
    return CliRunner().invoke(app, list(map(str, arguments)))


@pytest.fixture
def file(tmp_path):
    def write(sign=1.0, bound=2.0):
        path = tmp_path / f"study_{sign}_{bound}.py"
        path.write_text(STUDY.format(tests=str(places.ROOT / "tests"), sign=sign, bound=bound))
        return path

    return write


def test_a_study_is_proved_checked_and_told_from_others(file, tmp_path):
    out = tmp_path / "proof"
    done = qsmc("certify", file(), "--boxes", 1, "--out", out, "--json", "--no-cache")
    assert done.exit_code == 0, done.output
    said = json.loads(done.stdout)
    assert (said["verdict"], said["infinite"]) == ("PROVED", {"until": 1})
    assert {path.name for path in out.iterdir()} == {
        "certify.json",
        "proof.json",
        "proof.png",
        "tubes.npz",
    }
    assert qj.load(out, of=proofs.still()).peak_u == said["peak_u"]
    done = qsmc("check", out, file())
    assert done.exit_code == 0, done.output
    assert "PROVED: every run stays in its funnel for ever" in done.stdout
    assert "Checked" in qsmc("check", out).stdout
    other = qsmc("check", out, file(bound=1.5))
    assert other.exit_code == 2
    assert "The study must be that of the proof" in other.output
    content = (out / "proof.json").read_text()
    (out / "proof.json").write_text(content.replace('"peak_u": "0x1.', '"peak_u": "0x0.'))
    refused = qsmc("check", out)
    assert refused.exit_code == 2
    assert "what it claims of peak_u is not what follows" in " ".join(refused.output.split())


def test_what_is_not_proved_has_exit_code_3(file, tmp_path):
    done = qsmc("certify", file(sign=-1.0), "--out", tmp_path / "none", "--no-cache")
    assert done.exit_code == 3
    assert "NOT_PROVED: the gain has the wrong sign at the start" in done.stdout
    assert qsmc("check", tmp_path / "none").exit_code == 3


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--boxes", "0"], "Argument `boxes` must be at least 1, but is 0."),
        (["--target", "-1"], "Argument `target` must be positive, but is -1"),
    ],
)
def test_bad_input_has_exit_code_2(file, arguments, message):
    done = qsmc("certify", file(), *arguments)
    assert done.exit_code == 2
    assert message in " ".join(done.output.split())


def test_a_folder_that_holds_no_proof_has_exit_code_2(tmp_path):
    done = qsmc("check", tmp_path)
    assert done.exit_code == 2
    assert "must hold a proof that holds" in " ".join(done.output.split())

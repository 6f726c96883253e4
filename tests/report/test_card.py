"""One page for a study: a proof, an attack and random runs side by side."""

import json
import math

import pytest
from typer.testing import CliRunner

import places
import qsmc_jax as qj
from problems import STILL_BANDWIDTH
from proof import proofs
from qsmc_jax.cli.main import app
from qsmc_jax.report.card import Bracket, _require_consistent

STUDY = """
import sys
sys.path.insert(0, {tests!r})
from proof import proofs
study = proofs.still({arguments})
"""


def test_a_bracket_tells_which_part_of_what_is_certain_was_found():
    assert Bracket("peak_u", 4.0, 8.0, 16.0).part == 0.5
    assert Bracket("peak_u", 4.0, math.nan, 16.0).part == 0.25
    assert Bracket("peak_u", 4.0, 8.0, math.inf).part == 0.0


@pytest.mark.parametrize(("found", "violated", "is_refused"), [(1.00001, 0, False), (1.01, 0, True), (0.9, 1, True)])
def test_a_run_that_contradicts_the_proof_is_a_defect(found, violated, is_refused):
    brackets = (Bracket("peak_u", found, math.nan, 1.0),)
    if not is_refused:
        _require_consistent(brackets, violated)
        return
    with pytest.raises(RuntimeError, match="A run contradicts the proof"):
        _require_consistent(brackets, violated)


@pytest.mark.slow
def test_a_card_brackets_the_closed_form(tmp_path):
    """Of s' = d + u with |d| <= 2 the worst input is 2, which constant disturbances reach."""
    file, out = tmp_path / "study.py", tmp_path / "card"
    file.write_text(STUDY.format(tests=str(places.ROOT / "tests"), arguments=""))
    options = ["--runs", "64", "--budget", "60", "--boxes", "1", "--out", str(out), "--json", "--no-cache"]
    done = CliRunner().invoke(app, ["card", str(file), *options])
    assert done.exit_code == 3, done.output  # a funnel that stands still is not reached within any horizon
    said = json.loads(done.stdout)
    peak, ratio = said["brackets"]
    assert peak["random"] <= peak["attack"] <= 2.0 + 1e-9 <= peak["proof"] <= 2.02
    assert peak["attack"] == pytest.approx(2.0, rel=1e-6)
    assert ratio["attack"] == pytest.approx(2.0 / math.pi * math.atan(2.0), rel=1e-6)
    assert (said["verdict"], said["proof"]["verdict"]) == ("UNDECIDED", "PROVED")
    assert {path.name for path in out.iterdir()} == {"card.html", "card.json", "result.npz"}
    page = (out / "card.html").read_text()
    assert f"qsmc certify {file} --boxes 1 --out proof" in page
    assert f"qsmc falsify {file} --of peak_u --adversary 0 --budget 60 --seed 0" in page
    assert "certain: |g| &gt;= 1" in page
    again = qj.load(out, of=proofs.still())
    assert again.proof.peak_u == peak["proof"]


@pytest.mark.slow
def test_a_card_of_a_loop_that_no_proof_covers_says_so():
    loop = proofs.still().nominal.loop
    made = qj.ClosedLoop(loop.plant, loop.reference, loop.disturbance, loop.control, qj.Implementation(1e-2))
    scenario = lambda draw: qj.Scenario(made, x0=[draw.uniform("x0", -0.1, 0.1)], t1=3.0)  # noqa: E731
    card = qj.card(qj.Study(scenario, bandwidth=STILL_BANDWIDTH), 64, budget=20)
    assert card.proof is None
    assert "has an implementation: it is sampled" in str(card)
    assert card.brackets[0].proof == math.inf
    assert card.summary()["proof"]["verdict"] == "NOT_COVERED"
    assert [axis.get_ylabel() for axis in card.plot()] == ["sliding variable", "u"]

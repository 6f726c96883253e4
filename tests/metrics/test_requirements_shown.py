"""Requirements in every command, file, map, search and tuning."""

import json

import numpy as np
import pyarrow.parquet as pq
import pytest
from typer.testing import CliRunner

import qsmc_jax as qj
from falling_funnel import falling
from qsmc_jax.cli.main import app

VIOLATED = qj.Verdict.VIOLATED
SMALL = ["--no-cache", "--block", "64"]

FILE = """
import jax.numpy as jnp
import qsmc_jax as qj
def scenario(draw):
    funnel = qj.Funnel(4.0, draw.parameter('mu', 3.0, bounds=(1.0, 4.0)), 0.05)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), funnel)
    model = qj.paper.example1()
    loop = qj.ClosedLoop(model.plant, model.reference, qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=draw.uniform('x0', 0.1, 0.9, shape=(2,)), t1=3.0)
upward, arrives = qj.always(lambda s: LIMIT - s.u, unit='N'), qj.eventually(lambda s: 0.1 - jnp.abs(s.e[0]))
study = qj.Study(scenario, bandwidth=0.1, requirements={'upward': upward, 'arrives': arrives})
"""


@pytest.mark.slow
def test_the_commands_know_them(tmp_path):
    source, out, runner = tmp_path / "study.py", tmp_path / "run", CliRunner()
    source.write_text(FILE.replace("LIMIT", "0.2"))
    result = runner.invoke(app, ["verify", str(source), "--runs", "128", "--out", str(out), *SMALL])
    assert result.exit_code == 1, result.output
    rows = pq.read_table(next((out / "blocks").iterdir())).to_pandas()
    field = pq.read_schema(next((out / "blocks").iterdir())).field("margin_upward")
    assert field.metadata[b"unit"] == b"N"
    assert b"upward" in field.metadata[b"description"]
    said = json.loads((out / "summary.json").read_text())
    named = {claim["name"]: claim for claim in said["claims"]}
    violated = int((rows["verdict_upward"] == VIOLATED).sum())
    assert violated == int((rows["margin_upward"] < 0).sum())
    assert (named["upward"]["violated"], said["together"]["violated"]) == (violated, violated)
    assert violated > 0
    assert "requirement upward of the study" in (out / "report.html").read_text()
    worst = int(rows["margin_upward"].idxmin())
    shown = runner.invoke(
        app, ["show", str(out), "--worst", "1", "--of", "upward", "--study", str(source), "--no-cache"]
    )
    assert shown.exit_code == 0, shown.output
    assert f"recorded as run {rows['index'][worst]}:" in shown.output
    assert "it agrees" in shown.output
    assert f"margin_upward {rows['margin_upward'][worst]:.6g} N" in shown.output
    wrong = runner.invoke(
        app, ["show", str(out), "--worst", "1", "--of", "upwards", "--study", str(source), "--no-cache"]
    )
    assert wrong.exit_code == 2
    assert "Did you mean `upward`" in wrong.output
    alone = runner.invoke(app, ["simulate", str(source), "--index", str(rows["index"][worst]), "--no-cache"])
    assert (alone.exit_code, "upward VIOLATED" in alone.output) == (1, True)
    source.write_text(FILE.replace("LIMIT", "1.2"))
    again = runner.invoke(app, ["verify", str(source), "--runs", "256", "--out", str(out), *SMALL])
    assert again.exit_code == 2
    assert "requirement `upward`" in again.output


@pytest.mark.slow
def test_maps_searches_and_tuning_know_them():
    """The peak of u at the start falls with mu: a limit on it tells where."""
    spaces: dict = {}
    exec(FILE.replace("LIMIT", "1.2"), spaces)
    study = spaces["study"]
    found = qj.robustness_map(study, over={"mu": [1.0, 4.0]}, runs=64, claim="upward", block=64)
    rows = [qj.monte_carlo(study.substitute(mu=mu), 64, block=64) for mu in (1.0, 4.0)]
    assert found.claims["upward"].violated.tolist() == [int((each["margin_upward"] < 0).sum()) for each in rows]
    assert found.medians["margin_upward"] == pytest.approx([np.median(each["margin_upward"]) for each in rows])
    assert "violating upward" in str(found)
    assert found.high.tolist() == found.claims["upward"].high.tolist()
    assert "violating upward" in found.plot()[0].get_ylabel()
    search = qj.critical_value(study, "mu", below=0.5, claim="upward", steps=1, block=64)
    assert (
        search.tests[0].violated
        == qj.monte_carlo(study.substitute(mu=1.0), search.tests[0].runs, block=64).counts("upward")[VIOLATED]
    )
    assert "violating upward" in search.conclusion()
    options = {"runs": 8, "starts": 1, "steps": 6, "certificate_runs": 64, "block": 64}
    tuned = qj.tune(study, ["mu"], "mean(reach_time)", subject_to=["least(margin_upward) >= -0.6"], **options)
    kept = qj.monte_carlo(study.substitute(**tuned.gains), 8, block=64)
    with pytest.raises(
        qj.InputError, match="is the largest, but of `margin_upward` the smallest is the worst: use `least"
    ):
        qj.tune(study, ["mu"], "mean(reach_time)", subject_to=["worst(margin_upward) >= 0"], **options)
    assert kept["margin_upward"].min() >= -0.6 - 1e-6


@pytest.mark.parametrize(("limit", "side"), [(0.3, "above"), pytest.param(0.5, "at most", marks=pytest.mark.slow)])
def test_a_stopping_rule_looks_at_requirements_too(limit, side):
    """x0 is uniform in (0.2, 0.4), and no run leaves its funnel: one limit breaks in half of the runs, one in none."""
    study = qj.Study(falling, 0.3, requirements={"start": qj.always(lambda s: limit - s.x[0], before=1e-6)})
    found = qj.verify(study, 512, block=64, until=qj.stopping.UntilBelow(0.1))
    assert found.claims[0].violated == 0
    assert found.decision == f"the violation probability is {side} 0.1"

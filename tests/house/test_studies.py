"""Every study in studies/ runs and comes out as its docstring claims; the paper's from all their starts."""

import runpy

import numpy as np
import pytest

import places
import qsmc_jax as qj
from qsmc_jax.report.paper_table import as_text, rows, simulate_example

STUDIES = places.STUDIES
CLAIMED = {"paper_example1": qj.Verdict.HELD}
LONG = {
    "wrong_gain_sign": qj.Verdict.VIOLATED,
    "duffing": qj.Verdict.HELD,
    "cooling": qj.Verdict.HELD,
    "flexible_joint": qj.Verdict.HELD,
    "ship": qj.Verdict.HELD,
    "quarter_car": qj.Verdict.HELD,
    "cart_pole": qj.Verdict.HELD,
    "two_link_arm": qj.Verdict.HELD,
    "example1_implemented": qj.Verdict.HELD,
    "paper_example2": qj.Verdict.HELD,
    "example1_uncertain": qj.Verdict.HELD,
    "example2_uncertain": qj.Verdict.HELD,
    "example2_implemented": qj.Verdict.HELD,
    "example1_tuned": qj.Verdict.HELD,
    "example2_tuned": qj.Verdict.HELD,
}
COMPARED = {"controllers_compared"}
LIMITED = {"cstr"}


def study_of(name):
    """A study by its name."""
    return runpy.run_path(str(STUDIES / f"{name}.py"))["study"]


def run(name):
    """64 runs of a study."""
    return qj.monte_carlo(study_of(name), 64, block=64)


def test_every_study_is_tried():
    assert {path.stem for path in STUDIES.glob("*.py")} == {*CLAIMED, *LONG, *COMPARED, *LIMITED}


@pytest.mark.parametrize(
    ("name", "verdict"),
    [*CLAIMED.items(), *(pytest.param(*item, marks=pytest.mark.slow) for item in LONG.items())],
    ids=[*CLAIMED, *LONG],
)
def test_a_study_comes_out_as_it_claims(name, verdict):
    runs = run(name)
    assert np.all(runs["verdict"] == verdict)
    assert len(runs.names) > 0


@pytest.mark.slow
def test_a_reactor_s_limited_coolant_holds_most_runs_and_one_without_limits_all():
    limited, free = (
        qj.monte_carlo(study_of("cstr").substitute(**limits), 256)
        for limits in ({}, {"coldest": -20.0, "hottest": 20.0})
    )
    held, left = (limited["verdict"] == verdict for verdict in (qj.Verdict.HELD, qj.Verdict.VIOLATED))
    assert np.all(held | left)
    assert 0.0 < np.mean(left) < 0.05
    assert np.min(limited["min_u"][held]) <= -3.0
    assert np.max(limited["max_u"][held]) >= 1.75
    assert np.any(limited["verdict_temperature"][left] == qj.Verdict.VIOLATED)  # it runs away
    assert np.any(limited["verdict_temperature"][left] == qj.Verdict.UNDECIDED)  # it stays cold, to where it ended
    assert np.all(free["verdict"] == qj.Verdict.HELD)


def test_the_paper_table_is_met_for_example_1():
    table = rows(1, simulate_example(1))
    assert all(row.is_met for row in table)
    assert "0.725089" in as_text(table)  # oracles: .725089072754182 from (.1, .1)

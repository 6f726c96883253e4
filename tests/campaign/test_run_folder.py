"""What a run folder notes and counts, without solving a run."""

import dataclasses

import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.campaign.campaign import Blocks, prepare
from qsmc_jax.campaign.config import CampaignConfig, Solved
from qsmc_jax.campaign.folder import RunFolder
from qsmc_jax.study.runs import Runs
from studies_for_tests import study

SOURCE = b"study = ..."
CONFIG = CampaignConfig(study, SOURCE, seed=1)


@pytest.fixture
def folder(tmp_path):
    return prepare(tmp_path / "run", CONFIG, file_runs=64)


@pytest.mark.parametrize(
    ("asked", "answers"),
    {
        "once": ([(100, False)], [False]),
        "the same again": ([(100, False), (100, False)], [False, False]),
        "another number": ([(100, False), (200, False), (100, False)], [False, True, True]),
        "a rule": ([(100, True)], [True]),
        "a rule, once": ([(100, True), (100, False)], [True, True]),
    }.values(),
)
def test_intervals_must_hold_at_any_time_once_somebody_may_have_looked(folder, asked, answers):
    assert [folder.ask_for(*each) for each in asked] == answers


def test_the_cost_is_that_of_the_runs_asked_for(folder):
    for start, escalated, defects in ((0, (3, 1), (7, 63)), (64, (2, 0), (64, 100)), (128, (5, 5), (130,))):
        index = np.arange(start, start + 64)
        rows = Runs({"index": index, "d": index / 7.0, "verdict": np.zeros(64, int)}, ("d",))
        folder.add(Solved(rows, escalated, defects, 0, 0, 0.0), study.records)
    assert folder.cost(192) == {"escalated": (10, 6), "defects": (7, 63, 64, 100, 130)}
    assert folder.cost(128) == {"escalated": (5, 1), "defects": (7, 63, 64, 100)}
    assert folder.cost(64) == {"escalated": (3, 1), "defects": (7, 63)}
    assert folder.cost(100) == {"escalated": (5, 1), "defects": (7, 63, 64)}


CHANGES = {
    "seed": dataclasses.replace(CONFIG, seed=2),
    "rtol": dataclasses.replace(CONFIG, settings=qj.SolverSettings(rtol=1e-5, atol=1e-8)),
    "atol": dataclasses.replace(CONFIG, settings=qj.SolverSettings(atol=1e-7)),
    "method": dataclasses.replace(CONFIG, settings=qj.SolverSettings(method="rodas5p")),
    "max_steps": dataclasses.replace(CONFIG, settings=qj.SolverSettings(max_steps=7)),
    "coordinates": dataclasses.replace(CONFIG, settings=qj.SolverSettings(coordinates="physical")),
    "vectorise": dataclasses.replace(CONFIG, settings=qj.SolverSettings(vectorise=False)),
    "values": dataclasses.replace(CONFIG, study=study.substitute(mu=2.0)),
    "bandwidth": dataclasses.replace(CONFIG, study=qj.Study(study.scenario, bandwidth=0.3)),
    "study_code": dataclasses.replace(CONFIG, source=b"study = 1"),
}


@pytest.mark.parametrize("name", CHANGES)
def test_whatever_changes_a_row_is_in_the_identity(folder, name):
    changed = CHANGES[name].identity
    assert {key for key in changed if changed[key] != CONFIG.identity[key]} == {name}
    with pytest.raises(ValueError, match=f"belongs to another study: `{name}`"):
        folder.check(CHANGES[name])


def test_what_changes_no_row_is_not_in_the_identity(folder):
    folder.check(dataclasses.replace(CONFIG, block=128, threads=3, source=b"study  =  ...  # the same"))


def test_blocks_are_told_in_order_once_all_before_them_are_there(folder):
    blocks = Blocks(folder, CONFIG, 300, lambda: False)
    assert list(blocks.in_order(iter([2, 0, 4, 1, 3]))) == [64, 128, 192, 256, 300]
    assert list(blocks.in_order(iter([1, 3, 2]))) == []
    assert list(blocks.in_order(iter([1, 0]))) == [64, 128]


def test_a_folder_that_somebody_made_since_one_looked_is_shared_if_it_is_of_the_same_campaign(folder):
    """As where two commands start at once: both found no folder, and one was faster."""
    again = RunFolder.create(folder.path, CONFIG, "study.py", 64, {})
    assert again.manifest == folder.manifest
    with pytest.raises(qj.InputError, match="belongs to another study: `?seed"):
        RunFolder.create(folder.path, dataclasses.replace(CONFIG, seed=2), "study.py", 64, {})
    assert [each.name for each in folder.path.parent.iterdir()] == ["run"]

"""Campaigns: the rows of an uninterrupted verification, however they came about."""

import json
import sys
import warnings
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

import places
import qsmc_jax as qj
from qsmc_jax.campaign.campaign import prepare, run_campaign, work_shard
from qsmc_jax.campaign.config import CampaignConfig
from qsmc_jax.campaign.difference import difference
from qsmc_jax.campaign.engines import Task, Threads
from qsmc_jax.campaign.folder import RunFolder
from qsmc_jax.campaign.replay import replay
from qsmc_jax.campaign.status import status_of
from qsmc_jax.simulation.trajectory import Trajectory
from qsmc_jax.study.runs import concatenate
from qsmc_jax.verification.stopping import UntilBelow
from qsmc_jax.verification.tiers import Tiers
from studies_for_tests import study

SOURCE = places.STUDY.read_bytes()
CONFIG = CampaignConfig(study, SOURCE, seed=1, block=64, threads=1)
RUNS, SIZE = 320, 64


def rows(folder):
    """All rows, as one table."""
    return concatenate(list(folder.tables()))


def require_equal(first, second):
    """Equal to the last bit, row for row."""
    assert list(first) == list(second)
    for name in first:
        np.testing.assert_array_equal(first[name], second[name], err_msg=name)


@pytest.fixture(scope="module")
def plain():
    """What `verify` makes of the same runs, its rows in order."""
    tables = []
    found = qj.verify(study, RUNS, 1, block=64, threads=1, sink=tables.append)
    together = concatenate(tables)
    return found, together.take(together["index"].argsort())


def new(path, config=CONFIG, size=SIZE):
    return prepare(path, config, study_file=str(path.parent / "study.py"), file_runs=size)


def solved_in(monkeypatch):
    """The ranges solved from now on."""
    solved, solve = [], CampaignConfig.solve
    monkeypatch.setattr(
        CampaignConfig, "solve", lambda self, runs, *rest: solved.append(runs) or solve(self, runs, *rest)
    )
    return solved


def stopping_after(blocks):
    """Arguments that interrupt a campaign after so many blocks."""
    done = []
    return {"progress": lambda *told: done.append(told), "should_stop": lambda: len(done) >= blocks}


def test_rows_and_verdict_are_those_of_verify(tmp_path, plain):
    folder = new(tmp_path / "run")
    found = run_campaign(folder, CONFIG, RUNS)
    require_equal(rows(folder), plain[1])
    assert found is not None
    assert found.claims == plain[0].claims
    assert found.verdict == plain[0].verdict
    require_equal(found.worst, plain[0].worst)
    assert found.escalated == plain[0].escalated
    assert found.numerical_error == plain[0].numerical_error


def test_an_interrupted_campaign_goes_on_where_it_stopped(tmp_path, plain, monkeypatch):
    folder = new(tmp_path / "run")
    assert run_campaign(folder, CONFIG, RUNS, **stopping_after(2)) is None
    # The third was in hand when the second was done.
    assert status_of(folder).solved == 3 * SIZE
    assert folder.sessions()[-1]["state"] == "interrupted"
    solved = solved_in(monkeypatch)
    assert run_campaign(folder, CONFIG, RUNS) is not None
    # The first solve only makes sure that the study still gives the rows of each block in the folder.
    assert {i // SIZE for i in solved[0]} == {0, 1, 2}
    assert solved[1:] == [range(i, i + SIZE) for i in range(3 * SIZE, RUNS, SIZE)]
    require_equal(rows(folder), plain[1])


def test_more_runs_extend_it_and_fewer_report_on_the_first(tmp_path, plain, monkeypatch):
    folder = new(tmp_path / "run")
    assert run_campaign(folder, CONFIG, 100) is not None
    solved = solved_in(monkeypatch)
    more = run_campaign(folder, CONFIG, RUNS)
    assert solved[1:3] == [range(100, 128), range(128, 192)]
    require_equal(rows(folder), plain[1])
    fewer = run_campaign(folder, CONFIG, 150)
    assert fewer is not None
    assert more is not None
    assert fewer.runs == 150
    assert solved[-1] == range(256, 320)
    expected = plain[1].take(slice(150)).counts()
    assert fewer.claims[0].held == expected[qj.Verdict.HELD]
    # Whoever asks again may have looked: a fixed number's interval would no longer hold.
    assert more.is_anytime
    assert more.claims[0].high != plain[0].claims[0].high


def test_a_finished_campaign_solves_no_block_again(tmp_path, monkeypatch):
    folder = new(tmp_path / "run")
    run_campaign(folder, CONFIG, RUNS)
    solved = solved_in(monkeypatch)
    assert run_campaign(folder, CONFIG, RUNS) is not None
    assert solved == []


def test_an_engine_that_is_closed_leaves_the_block_in_hand(monkeypatch):
    finished, solve = [], CampaignConfig.solve

    def told(self, runs, progress=None):
        solved = solve(self, runs, progress)
        finished.append(runs)
        return solved

    monkeypatch.setattr(CampaignConfig, "solve", told)
    tasks = [Task(0, (range(64),)), Task(1, (range(64, 64 + 2000 * 64),))]
    results = Threads().solve(CONFIG, iter(tasks))
    assert next(results)[0] == tasks[0]
    results.close()
    assert finished == [range(64)]


CHANGES = {
    "seed": (lambda: CampaignConfig(study, SOURCE, seed=2), "`seed` \\(1 there, 2 now\\)"),
    "rtol": (lambda: CampaignConfig(study, SOURCE, 1, qj.SolverSettings(rtol=1e-5)), "`rtol`"),
    "values": (lambda: CampaignConfig(study.substitute(mu=2.0), SOURCE, 1), "`values`"),
    "code": (lambda: CampaignConfig(study, SOURCE + b"x = 1\n", 1), "`study_code`"),
}


@pytest.mark.parametrize(("change", "message"), CHANGES.values(), ids=CHANGES)
def test_another_study_is_refused_with_what_differs(tmp_path, change, message):
    new(tmp_path / "run")
    with pytest.raises(ValueError, match=message):
        new(tmp_path / "run", change())


def test_comments_threads_and_block_size_change_no_row_and_are_no_other_study(tmp_path):
    new(tmp_path / "run")
    new(tmp_path / "run", CampaignConfig(study, b"# a comment\n" + SOURCE, 1, block=128, threads=2))


@pytest.mark.slow
def test_a_module_that_the_study_imports_and_that_changed_is_noticed(tmp_path):
    folder = new(tmp_path / "run")
    run_campaign(folder, CONFIG, SIZE)
    changed = CampaignConfig(study.substitute(g=1.5), SOURCE, 1, block=64)
    # As if the same text gave another study.
    changed.__dict__["identity"] = CONFIG.identity
    with pytest.raises(ValueError, match="other rows than the study gives now: column `g` differs"):
        run_campaign(folder, changed, RUNS)


def damage(content):
    return bytes(content[:40]) + bytes([content[40] ^ 1]) + bytes(content[41:])


@pytest.mark.parametrize("spoil", [damage, lambda content: content[:-9]], ids=["a flipped bit", "a truncated file"])
def test_a_damaged_block_is_told_put_aside_and_solved_again(tmp_path, plain, spoil):
    folder = new(tmp_path / "run")
    run_campaign(folder, CONFIG, RUNS)
    path = sorted((folder.path / "blocks").iterdir())[2]
    path.write_bytes(spoil(path.read_bytes()))
    assert status_of(folder).damaged == (f"{path.name} is damaged",)
    with pytest.warns(UserWarning, match="is damaged"):
        found = run_campaign(folder, CONFIG, RUNS)
    assert found is not None
    require_equal(rows(folder), plain[1])
    assert [each.name for each in (folder.path / "damaged").iterdir()] == [path.name]


def test_overlapping_files_give_each_row_once(tmp_path, plain):
    folder = new(tmp_path / "run")
    for runs in (range(0, 100), range(50, 192), range(192, RUNS), range(128, 200)):
        folder.add(CONFIG.solve(runs), study.records)
    require_equal(rows(folder), plain[1])
    assert folder.missing(0, RUNS) == []


def test_a_rule_stops_a_resumed_campaign_where_it_stops_an_uninterrupted_one(tmp_path):
    rule, ends = UntilBelow(0.02), []
    for name, stops in {"whole": (), "resumed": (1, 2)}.items():
        folder = new(tmp_path / name)
        for stop in stops:
            run_campaign(folder, CONFIG, RUNS, until=rule, **stopping_after(stop))
        found = run_campaign(folder, CONFIG, RUNS, until=rule)
        assert found is not None
        ends.append((found.runs, found.decision, found.claims))
    assert ends[0] == ends[1]
    # 3.69 / 0.02 = 185 runs are needed: the third look of 64.
    assert ends[0][0] == 192


def test_shards_together_give_the_rows_and_verify_sums_up(tmp_path, plain, monkeypatch):
    folder = new(tmp_path / "run")
    folder.ask_for(RUNS, False)
    assert work_shard(folder, CONFIG, 1, 2)
    assert folder.missing(0, RUNS) == [range(0, 64), range(128, 192), range(256, 320)]
    assert work_shard(folder, CONFIG, 0, 2)
    solved = solved_in(monkeypatch)
    assert run_campaign(folder, CONFIG, RUNS) is not None
    assert solved == []
    require_equal(rows(folder), plain[1])


def test_reading_a_folder_runs_nothing_in_it(tmp_path):
    folder = new(tmp_path / "run")
    run_campaign(folder, CONFIG, SIZE)
    trap = tmp_path / "sprung"
    (folder.path / "study.py").write_text(f"open({str(trap)!r}, 'w')")
    reopened = RunFolder.open(folder.path)
    assert status_of(reopened).solved == SIZE
    assert len(rows(reopened)) == SIZE
    assert not trap.exists()


@pytest.mark.slow
def test_replay_holds_a_run_against_its_row(tmp_path):
    folder = new(tmp_path / "run")
    found = run_campaign(folder, CONFIG, RUNS)
    assert found is not None
    again = replay(folder, CONFIG, None, 2)
    assert again.row == found.worst.row(1)
    assert again.agrees
    assert "it agrees" in str(again)
    other = replay(folder, CampaignConfig(study.substitute(mu=2.0), SOURCE, seed=1), 3, None)
    assert not other.agrees
    for index, worst, message in [(None, None, "One of"), (RUNS, None, "no row 320"), (None, 10**6, "fewer rows")]:
        with pytest.raises(ValueError, match=message):
            replay(folder, CONFIG, index, worst)


class _Metrics(NamedTuple):
    verdict: int
    peak_ratio: float

    def named(self):
        return self._asdict()


def replayed(monkeypatch, row, verdicts):
    """The replay of a row by solves whose verdicts and peaks are given by tier; and the runs solved, by tier."""
    tiers, solved = Tiers.of(study, CONFIG.settings).settings, {}

    def solve(config, row, settings):
        tier = next(k for k, each in enumerate(tiers) if (each.choices, each.rtol) == (settings.choices, settings.rtol))
        solved[tier] = object.__new__(Trajectory)
        object.__setattr__(solved[tier], "metrics", _Metrics(verdicts[tier], 0.1 * tier))
        return solved[tier]

    # The package re-exports the function by the name of its module.
    module = sys.modules[replay.__module__]
    monkeypatch.setattr(module, "_solved", solve)
    monkeypatch.setattr(module, "_row", lambda folder, index: {"index": index, "outcome": 0, **row})
    return replay(RunFolder(Path("none")), CONFIG, 3, None), solved


@pytest.mark.parametrize("tier", [0, 1, 2])
def test_a_run_is_replayed_by_the_solve_that_decided_it(monkeypatch, tier):
    again, solved = replayed(monkeypatch, {"tier": tier, "verdict": 0, "peak_ratio": 0.1 * tier}, [0, 0, 0])
    assert list(solved) == [tier]
    assert again.agrees


DISPUTES = {"as before": ([1, 0, 2], 0, True), "otherwise": ([2, 1, 0], 1, True), "no more": ([0, 0, 0], 0, False)}


@pytest.mark.parametrize(("verdicts", "shown", "agrees"), DISPUTES.values(), ids=DISPUTES)
def test_a_disputed_run_is_replayed_by_every_solve(monkeypatch, verdicts, shown, agrees):
    row = {"tier": 2, "verdict": 2, "peak_ratio": float("nan"), "outcome": int(qj.Outcome.SOLVES_DISAGREE)}
    again, solved = replayed(monkeypatch, row, verdicts)
    assert list(solved) == [0, 1, 2]
    assert again.agrees == agrees
    assert again.trajectory is solved[shown]


def test_contrast_pairs_runs_with_equal_draws(tmp_path):
    changed = CampaignConfig(study.substitute(mu=2.0), SOURCE, seed=1, block=64)
    first, second = new(tmp_path / "a"), new(tmp_path / "b", changed)
    run_campaign(first, CONFIG, 128)
    run_campaign(second, changed, 64)
    found = difference(first, second)
    assert found.paired == 64
    assert list(found.changes) == ["values"]
    a, b = rows(first).take(slice(64)), rows(second)
    expected = np.nanquantile(b["margin"] - a["margin"], 0.5)
    assert found.margin_change[1] == pytest.approx(expected)
    claims = ("verdict", "verdict_reaching", "verdict_tracking")
    assert found.changed_count == np.sum(np.any([a[name] != b[name] for name in claims], axis=0))
    assert "differ in verdict" in str(found)


def test_the_manifest_says_what_decides_the_rows(tmp_path):
    folder = new(tmp_path / "run")
    manifest = json.loads((folder.path / "manifest.json").read_text())
    assert manifest["identity"]["seed"] == 1
    assert manifest["identity"]["parameters"]["mu"] == [1.0]
    assert (folder.path / "study.py").read_bytes() == SOURCE


def test_no_warning_in_a_sound_folder(tmp_path):
    folder = new(tmp_path / "run")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        run_campaign(folder, CONFIG, SIZE)

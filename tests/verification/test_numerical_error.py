"""The check of decided runs by another solve. Truth: rows written down by hand, and exact intervals of SciPy."""

import dataclasses
import math
from pathlib import Path

import numpy as np
import pytest
import scipy.stats

import qsmc_jax as qj
from coin_study import study
from qsmc_jax.cli.verify_command import _tell
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.verification.accumulate import Cost, VerificationAccumulator
from qsmc_jax.verification.numerical_error import SAMPLE, Sample, recheck
from qsmc_jax.verification.result import Claim
from qsmc_jax.verification.stopping import UntilBelow, decision_of
from qsmc_jax.verification.tiers import Tiers

VERDICTS = ("verdict", "verdict_reaching", "verdict_tracking")

H, V, U = (int(verdict) for verdict in (qj.Verdict.HELD, qj.Verdict.VIOLATED, qj.Verdict.UNDECIDED))
TIERS = Tiers.of(study, qj.SolverSettings())


def rows(verdicts, **columns):
    """Rows with the same verdict on every claim."""
    index, verdicts = np.arange(len(verdicts)), np.array(verdicts)
    metrics = {
        "outcome": np.zeros(len(index), int),
        "peak_ratio": 0.5 + index / 1000.0,
        "margin": 0.5 - index / 1000.0,
        "peak_u": np.ones(len(index)),
        "peak_u_bound": np.full(len(index), np.nan),
        "least_gain": np.ones(len(index)),
        "largest_disturbance": np.ones(len(index)),
        "violation_time": np.where(verdicts == V, 1.0, np.inf),
        "reach_time": np.ones(len(index)),
        "steps": np.full(len(index), 100),
        "tier": np.zeros(len(index), int),
    }
    claims = dict.fromkeys(VERDICTS, verdicts)
    return Runs({"index": index, "mass": index / 7.0, **claims, **metrics, **columns}, ("mass",))


def solving(answers, asked=None):
    """Stands for `stream`, giving rows out of a table, and noting which settings and which runs it was asked for."""

    def solve(indices, settings, block=512):
        if asked is not None:
            asked.append((settings, sorted(int(i) for i in indices)))
        columns = {name: answers[name] for name in answers if name != "tier"}
        yield Runs(columns, answers.names).take(np.asarray(indices))

    return solve


def conclude(before, after, worst=5, **options):
    """A verification of such rows, and of such rows when solved again."""
    accumulator, cost = VerificationAccumulator(study, worst), Cost((0, 0), (), 1.0, 1.0)
    accumulator.add(before)
    return accumulator.conclude(solving(after), cost, seed=0, confidence=0.95, settings=qj.SolverSettings(), **options)


def exact(violated, undecided, total):
    """Clopper and Pearson's interval, undecided runs counted both ways."""
    low = scipy.stats.binomtest(violated, total).proportion_ci(0.95, method="exact").low
    return low, scipy.stats.binomtest(violated + undecided, total).proportion_ci(0.95, method="exact").high


def test_the_sample_is_the_same_whatever_the_order_and_the_tables():
    whole, parts = Sample(100), Sample(100)
    everything = rows([H] * 5000)
    whole.add(everything)
    for part in np.array_split(np.random.default_rng(0).permutation(5000), 37):
        parts.add(everything.take(part))
    first, second = (concatenate(sample.rows)["index"] for sample in (whole, parts))
    assert len(first) == 100
    np.testing.assert_array_equal(first, second)


def test_the_sample_is_of_the_whole_campaign():
    """The mean index of 512 of 100 000 lies within four standard deviations of the middle, and no end is left out."""
    sample, runs = Sample(), 100_000
    for start in range(0, runs, 8192):
        index = np.arange(start, min(start + 8192, runs))
        sample.add(Runs({"index": index}, ()))
    index = concatenate(sample.rows)["index"]
    assert len(np.unique(index)) == SAMPLE
    assert abs(index.mean() - runs / 2) < 4 * runs / math.sqrt(12 * SAMPLE)
    assert scipy.stats.kstest(index / runs, "uniform").pvalue > 1e-3


def test_each_run_is_checked_by_another_method_than_decided_it():
    before, asked = rows([H, V, H, U], tier=np.array([0, 1, 2, 2])), []
    error, _ = recheck(before, solving(before, asked), TIERS)
    assert [(settings.method, float(settings.rtol), indices) for settings, indices in asked] == [
        ("other", pytest.approx(1e-8), [0]),
        ("other", pytest.approx(1e-8), [1]),
        ("rodas4", pytest.approx(1e-8), [2]),
    ]
    assert (error.checked, error.changed, error.unchecked, error.peak_ratio) == (3, 0, 0, 0.0)


def test_a_run_that_is_in_the_sample_and_among_the_worst_counts_once():
    before = rows([H, H])
    error, checks = recheck(concatenate([before, before]), solving(before), TIERS)
    assert (error.checked, checks["funnel"].held) == (2, 2)


def test_every_metric_is_compared():
    metrics = {
        "energy_u": (np.array([2.0, 4.0]), np.array([2.0, 5.0])),
        "settle_time": (np.array([1.0, np.inf]), np.array([1.0, np.inf])),
        "peak_rate_u": (np.array([np.nan, 0.0]), np.array([np.nan, 0.0])),
        "recovery_time": (np.array([0.0, np.inf]), np.array([0.0, 3.0])),
        "rms_error": (np.array([0.0, np.nan]), np.array([1e-9, 1.0])),
    }
    before, after = (rows([H, H], **{name: pair[k] for name, pair in metrics.items()}) for k in (0, 1))
    found = recheck(before, solving(after), TIERS)[0].metrics
    changes = {name: (found[name].absolute, found[name].relative) for name in metrics}
    assert changes == {
        "energy_u": (1.0, 0.2),
        "settle_time": (0.0, 0.0),
        "peak_rate_u": (0.0, 0.0),
        "recovery_time": (math.inf, math.inf),
        "rms_error": (math.inf, math.inf),
    }
    assert not {"mass", "index", "steps", "tier", "outcome", *VERDICTS} & set(found)


def test_the_metrics_that_changed_most_are_said_and_those_that_jump_come_last():
    before = rows([H, H], energy_u=np.ones(2), peak_time=np.ones(2))
    after = rows([H, H], energy_u=np.array([1.0, 1.25]), peak_time=np.array([1.0, 4.0]))
    error = recheck(before, solving(after), TIERS)[0]
    assert error.largest == ("energy_u", "peak_time")
    assert "energy_u 20 %, peak_time 75 % (jumps" in str(error)


def test_the_peak_of_a_run_far_outside_is_compared_with_itself():
    peaks = np.array([0.25, 4e6]), np.array([0.5, 3e6])
    before, after = (rows([H, V], peak_ratio=peak) for peak in peaks)
    assert recheck(before, solving(after), TIERS)[0].peak_ratio == 0.25


def test_the_numbers_of_a_run_whose_verdict_changed_are_not_compared():
    after = rows([H, V], peak_ratio=np.array([0.5, 1.0]))
    error = recheck(rows([H, H]), solving(after), TIERS)[0]
    assert (error.changed, error.peak_ratio) == (1, 0.0)


def test_a_solve_that_fails_changes_no_verdict_and_is_said():
    found = conclude(rows([H] * 10), rows([H] * 7 + [U] * 3))
    error = found.numerical_error
    assert (error.checked, error.changed, error.unchecked) == (7, 0, 3)
    assert found.verdict == qj.Verdict.HELD
    assert (found.claims[0].low, found.claims[0].high) == pytest.approx(exact(0, 0, 10))
    assert "3 of 10 runs could not be checked" in found.conclusion()


def test_nothing_that_could_be_checked_has_no_error():
    error = conclude(rows([H] * 4), rows([U] * 4)).numerical_error
    assert (error.checked, error.unchecked) == (0, 4)
    assert math.isnan(error.peak_ratio)
    assert "not known" in str(error)


@pytest.mark.parametrize(("was", "now"), [(H, V), (V, H)], ids=["held turned violated", "violated turned held"])
def test_a_changed_verdict_leaves_its_claim_undecided_and_the_interval_wide(was, now):
    found = conclude(rows([was] + [H] * 99), rows([now] + [H] * 99))
    assert [claim.verdict for claim in found.claims] == [qj.Verdict.UNDECIDED] * 3
    assert found.verdict == qj.Verdict.UNDECIDED
    assert [claim.changed for claim in found.claims] == [1, 1, 1]
    assert (found.claims[0].low, found.claims[0].high) == pytest.approx(exact(0, 1, 100))
    assert "1 changed their verdict (funnel 1, reaching 1, tracking 1)" in found.conclusion()
    assert "method='other'" in found.conclusion()


def test_only_the_claim_that_changed_is_in_doubt():
    after = rows([H] * 20, verdict_tracking=np.array([V] + [H] * 19))
    found = conclude(rows([H] * 20), after)
    assert [claim.verdict.name for claim in found.claims] == ["HELD", "HELD", "UNDECIDED"]
    assert found.verdict == qj.Verdict.UNDECIDED
    assert (found.claims[0].low, found.claims[0].high) == pytest.approx(exact(0, 0, 20))


def test_runs_that_were_not_tried_count_both_ways_once_one_changed():
    """Of 2000 runs 512 are a sample, and five more the worst: 516 are confirmed, 1484 not."""
    verdicts = np.full(2000, H)
    before = rows(verdicts, margin=np.linspace(0.1, 0.9, 2000))
    sample = Sample()
    sample.add(before)
    sampled = set(concatenate(sample.rows)["index"].tolist())
    tried = len(sampled | set(range(5)))
    verdicts = verdicts.copy()
    verdicts[max(sampled)] = V
    found = conclude(before, rows(verdicts, margin=before["margin"]))
    assert (found.numerical_error.checked, found.numerical_error.changed) == (tried, 1)
    assert (found.claims[0].low, found.claims[0].high) == pytest.approx(exact(0, 2000 - tried + 1, 2000))


def test_a_violation_that_was_confirmed_stands_beside_a_verdict_that_changed():
    found = conclude(rows([V, H] + [H] * 98), rows([V, V] + [H] * 98))
    assert found.verdict == found.claims[0].verdict == qj.Verdict.VIOLATED
    assert (found.claims[0].low, found.claims[0].high) == pytest.approx(exact(1, 1, 100))
    assert "1 changed their verdict" in found.conclusion()


def test_the_verdict_is_that_of_the_claims():
    """HELD only if every claim is, VIOLATED by one; whatever the check found."""
    for was in (H, V, U):
        for now in (H, V, U):
            found = conclude(rows([was, H]), rows([now, H]))
            verdicts = {claim.verdict for claim in found.claims}
            expected = qj.Verdict.VIOLATED if qj.Verdict.VIOLATED in verdicts else qj.Verdict.UNDECIDED
            assert found.verdict == (qj.Verdict.HELD if verdicts == {qj.Verdict.HELD} else expected)


COUNTS = {
    "all held": ((9, 0, 0), (0, 0), "HELD"),
    "one undecided": ((8, 0, 1), (0, 0), "UNDECIDED"),
    "one violated": ((8, 1, 0), (0, 1), "VIOLATED"),
    "violated beside undecided": ((7, 1, 1), (0, 0), "VIOLATED"),
    "one changed": ((9, 0, 0), (1, 0), "UNDECIDED"),
    "violated, but not confirmed": ((8, 1, 0), (1, 0), "UNDECIDED"),
    "violated and confirmed": ((7, 2, 0), (1, 1), "VIOLATED"),
    "none admitted": ((0, 0, 0), (0, 0), "INADMISSIBLE"),
}


@pytest.mark.parametrize(("counts", "check", "verdict"), COUNTS.values(), ids=COUNTS)
def test_a_claim_is_held_only_if_every_admitted_run_held_and_nothing_changed(counts, check, verdict):
    counted = dict(zip(("held", "violated", "undecided"), counts, strict=True))
    claim = Claim("funnel", "", *check, **counted, inadmissible=5, low=0.0, high=1.0)
    assert claim.verdict.name == verdict


def test_a_stopping_rule_that_the_check_doubts_says_so():
    rule = UntilBelow(0.1)
    before = rows([H] * 100)
    decision = decision_of(rule, before.counts(), 0.95)
    sure, doubted = (
        conclude(before, after, is_anytime=True, decision=decision) for after in (before, rows([V] + [H] * 99))
    )
    assert sure.decision == decision
    assert doubted.decision == f"{decision}, by verdicts that the check doubts"
    assert doubted.claims[0].high > 0.05


def test_the_command_that_shows_a_run_has_the_settings_that_decided_it(capsys):
    before = rows([H, V, H], tier=np.array([0, 1, 2]))
    _tell(conclude(before, before), Path("study.py"), ["qsmc", "simulate", "study.py", "--index"], None, {}, False)
    shown = [line.partition("--index ")[2] for line in capsys.readouterr().out.splitlines() if "--index" in line]
    assert sorted(shown) == ["0", "1 --rtol 1e-08", "2 --rtol 1e-08 --max-steps 1000000 --method other"]


def test_the_command_verifies_all_runs_by_the_solve_that_disagrees(capsys):
    found = conclude(rows([H] * 3), rows([V, H, H]))
    _tell(found, Path("my study.py"), ["qsmc", "show", "run", "--run"], Path("run"), {}, False)
    printed = capsys.readouterr().out
    assert (
        "qsmc verify 'my study.py' --runs 3 --seed 0 --confidence 0.95 --rtol 1e-08 --max-steps 1000000 --method other"
        " --out run-firmer"
    ) in " ".join(printed.split())


def test_the_summary_is_plain():
    summary = conclude(rows([H] * 3), rows([V, H, H])).summary()
    assert summary["numerical_error"]["metrics"]["peak_ratio"] == {"absolute": 0.0, "relative": 0.0}
    assert summary["firmer"] == {"rtol": pytest.approx(1e-8), "max_steps": 1_000_000, "method": "other"}
    assert summary["claims"][0]["changed"] == 1


def test_the_settings_of_a_row_are_those_that_decided_it():
    found = conclude(rows([H] * 3), rows([H] * 3))
    for tier in range(3):
        assert found.settings_of({"tier": tier}).choices == TIERS.settings[tier].choices
    assert dataclasses.asdict(found.claims[0])["confirmed"] == 0

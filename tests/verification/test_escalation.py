"""Escalation, rule by rule. Truth: the rules themselves, with solves whose answers are written down by hand."""

import itertools

import numpy as np
import pytest

import qsmc_jax as qj
from coin_study import study as coin
from qsmc_jax.simulation.stiffness import method_for
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.tuning.certificate import certify
from qsmc_jax.tuning.objectives import parse_constraint, parse_objective
from qsmc_jax.verification.escalation import Escalation, breaches_bound
from qsmc_jax.verification.resolve import through
from qsmc_jax.verification.tiers import Tiers

VERDICTS = ("verdict", "verdict_reaching", "verdict_tracking")

SETTINGS = tuple(qj.SolverSettings(rtol=10.0**-k) for k in (4, 5, 6, 7))
TIERS = Tiers(SETTINGS, is_sampled=False)
CODES = {"H": 0, "V": 1, "U": 2, "I": 3}

# What tiers 0, 1 and 2 say of the funnel, what is decided, and the tier whose metrics the row has; "." is not asked.
RULES = {
    "H..": ("H", 0),
    "I..": ("I", 0),
    "VV.": ("V", 1),
    "VHV": ("V", 2),
    "VHH": ("H", 2),
    "VHU": ("U", None),
    "VUV": ("V", 2),
    "VUH": ("U", None),
    "VUU": ("U", 2),
    "UVV": ("V", 2),
    "UVH": ("U", None),
    "UVU": ("U", 2),
    "UH.": ("H", 1),
    "UI.": ("I", 1),
    "UUV": ("U", 1),
    "UUH": ("H", 2),
    "UUU": ("U", 2),
}


def table(index, tier, verdicts, **columns):
    """Rows of some runs as one tier gives them; `verdicts` is one text a claim, a letter a row."""
    index = np.asarray(index)
    claims = {
        claim: np.array([CODES[letter] for letter in text]) for claim, text in zip(VERDICTS, verdicts, strict=True)
    }
    about = {
        "outcome": np.where(claims["verdict"] == 2, int(qj.Outcome.MAX_STEPS), 0),
        "peak_ratio": np.full(len(index), (tier + 1) / 10.0),
        "peak_u": np.ones(len(index)),
        "peak_u_bound": np.full(len(index), 2.0),
        "least_gain": np.full(len(index), 0.5),
        "end_time": np.full(len(index), 4.0),
        "steps": np.full(len(index), 100),
    }
    return Runs({"index": index, "mass": index / 7.0, **claims, **about, **columns}, ("mass",))


class Solves:
    """Stands for `stream`: run i is solved on tier k with the verdicts `claims[c][i][k]`, and with given peaks."""

    def __init__(self, claims, peaks=None):
        self.claims, self.peaks, self.asked = claims, peaks or {}, []

    def __call__(self, indices, settings, block=512):
        tier = next(k for k, each in enumerate(SETTINGS) if each is settings)
        self.asked.append((tier, sorted(int(i) for i in indices)))
        yield self.rows(indices, tier)

    def rows(self, indices, tier):
        verdicts = ["".join(claim[i][tier] for i in indices) for claim in self.claims]
        peaks = np.array([self.peaks.get(int(i), (1.0,) * 4)[tier] for i in indices])
        return table(indices, tier, verdicts, peak_u=peaks)


def decide(funnel, reaching=None, tracking=None, peaks=None, *, parts=None, block=512):
    """The decided rows in order, the escalation, and the solves that it asked for."""
    solves = Solves((funnel, reaching or funnel, tracking or funnel), peaks)
    escalation = Escalation(solves, TIERS, block)
    parts = parts or [range(len(funnel))]
    rows = concatenate(list(through(escalation, (solves.rows(np.array(part), 0) for part in parts))))
    return rows.take(rows["index"].argsort()), escalation, solves


@pytest.mark.parametrize(("says", "decided"), RULES.items(), ids=RULES)
def test_what_three_solves_decide_together(says, decided):
    rows, escalation, solves = decide([says])
    verdict, tier = decided
    assert [int(rows[claim][0]) for claim in VERDICTS] == [CODES[verdict]] * 3
    assert [k for k, _ in solves.asked] == [k for k in (1, 2) if says[k] != "."]
    assert escalation.escalated == [int(says[k] != ".") for k in (1, 2)]
    if tier is None:
        assert rows["outcome"][0] == qj.Outcome.SOLVES_DISAGREE
        assert np.isnan(rows["peak_ratio"][0])
    else:
        assert rows["outcome"][0] != qj.Outcome.SOLVES_DISAGREE
        assert (rows["peak_ratio"][0], rows["tier"][0]) == ((tier + 1) / 10.0, tier)


def test_every_triple_of_verdicts_keeps_the_law():
    """Whatever three solves say: nothing is decided against a solve but by two of which one is tier 2."""
    triples = ["".join(triple) for triple in itertools.product("HVUI", repeat=3)]
    rows, _, solves = decide(triples)
    second = next(indices for tier, indices in solves.asked if tier == 2)
    for i, says in enumerate(triples):
        heard = says[: 3 if i in second else 2 if says[0] in "UV" else 1]
        verdict = "HVUI"[rows["verdict"][i]]
        others = set(heard) - {verdict, "U"}
        if verdict != "U" and others:
            assert len(heard) == 3, says
            assert heard[2] == verdict in heard[:2], says
        if verdict == "V":
            assert heard.count("V") >= 2, says
        assert verdict in {*heard, "U"}, says


def test_rows_do_not_depend_on_tables_and_blocks():
    says = [each.replace(".", "U") for each in RULES] * 5
    whole, *_ = decide(says)
    order = np.random.default_rng(0).permutation(len(says))
    for block in (1, 7, 64):
        rows, *_ = decide(says, parts=np.array_split(order, 9), block=block)
        assert list(rows) == list(whole)
        for name in whole:
            np.testing.assert_array_equal(rows[name], whole[name], err_msg=name)


def test_only_open_runs_are_solved_again():
    _, escalation, solves = decide(["H..", "VV.", "VHV", "I..", "UH.", "UUU"])
    assert solves.asked == [(1, [1, 2, 4, 5]), (2, [2, 5])]
    assert escalation.escalated == [4, 2]


def test_a_claim_in_conflict_is_undecided_alone():
    rows, _, solves = decide(["HHH"], reaching=["VHU"], tracking=["HHH"])
    assert [int(rows[claim][0]) for claim in VERDICTS] == [0, 2, 0]
    assert [tier for tier, _ in solves.asked] == [1, 2]
    assert np.isfinite(rows["peak_ratio"][0])


def test_two_solves_by_one_method_do_not_outvote_another_method():
    rows, *_ = decide(["VHV"] * 3, reaching=["HHV", "VVH", "VHV"], tracking=["VUV"] * 3)
    assert rows["verdict"].tolist() == [1, 1, 1]
    assert rows["verdict_reaching"].tolist() == [2, 2, 1]
    assert rows["verdict_tracking"].tolist() == [1, 1, 1]


def test_the_metrics_are_of_the_last_solve_that_says_what_was_decided_of_the_funnel():
    rows, *_ = decide(["HHU"], reaching=["VHU"], tracking=["HHU"])
    assert [int(rows[claim][0]) for claim in VERDICTS] == [0, 2, 0]
    assert rows["tier"][0] == 1


def test_a_single_violated_later_claim_does_not_confirm_itself():
    rows, *_ = decide(["HHH"], reaching=["VUU"], tracking=["VVU"])
    assert [int(rows[claim][0]) for claim in VERDICTS] == [0, 2, 1]


def test_a_funnel_in_conflict_leaves_nothing_decided():
    rows, *_ = decide(["VHU"], reaching=["VVV"], tracking=["HHH"])
    assert [int(rows[claim][0]) for claim in VERDICTS] == [2, 2, 2]


def test_a_horizon_too_short_for_the_later_claims_is_no_doubt():
    rows, escalation, _ = decide(["H.."], reaching=["U.."], tracking=["U.."])
    assert escalation.escalated == [0, 0]
    assert [int(rows[claim][0]) for claim in VERDICTS] == [0, 2, 2]


def test_a_disputed_run_keeps_its_draws_and_no_metric():
    rows, *_ = decide(["H..", "VHU"])
    assert rows.row(1)["mass"] == 1 / 7.0
    assert rows.row(1)["least_gain"] == 0.5
    assert np.isnan([rows.row(1)[name] for name in ("peak_ratio", "peak_u", "peak_u_bound")]).all()
    assert rows.row(0)["peak_u"] == 1.0


def test_a_peak_above_the_comparison_bound_says_nothing():
    peaks = {0: (3.0, 3.0, 3.0), 1: (3.0, 1.0, 1.0), 2: (3.0, 3.0, 1.0)}
    rows, escalation, solves = decide(["HHH"] * 3, peaks=peaks)
    assert rows["verdict"].tolist() == [CODES["U"], CODES["H"], CODES["H"]]
    assert escalation.defects == [0]
    assert solves.asked == [(1, [0, 1, 2]), (2, [0, 2])]
    assert rows["peak_u"].tolist() == [3.0, 1.0, 1.0]


def test_a_peak_is_a_breach_only_one_percent_beyond_the_bound_and_where_the_bound_holds():
    peaks, gains = [1.99, 2.019, 2.021, 3.0, 3.0, 3.0], [0.5, 0.5, 0.5, 0.5, -0.1, 0.0]
    rows = table(range(6), 0, ["HHHVHH"] * 3, peak_u=np.array(peaks), least_gain=np.array(gains))
    assert breaches_bound(rows).tolist() == [False, False, True, False, False, False]


def families(settings):
    """What a method shares steps with: explicit or implicit, for a loop that is not stiff and for one that is."""
    return [method_for(stiffness, stiffness, settings.method) == "tsit5" for stiffness in (1.0, 1e9)]


@pytest.mark.parametrize("method", ["auto", "other", "tsit5", "rodas4", "rodas5p"])
def test_tier_2_and_every_check_have_another_method(method):
    tiers = Tiers.of(coin, qj.SolverSettings(method=method, max_steps=1000))
    first, second, third, fourth = tiers.settings
    assert first.method == second.method == method
    assert [own != other for own, other in zip(families(first), families(third), strict=True)] == [True, True]
    assert third.max_steps == 10_000
    for decided in range(3):
        check = tiers.settings[tiers.check_of(decided)]
        for stiffness in (1.0, 1e9):
            methods = {method_for(stiffness, stiffness, each.method) for each in (check, tiers.settings[decided])}
            assert len(methods) == 2
        assert float(check.rtol) <= float(tiers.settings[decided].rtol)
        assert float(check.rtol) == pytest.approx(1e-8)
    assert fourth.method == "rodas4"


def test_every_solve_of_a_sampled_loop_is_firmer_than_the_one_before():
    def scenario(draw):
        loop = qj.paper.example1()
        loop = qj.ClosedLoop(loop.plant, loop.reference, loop.disturbance, loop.control, qj.Implementation(0.01))
        return qj.Scenario(loop, x0=[draw.uniform("x", 0.1, 0.9), 0.0], t1=1.0)

    tiers = Tiers.of(qj.Study(scenario, bandwidth=0.1), qj.SolverSettings())
    tolerances = [float(each.rtol) for each in tiers.settings]
    assert tolerances == pytest.approx([1e-6, 1e-8, 1e-10, 1e-12])
    assert [tiers.check_of(tier) for tier in range(3)] == [1, 2, 3]
    assert {each.method for each in tiers.settings} == {"auto"}
    # The check of most runs is the program that solved them: nothing is compiled for it.
    assert "block" not in tiers.options(1)


def disputing(study, indices, seed, *, settings, block, threads, progress=None):
    """Stands for `stream`: every run is violated, then held, and then not decided."""
    tiers = Tiers.of(study, qj.SolverSettings()).settings
    tier = next(k for k, each in enumerate(tiers) if (each.choices, each.rtol) == (settings.choices, settings.rtol))
    count = len(indices)
    known = {"margin": 0.5, "energy_u": 3.0, "violation_time": np.inf, "end_time": 1.0}
    metrics = {name: np.full(count, value) for name, value in known.items()}
    yield table(indices, tier, ["VHU"[tier] * count] * 3, **metrics)


def counted_by_certify():
    options = {"runs": 64, "seed": 1, "risk": 0.1, "confidence": 0.9, "settings": qj.SolverSettings(), "block": 64}
    objective, constraint = parse_objective("mean(energy_u)"), parse_constraint("worst(peak_u) <= 5")
    found = certify(coin, [({}, 0.0)], objective, (constraint,), **options, threads=1, progress=None)
    return [(each.violated, each.undecided) for each in found[0].guarantees]


def counted_by_map():
    funnel = qj.robustness_map(coin, {"p": [0.1, 0.2]}, runs=64, block=64).funnel
    return list(zip(funnel.violated.tolist(), funnel.undecided.tolist(), strict=True))


COUNTS = {
    "map": counted_by_map,
    "compare": lambda: [(s.violated, s.undecided) for s in qj.compare({"a": coin, "b": coin}, 64, block=64).studies],
    "critical": lambda: [
        (test.violated, test.undecided - test.runs + 64) for test in qj.critical_value(coin, "p", 0.4, block=64).tests
    ],
    "certificate": counted_by_certify,
}


@pytest.mark.parametrize("count", COUNTS.values(), ids=COUNTS)
def test_whoever_counts_verdicts_counts_a_disputed_run_as_undecided(count, monkeypatch):
    monkeypatch.setattr("qsmc_jax.verification.resolve.stream", disputing)
    assert count() == [(0, 64), (0, 64)]

"""Certificates by hand: which single runs fail a bound, how they are counted, and when a certificate is granted.

Truth: tables of rows written down with what is to be said of each, and SciPy's Clopper-Pearson intervals.
"""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import binomtest

import problems
import qsmc_jax as qj
from qsmc_jax.tuning import certificate
from qsmc_jax.tuning.certificate import Guarantee, certify, confidence_of, judge
from qsmc_jax.tuning.objectives import parse_constraint, parse_objective

HELD, VIOLATED, UNDECIDED, INADMISSIBLE = qj.Verdict
KEPT, FAILED, OPEN = "kept", "failed", "undecided"
NAN, INF = np.nan, np.inf


def row(verdict, outcome, **metrics):
    unknown = dict.fromkeys(("peak_ratio", "margin", "peak_u", "rms_error", "violation_time"), NAN)
    return {"verdict": int(verdict), "outcome": int(outcome), "end_time": 2.0, **unknown, **metrics}


# As the simulator writes them.
ROWS = {
    "held": row(HELD, qj.Outcome.COMPLETED, peak_ratio=0.8, margin=0.2, peak_u=3.0, rms_error=0.1),
    "held, of no known error": row(HELD, qj.Outcome.COMPLETED, peak_ratio=0.8, margin=0.2, peak_u=3.0),
    "left": row(VIOLATED, qj.Outcome.LEFT_FUNNEL, peak_ratio=1.0, margin=0.0, peak_u=INF, violation_time=0.5),
    "left and came back": row(
        VIOLATED, qj.Outcome.COMPLETED, peak_ratio=1.2, margin=-0.2, peak_u=3.0, rms_error=0.1, violation_time=0.5
    ),
    "left by less than a digit": row(
        VIOLATED, qj.Outcome.COMPLETED, peak_ratio=1.0, margin=0.0, peak_u=3.0, rms_error=0.1, violation_time=0.5
    ),
    "lost": row(VIOLATED, qj.Outcome.LOST, peak_ratio=1e3, margin=-999.0, peak_u=3.0, violation_time=0.5),
    "gave up after leaving": row(VIOLATED, qj.Outcome.MAX_STEPS, violation_time=0.5),
    "gave up": row(UNDECIDED, qj.Outcome.MAX_STEPS),
    "above what theory allows": row(
        UNDECIDED, qj.Outcome.COMPLETED, peak_ratio=0.8, margin=0.2, peak_u=3.0, rms_error=0.1
    ),
    "not admissible": row(INADMISSIBLE, qj.Outcome.STARTED_OUTSIDE),
}
SAID = {
    "worst(peak_ratio) <= 1": [KEPT, KEPT, FAILED, FAILED, FAILED, FAILED, FAILED, OPEN, OPEN, FAILED],
    "violation <= 0.01": [KEPT, KEPT, FAILED, FAILED, FAILED, FAILED, FAILED, OPEN, OPEN, FAILED],
    "worst(peak_ratio) <= 0.7": [FAILED, FAILED, FAILED, FAILED, FAILED, FAILED, FAILED, OPEN, OPEN, FAILED],
    # A loop that may leave: only what was seen to its end is known.
    "worst(peak_ratio) <= 2": [KEPT, KEPT, FAILED, KEPT, KEPT, FAILED, FAILED, OPEN, OPEN, FAILED],
    "least(margin) >= 0": [KEPT, KEPT, FAILED, FAILED, FAILED, FAILED, FAILED, OPEN, OPEN, FAILED],
    "least(margin) >= 0.5": [FAILED, FAILED, FAILED, FAILED, FAILED, FAILED, FAILED, OPEN, OPEN, FAILED],
    "worst(peak_u) <= 20": [KEPT, KEPT, FAILED, KEPT, KEPT, FAILED, FAILED, OPEN, OPEN, FAILED],
    "worst(rms_error) <= 0.2": [KEPT, OPEN, FAILED, KEPT, KEPT, FAILED, FAILED, OPEN, OPEN, FAILED],
    "worst(rms_error) <= 0.05": [FAILED, OPEN, FAILED, FAILED, FAILED, FAILED, FAILED, OPEN, OPEN, FAILED],
}


def columns(names):
    rows = [ROWS[name] for name in names]
    return {key: np.array([each[key] for each in rows]) for key in rows[0]}


@pytest.mark.parametrize("text", SAID)
def test_a_run_keeps_a_bound_only_if_its_metric_is_known_to(text):
    failed, undecided = judge(parse_constraint(text), columns(ROWS))
    said = [FAILED if f else OPEN if u else KEPT for f, u in zip(failed, undecided, strict=True)]
    assert dict(zip(ROWS, said, strict=True)) == dict(zip(ROWS, SAID[text], strict=True))
    assert not np.any(failed & undecided)


def scenario(draw):
    control = qj.QuasiSlidingControl(
        qj.SlidingSurface([]), qj.Funnel(2.0, draw.parameter("mu", 1.0, bounds=(0.5, 9.0)), 0.1)
    )
    loop = qj.ClosedLoop(problems.chain(1)(), qj.references.Constant(0.0), qj.disturbances.Zero(), control)
    return qj.Scenario(loop, x0=jnp.atleast_1d(draw.uniform("x0", 0.4, 1.0)), t1=2.0)


STUDY = qj.Study(scenario, bandwidth=0.5)


def certified(monkeypatch, names, constraints, candidates=1, **options):
    """The certificates of so many candidates whose fresh runs are the given rows."""
    table = qj.Runs({"index": np.arange(len(names)), **columns(names)}, ())
    monkeypatch.setattr(certificate, "decide", lambda *_, **__: iter([table]))
    asked = {"runs": len(names), "seed": 1, "risk": 0.05, "confidence": 0.95, "settings": qj.SolverSettings()}
    solving = {"block": 64, "threads": 1, "progress": None}
    trained = [({"mu": 1.0 + i}, 0.1) for i in range(candidates)]
    objective = parse_objective("mean(rms_error)")
    return certify(
        STUDY, trained, objective, tuple(map(parse_constraint, constraints)), **{**asked, **solving, **options}
    )


def test_statements_agree_with_the_funnel_where_every_run_has_left(monkeypatch):
    constraints = ["violation <= 0.01", "worst(peak_u) <= 20", "least(margin) >= -1", "worst(rms_error) <= 1"]
    (made,) = certified(monkeypatch, ["left"] * 512, constraints)
    assert [each.violated for each in made.guarantees] == [512] * 5
    assert "false in 0" not in str(made)
    assert not made.is_granted


@pytest.mark.parametrize("candidates", [1, 3])
@pytest.mark.parametrize("constraints", [[], ["worst(peak_u) <= 20", "violation <= 0.01"]], ids=["funnel", "three"])
def test_intervals_share_the_risk_among_candidates_and_statements(monkeypatch, candidates, constraints):
    names = ["held"] * 190 + ["left"] * 4 + ["gave up"] * 3 + ["not admissible"] * 2
    made = certified(monkeypatch, names, constraints, candidates)
    each = 1.0 - 0.05 / (candidates * (1 + len(constraints)))
    low = binomtest(6, 199).proportion_ci(each, method="exact").low
    high = binomtest(9, 199).proportion_ci(each, method="exact").high
    assert len(made) == candidates
    for guarantee in (guarantee for one in made for guarantee in one.guarantees):
        assert (guarantee.violated, guarantee.undecided, guarantee.total) == (6, 3, 199)
        assert (guarantee.low, guarantee.high) == pytest.approx((low, high), rel=1e-7)


def test_it_is_granted_by_the_upper_end_alone(monkeypatch):
    names, each = ["held"] * 298 + ["left"] * 2, 0.95
    interval = binomtest(2, 300).proportion_ci(each, method="exact")
    for risk, is_granted in ((1.01 * interval.high, True), (0.99 * interval.high, False), (interval.low, False)):
        (made,) = certified(monkeypatch, names, [], risk=float(risk))
        assert made.is_granted == is_granted


def test_every_statement_must_be_shown():
    counts = {"held": 100, "violated": 0, "undecided": 0, "inadmissible": 0, "low": 0.0}
    good, bad = (Guarantee("said", **counts, high=high) for high in (0.04, 0.06))
    made = qj.Certificate({"mu": 1.0}, 1, 100, 0.05, 0.95, (good, good), 1.0, 1.0)
    assert made.is_granted
    for guarantees in ((good, bad), (bad, good)):
        assert not dataclasses.replace(made, guarantees=guarantees).is_granted


@pytest.mark.parametrize(
    ("names", "expected"),
    [
        (["held"] * 5, 0.1),
        (["held", "left and came back"], 0.1),
        (["held", "not admissible"], 0.1),
        (["held", "left"], INF),
        (["held", "lost"], INF),
        (["held", "gave up"], INF),
        (["held", "above what theory allows"], INF),
        (["held", "held, of no known error"], INF),
        (["not admissible"] * 2, INF),
    ],
    ids=str,
)
def test_the_objective_on_fresh_runs_is_known_only_if_every_admissible_run_has_it(monkeypatch, names, expected):
    (made,) = certified(monkeypatch, names, [])
    assert made.objective == pytest.approx(expected)


def test_designs_share_the_risk_and_no_more():
    shares = [1.0 - confidence_of(attempt, 0.95) for attempt in range(100_000)]
    assert sum(shares) == pytest.approx(0.05, rel=1e-5)
    assert sum(shares) < 0.05

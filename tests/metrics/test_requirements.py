"""Requirements of one's own: margins against SciPy, verdicts against closed forms, and everywhere they should show."""

import dataclasses
import math
import re
import sys

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import problems
import qsmc_jax as qj
from falling_funnel import falling
from qsmc_jax.metrics.metric import Extent
from qsmc_jax.metrics.requirements import Highest, Margin
from scipy_loops import MU, RHO_INF, T1, rate, rho0, sigma, start, surface
from studies_for_tests import Integrator

HELD, VIOLATED, UNDECIDED, INADMISSIBLE = qj.Verdict
GRID = np.linspace(0.0, T1, 200_001)


def scipys(n):
    """State, input and first error of the loops of `scipy_loops` on a fine grid."""
    options = {"rtol": 1e-11, "atol": 1e-13, "max_step": 0.01, "t_eval": GRID}
    x = scipy.integrate.solve_ivp(rate, (0.0, T1), start(n), "Radau", args=(1.0,), **options).y
    ratio = np.array([sigma(t, at) for t, at in zip(GRID, x.T, strict=True)]) / (rho0(n) * np.exp(-MU * GRID) + RHO_INF)
    return x, -np.tan(0.5 * math.pi * ratio), x[0] - np.sin(GRID)


def loops(n):
    plant = problems.chain(n)(1.0, 2.0, 1.0 / 3.0, 0.5)
    control = qj.QuasiSlidingControl(qj.SlidingSurface(surface(n)[:-1]), qj.Funnel(rho0(n), MU, RHO_INF))
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Sine(0.5, 3.0), control)
    return lambda draw: qj.Scenario(loop, x0=start(n), t1=T1)


# Names out of their order in the alphabet, as users have them.
LIMIT = qj.always(lambda s: 9.0 - jnp.abs(s.u))
CLOSE = qj.always(lambda s: 0.8 - jnp.abs(s.e[0]), after=0.4, before=1.7)
NEAR = qj.eventually(lambda s: -jnp.abs(s.x[0] - 0.35), before=1.3)
REQUIREMENTS = {
    "limit": LIMIT,
    "close": CLOSE,
    "approach": NEAR,
    "both": LIMIT & CLOSE,
    "any": CLOSE | NEAR,
    "avoid": ~NEAR,
    "follow": LIMIT.implies(NEAR),
    "between": ~(~LIMIT | ~CLOSE) & NEAR.implies(CLOSE),
}


@pytest.mark.parametrize("n", [2, pytest.param(4, marks=pytest.mark.slow)])
def test_margins_agree_with_scipy(n):
    x, u, e = scipys(n)
    middle, early = (GRID >= 0.4) & (GRID <= 1.7), GRID <= 1.3
    limit, close = 9.0 - abs(u).max(), 0.8 - abs(e)[middle].max()
    near = -abs(x[0] - 0.35)[early].min()
    expected = {
        "limit": limit,
        "close": close,
        "approach": near,
        "both": min(limit, close),
        "any": max(close, near),
        "avoid": -near,
        "follow": max(-limit, near),
        "between": min(limit, close, max(-near, close)),
    }
    runs = qj.monte_carlo(qj.Study(loops(n), bandwidth=0.2, requirements=REQUIREMENTS), 1)
    margins = {name: runs[f"margin_{name}"][0] for name in REQUIREMENTS}
    assert margins == pytest.approx(expected, abs=1e-5)
    for name, margin in expected.items():
        sure = HELD if margin > 1e-3 else VIOLATED if margin < -1e-3 else UNDECIDED
        assert runs[f"verdict_{name}"][0] == sure, name


JOINED = {"and": np.minimum, "or": np.maximum, "implies": lambda a, b: np.maximum(-a, b), "not": lambda a, _: -a}


@pytest.mark.parametrize("seed", range(12))
def test_any_formula_means_what_it_says(seed):
    """Random formulas over parts whose margins are known, as temporal logic defines them."""
    rng = np.random.default_rng(seed)
    margins = {}

    def formula(depth):
        if depth == 0:
            level, kind = float(rng.normal()), str(rng.choice(["always", "eventually"]))
            part = getattr(qj, kind)(lambda s: s.x[0] - level, after=float(rng.uniform()), unit="m")
            margins[part] = level
            return part, level
        (a, of_a), (b, of_b) = formula(depth - 1), formula(depth - 1)
        how = str(rng.choice(list(JOINED)))
        return {"and": a & b, "or": a | b, "implies": a.implies(b), "not": ~a}[how], JOINED[how](of_a, of_b)

    made, expected = formula(3)
    apart = {part: Margin(margin - 0.1, margin, margin + 0.2) for part, margin in margins.items()}
    low, found, high = map(float, made.margin(apart))
    assert found == pytest.approx(expected, abs=1e-12)
    assert 0.1 - 1e-12 <= found - low <= 0.2 + 1e-12
    assert 0.1 - 1e-12 <= high - found <= 0.2 + 1e-12


def verdicts(requirements, scenario=falling, runs=2, **options):
    study = qj.Study(scenario, bandwidth=0.3, requirements=requirements)
    table = qj.monte_carlo(study, runs, **options)
    return {name: {qj.Verdict(int(each)) for each in table[f"verdict_{name}"]} for name in requirements}


def test_windows_end_exactly_where_something_jumps():
    """Up to the jump there is no disturbance, from it on there is."""
    calm, shaken = (lambda s: 0.2 - s.d), (lambda s: s.d - 0.2)
    assert verdicts(
        {
            "before": qj.always(calm, before=1.0),
            "across": qj.always(calm, before=1.0 + 1e-9),
            "from": qj.always(shaken, after=1.0),
            "not_yet": qj.eventually(shaken, before=1.0),
            "then": qj.eventually(shaken, before=1.0 + 1e-9),
            "until": qj.always(calm, after=0.5, before=1.0) & qj.always(shaken, after=1.0, before=1.5),
        }
    ) == {
        "before": {HELD},
        "across": {VIOLATED},
        "from": {HELD},
        "not_yet": {VIOLATED},
        "then": {HELD},
        "until": {HELD},
    }


def test_what_is_near_is_decided_by_firmer_solves_or_by_none():
    """rho falls from 1.1: one margin is a millionth or so above nothing, one below, and one is nothing."""
    lacks = {"above": 6e-6, "below": -6e-6, "tie": -1e-9}
    limits = {name: qj.always(lambda s, lack=lack: 1.1 + lack - s.rho) for name, lack in lacks.items()}
    assert verdicts(limits, runs=64, block=64) == dict.fromkeys(limits, {UNDECIDED})
    found = qj.verify(qj.Study(falling, bandwidth=0.3, requirements=limits), 64, block=64)
    assert [claim.verdict for claim in found.claims[3:]] == [HELD, VIOLATED, UNDECIDED]
    assert (found.claims[5].undecided, found.escalated) == (64, (64, 64))
    without = dataclasses.replace(found, claims=tuple(claim for claim in found.claims if claim.name != "below"))
    assert "64 runs undecided on tie" in without.conclusion()


def test_a_run_that_ends_early_decides_what_it_has_seen():
    """The wrong sign: x runs away from 0.5 and is out of the funnel, at 1.1 exp(-t) or so, within a second."""

    def leaving(draw):
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
        plant = Integrator(-2.0)
        loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Zero(), control)
        return qj.Scenario(loop, x0=[draw.uniform("x0", 0.5, 0.6)], t1=3.0)

    found = verdicts(
        {
            "small": qj.always(lambda s: 0.6 - s.x[0]),  # broken on the way out
            "positive": qj.always(lambda s: s.x[0]),  # nobody knows what comes
            "large": qj.eventually(lambda s: s.x[0] - 0.55),  # seen
            "back": qj.eventually(lambda s: 0.1 - s.x[0]),  # may still come
            "soon": qj.always(lambda s: s.x[0], before=0.01),  # its window was seen to the end
            "later": qj.always(lambda s: s.x[0], after=2.0),
            "one": qj.always(lambda s: s.x[0]) | qj.eventually(lambda s: s.x[0] - 0.55),
            "two": qj.always(lambda s: s.x[0]) & qj.always(lambda s: 0.6 - s.x[0]),
            "neither": ~qj.eventually(lambda s: s.x[0] - 0.55) | qj.always(lambda s: s.x[0]),
        },
        leaving,
    )
    open_ones = {"positive", "back", "later", "neither"}
    assert {name for name, said in found.items() if said == {UNDECIDED}} == open_ones
    assert {name for name, said in found.items() if said == {VIOLATED}} == {"small", "two"}
    assert {name for name, said in found.items() if said == {HELD}} == {"large", "soon", "one"}


def test_a_run_that_does_not_begin_or_lasts_too_short_says_nothing():
    limits = {"limit": qj.always(lambda s: 9.0 - s.u)}
    study = qj.Study(
        lambda draw: qj.Scenario(falling(draw).loop, x0=[0.3 + 1.5 * draw.uniform("far", 0.0, 1.0)], t1=2.0),
        bandwidth=0.3,
        requirements=limits,
    )
    table = qj.monte_carlo(study, 64)
    outside = table["far"] * 1.5 + 0.3 >= 1.1
    np.testing.assert_array_equal(table["verdict_limit"], np.where(outside, INADMISSIBLE, HELD))
    cut = verdicts(limits, settings=qj.SolverSettings(max_steps=3))
    assert cut == {"limit": {UNDECIDED}}


def test_all_claims_together_are_counted_apart():
    """x0 is uniform: either limit breaks in a fifth of the runs, both in none, and together they hold in three."""

    def scenario(draw):
        made = falling(draw)
        return qj.Scenario(made.loop, x0=[draw.uniform("start", 0.0, 1.0)], t1=2.0)

    at_start = {"after": 0.0, "before": 1e-6}
    low, high = qj.always(lambda s: s.x[0] - 0.2, **at_start), qj.always(lambda s: 0.8 - s.x[0], **at_start)
    study = qj.Study(scenario, bandwidth=0.3, requirements={"upper": high, "lower": low})
    found = qj.verify(study, 512, block=512)
    x0 = qj.monte_carlo(study, 512, block=512)["start"]
    claims = {claim.name: claim for claim in found.claims}
    assert list(claims) == ["funnel", "reaching", "tracking", "upper", "lower"]
    broken = {"upper": int((x0 > 0.8).sum()), "lower": int((x0 < 0.2).sum())}
    assert {name: claims[name].violated for name in broken} == broken
    assert found.together.violated == sum(broken.values())
    assert found.together.held == 512 - sum(broken.values())
    assert found.verdict == VIOLATED
    assert claims["funnel"].verdict == HELD
    assert f"{broken['upper']} violated upper, {broken['lower']} violated lower" in found.conclusion()
    assert found.worst["verdict_upper"][0] == VIOLATED or found.worst["verdict_lower"][0] == VIOLATED


def test_a_run_that_is_lost_has_the_least_margin_in_the_median_of_a_map():
    """With the wrong sign in two runs of three x runs away, and nobody knows whether it stays positive."""

    def scenario(draw):
        p = draw.parameter("p", 0.0, bounds=(0.0, 1.0))
        sign = jnp.where(draw.uniform("coin", 0.0, 1.0) < p, -1.0, 1.0)
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.1))
        loop = qj.ClosedLoop(Integrator(2.0 * sign), qj.references.Constant(0.0), qj.disturbances.Zero(), control)
        return qj.Scenario(loop, x0=[draw.uniform("x0", 0.5, 0.6)], t1=3.0)

    positive = {"positive": qj.always(lambda s: s.x[0] + 1.0)}
    study = qj.Study(scenario, bandwidth=0.3, requirements=positive)
    found = qj.robustness_map(study, over={"p": [0.0, 0.66]}, runs=64, block=64)
    assert found.claims["positive"].undecided.tolist()[0] == 0
    assert found.claims["positive"].undecided.tolist()[1] > 32
    assert found.medians["margin_positive"].tolist() == [pytest.approx(1.0, abs=1e-3), -math.inf]


def test_a_sampled_loop_is_judged_too():
    def held(draw):
        made = qj.Implementation(sample_period=draw.uniform("period", 5e-3, 2e-2), saturation=0.5)
        loop = eqx.tree_at(
            lambda each: each.implementation, qj.paper.example1(), made, is_leaf=lambda leaf: leaf is None
        )
        return qj.Scenario(loop, [0.4, 0.3], t1=3.0)

    limits = {
        "below": qj.always(lambda s: 0.5001 - jnp.abs(s.u)),
        "beyond": qj.always(lambda s: 0.4 - jnp.abs(s.u)),
        "close": qj.always(lambda s: 0.50002 - jnp.abs(s.u)),
    }
    study = qj.Study(held, bandwidth=0.1, requirements=limits)
    table = qj.monte_carlo(study, 16)
    saturated = table["peak_u"] >= 0.5
    assert saturated.any()
    np.testing.assert_allclose(table["margin_beyond"], 0.4 - table["peak_u"], atol=1e-12)
    assert set(table["verdict_below"]) == {HELD}
    assert (table["verdict_close"] == UNDECIDED)[saturated].all()
    np.testing.assert_array_equal(table["verdict_beyond"][saturated], VIOLATED)


@pytest.mark.parametrize(
    ("ended", "low", "high"),
    [(0.5, 0.99, math.inf), (1.0, 0.99, math.inf), (1.999, 0.99, math.inf), (2.0, 0.99, 1.26), (3.0, 0.99, 1.26)],
)
def test_what_is_known_of_a_margin(ended, low, high):
    """The highest found was 1.0, no more than 1.25 is possible, and the solve owes a hundredth of a unit."""
    (part,) = qj.eventually(lambda s: s.u, after=1.0, before=2.0).parts
    state = Highest(jnp.array(1.0), jnp.array(1.25), jnp.array(1.0))
    known = part.known(state, Extent(ended, 3.0, jnp.array(ended == 3.0), jnp.array(True), 0.01))
    assert (float(known.low), float(known.high)) == pytest.approx((low, high))
    assert math.isnan(float(known.value)) == math.isinf(high)


def test_nothing_is_known_of_a_window_without_a_step():
    extent = Extent(3.0, 3.0, jnp.array(True), jnp.array(True), 0.01)
    for make in (qj.eventually, qj.always):
        (part,) = make(lambda s: s.u, after=1.0, before=1.5).parts
        known = part.known(Highest(jnp.array(-jnp.inf), jnp.array(-jnp.inf), jnp.array(0.0)), extent)
        assert (float(known.low), float(known.high)) == (-math.inf, math.inf)


def test_a_window_may_be_as_long_as_the_longest_horizon_and_scenarios_may_fail():
    """Half of the runs of this scenario make no loop; the others last from 1 to 3 s."""

    def scenario(draw):
        t1 = 1.0 + 2.0 * draw.uniform("longer", 0.0, 1.0)
        mu = draw.uniform("mu", -1.0, 1.1)
        return qj.Scenario(falling(draw).loop, x0=[0.3], t1=jnp.where(mu > 0.0, t1, -1.0))

    limits = {"p": qj.always(lambda s: s.u, before=2.4)}
    assert qj.Study(scenario, bandwidth=0.3, requirements=limits).claims[-1] == "p"
    with pytest.raises(qj.InputError, match="must not lie beyond the horizon"):
        qj.Study(scenario, bandwidth=0.3, requirements={"p": qj.always(lambda s: s.u, before=3.1)})


def measured():
    """A study with a requirement and a metric that have units."""
    small = {"small": qj.always(lambda s: 0.6 - s.x[0], unit="m")}
    return qj.Study(falling, 0.3, metrics=[qj.metrics.Peak("p", lambda s: s.u, unit="N")], requirements=small)


def test_a_replay_agrees_only_in_every_claim(tmp_path):
    """The row of a verdict that another program wrote; and two campaigns that differ in a requirement alone."""
    study = measured()
    config = qj.campaign.CampaignConfig(study, source=b"study = ...", block=64)
    folder = qj.campaign.prepare(tmp_path / "run", config)
    qj.campaign.run_campaign(folder, config, runs=64)
    assert qj.campaign.replay(folder, config, index=3, worst=None).agrees
    assert qj.campaign.replay(folder, config, index=None, worst=1, of="small").agrees
    row = next(iter(folder.tables())).row(3)
    module = sys.modules[qj.campaign.replay.__module__]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(module, "_row", lambda *_: {**row, "verdict_small": int(VIOLATED)})
        assert not qj.campaign.replay(folder, config, index=3, worst=None).agrees
    other, rows = qj.campaign.RunFolder.open(folder.path), next(iter(folder.tables()))
    flipped = np.where(np.isin(rows["index"], [3, 9]), int(VIOLATED), rows["verdict_small"])
    with pytest.MonkeyPatch.context() as patch:
        changed = dataclasses.replace(rows, columns={**rows.columns, "verdict_small": flipped})
        patch.setattr(type(other), "tables", lambda self, *_: iter([changed if self is other else rows]))
        found = qj.campaign.difference(folder, other)
    assert (found.changed, found.changed_count) == ((3, 9), 2)
    assert [each["small"]["VIOLATED"] for each in found.verdicts] == [0, 2]
    assert re.search(r"small VIOLATED +0 +2\n", str(found))
    with pytest.raises(qj.InputError, match="Did you mean `small`"):
        qj.campaign.replay(folder, config, index=None, worst=1, of="smaller")
    with pytest.raises(qj.InputError, match="it needs `--worst`"):
        qj.campaign.replay(folder, config, index=3, worst=None, of="small")


@pytest.mark.slow
def test_units_stay_with_the_rows():
    pytest.importorskip("xarray")
    rows = qj.monte_carlo(measured(), 130, block=64).take(slice(3, 70)).to_xarray()
    units = {"margin_small": "m", "p": "N", "peak_time": "s", "x0": None}
    assert {name: rows[name].attrs.get("units") for name in units} == units

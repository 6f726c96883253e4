"""Failure honesty: a solve that can't tell says so, and a wrong call is told what is wrong with it."""

import dataclasses
import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import jaxtyping
import numpy as np
import pytest
from jaxtyping import Array, Float

import problems
import qsmc_jax as qj
from qsmc_jax.base.module import float_field

# All loops here share one program, of a plant of order 1.
SETTINGS = qj.SolverSettings(max_steps=2000, method="tsit5")
FUNNEL = qj.Funnel(rho0=1.0, mu=1.0, rho_inf=0.1)


class Troubled(qj.AbstractPlant):
    """f jumps by `height` at `jump`, which it does not announce, and is NaN from `end` on; g is constant."""

    jump: Float[Array, ""] = float_field(default=math.inf)
    height: Float[Array, ""] = float_field(default=0.0)
    end: Float[Array, ""] = float_field(default=math.inf)
    strength: Float[Array, ""] = float_field(default=1.0)
    order: ClassVar[int] = 1

    def drift(self, t, x):
        return jnp.where(t >= self.jump, self.height, 0.0) + jnp.where(t >= self.end, jnp.nan, 0.0)

    def gain(self, t, x):
        return self.strength

    @property
    def break_times(self):
        return [math.inf]


def simulate(x0=0.3, t1=5.0, funnel=FUNNEL, **plant):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel)
    loop = qj.ClosedLoop(Troubled(**plant), qj.references.Constant(0.0), qj.disturbances.Zero(), control)
    return qj.simulate(loop, [x0], t1, bandwidth=0.2, settings=SETTINGS)


def claims(run):
    f = run.metrics
    return [qj.Verdict(int(v)).name for v in (f.verdict, f.verdict_reaching, f.verdict_tracking)]


@pytest.fixture(scope="module")
def too_few_steps():
    """A loop a thousand times too stiff for its step limit."""
    return simulate(strength=1e6)


def test_too_few_steps_leave_every_claim_undecided(too_few_steps):
    assert too_few_steps.outcome == qj.Outcome.MAX_STEPS
    assert claims(too_few_steps) == ["UNDECIDED"] * 3


def test_an_undecided_run_has_no_metrics(too_few_steps):
    told = {"verdict", "verdict_reaching", "verdict_tracking", "outcome", "end_time", "steps"}
    premises = {"least_gain", "largest_disturbance"}  # what was met until the end is worth knowing
    metrics = too_few_steps.metrics.named()
    assert np.all(np.isnan(np.hstack([value for name, value in metrics.items() if name not in told | premises])))
    assert np.all(np.isfinite([metrics[name] for name in premises]))


def test_an_undecided_run_has_no_signals_after_its_end(too_few_steps):
    ended = too_few_steps.ts > float(too_few_steps.metrics.end_time)
    assert 0 < np.sum(ended) < len(ended)
    assert np.all(np.isnan(too_few_steps.x[ended]))


def test_advice_names_the_step_limit(too_few_steps):
    assert "`max_steps`" in too_few_steps.outcome.advice
    assert "MAX_STEPS" in str(too_few_steps)


def test_drift_that_is_not_finite_is_undecided_within_few_steps():
    def scenario(draw):
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL)
        plant = Troubled(end=draw.uniform("end", 0.0, 20.0))  # 10 s in the nominal run, which is looked at beforehand
        loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Zero(), control)
        return qj.Scenario(loop, [0.3], 5.0)

    study = qj.Study(scenario, bandwidth=0.2)
    runs = qj.monte_carlo(study, 64, block=64, settings=SETTINGS)
    is_bad = runs["end"] < 5.0
    assert 0 < is_bad.sum() < 64
    assert set(runs["outcome"][is_bad]) == {qj.Outcome.STEP_TOO_SMALL}
    assert set(runs["verdict"][is_bad]) == {qj.Verdict.UNDECIDED}
    np.testing.assert_allclose(runs["end_time"][is_bad], runs["end"][is_bad], rtol=1e-9)
    assert runs["steps"].max() < 300
    assert set(runs["verdict"][~is_bad]) == {qj.Verdict.HELD}
    again = study.replay(int(np.argmax(is_bad)), settings=SETTINGS)  # such a row can be looked at
    assert again.outcome == qj.Outcome.STEP_TOO_SMALL


def test_a_drift_that_is_not_finite_from_the_start_is_undecided_within_few_steps():
    metrics = jax.jit(lambda end: simulate(end=end).metrics)(0.0)
    assert metrics.outcome == qj.Outcome.STEP_TOO_SMALL
    assert metrics.steps < 300


@pytest.mark.parametrize(("strength", "height"), [(1.0, 1e14), (1.0, 1e8), (1e-3, -1e10)])
def test_edge_that_the_input_pushes_back_from_is_not_called_violated(strength, height):
    run = simulate(jump=1.0, height=height, strength=strength)
    assert run.outcome in (qj.Outcome.BEYOND_RESOLUTION, qj.Outcome.STEP_TOO_SMALL, qj.Outcome.MAX_STEPS)
    assert claims(run) == ["UNDECIDED"] * 3


@pytest.mark.parametrize("height", [1.0, -10.0])
def test_an_unannounced_jump_costs_steps_but_no_truth(height):
    run = simulate(x0=0.0, t1=5.0, jump=4.0, height=height)
    # From rest to the equilibrium u = -height, nearly: mu (rho - rho_inf) adds what is left of the funnel's motion.
    assert claims(run) == ["HELD"] * 3
    assert float(run.metrics.peak_u) == pytest.approx(abs(height), rel=1e-3, abs=math.exp(-4.0))


@pytest.mark.parametrize(("t1", "reaching"), [(2.3, "UNDECIDED"), (2.4, "HELD")])
def test_horizon_up_to_the_reaching_time_decides_nothing_about_reaching(t1, reaching):
    run = simulate(t1=t1)
    assert run.reaching_time == pytest.approx(math.log(1.0 / 0.1))  # 2.303 s
    assert claims(run)[:2] == ["HELD", reaching]


@pytest.mark.parametrize("t1", [0.5, 1.5])
def test_a_run_that_is_still_outside_the_bandwidth_before_the_reaching_time_has_broken_nothing(t1):
    run = simulate(x0=0.95, t1=t1, strength=0.01)  # hardly pushed at all
    assert float(run.metrics.reach_time) == math.inf
    assert claims(run) == ["HELD", "UNDECIDED", "UNDECIDED"]


def test_a_run_that_was_not_begun_prints_no_metrics():
    first, advice = str(simulate(x0=3.0)).splitlines()
    assert first == "Trajectory that was not begun: funnel INADMISSIBLE, reaching INADMISSIBLE, tracking INADMISSIBLE"
    assert advice.strip() == f"STARTED_OUTSIDE: {qj.Outcome.STARTED_OUTSIDE.advice}"


def test_a_sampled_run_from_outside_was_followed_and_prints_what_it_did():
    loop = dataclasses.replace(qj.paper.example1(), implementation=qj.Implementation(0.01, saturation=20.0))
    run = qj.simulate(loop, [1.6, 2.0], 2.0)
    assert claims(run)[0] == "INADMISSIBLE"
    assert str(run).startswith("Trajectory to t = 2 s")


@pytest.mark.parametrize("outcome", qj.Outcome, ids=lambda outcome: outcome.name)
def test_every_outcome_says_what_to_do(outcome):
    assert outcome.advice.endswith(".")


LOOP = problems.scalar_loop(FUNNEL)
STUDY = qj.Study(problems.dispersed_example1, bandwidth=0.1)


def call(x0=(0.0,), t1=1.0, bandwidth=0.2, **options):
    return lambda: qj.simulate(LOOP, x0, t1, bandwidth=bandwidth, **options)


def loop_of(plant, c=()):
    control = qj.QuasiSlidingControl(qj.SlidingSurface(list(c)), FUNNEL)
    return qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Zero(), control)


class Vector(qj.AbstractPlant):
    order: ClassVar[int] = 2

    def drift(self, t, x):
        return jnp.stack(x)

    def gain(self, t, x):
        return 1.0


class Nothing(qj.AbstractPlant):
    order: ClassVar[int] = 1

    def drift(self, t, x):
        return 0.0

    def gain(self, t, x):
        return None


def twice(draw):
    draw.uniform("a", 0.0, 1.0)
    draw.uniform("a", 0.0, 1.0)


BAD = {
    "x0 too long": (call(x0=(0.0, 0.0)), r"`x0` must have shape \(1,\) .*order 1.* but has shape \(2,\)"),
    "x0 a number": (call(x0=0.0), r"`x0` must have shape \(1,\) .* but has shape \(\)"),
    "x0 NaN": (call(x0=(math.nan,)), "`x0` must be finite, but is"),
    "x0 infinite": (call(x0=(math.inf,)), "`x0` must be finite, but is"),
    "t1 zero": (call(t1=0.0), "`t1` must be positive and finite, but is 0"),
    "t1 infinite": (call(t1=math.inf), "`t1` must be positive and finite, but is inf"),
    "ts falling": (call(ts=np.array([0.5, 0.2])), "`ts` must increase"),
    "ts twice": (call(ts=np.array([0.2, 0.2])), "`ts` must increase"),
    "ts beyond": (call(ts=np.array([0.0, 1.1])), r"`ts` must lie within \[0, t1\] = \[0, 1\], but spans \[0, 1.1\]"),
    "ts before": (call(ts=np.array([-0.1, 1.0])), r"`ts` must lie within"),
    "ts NaN": (call(ts=np.array([math.nan])), "`ts` must be finite"),
    "ts empty": (call(ts=np.array([])), "`ts` must be a list of times"),
    "bandwidth = rho_inf": (call(bandwidth=0.1), "`bandwidth` must lie strictly between 0.1, where .* but is 0.1"),
    "bandwidth = rho0": (call(bandwidth=1.0), "`bandwidth` must lie strictly between .* and 1, where .* but is 1"),
    "bandwidth NaN": (call(bandwidth=math.nan), "`bandwidth` must be finite, but is nan"),
    "rtol zero": (lambda: qj.SolverSettings(rtol=0.0), "`rtol` must be positive and finite, but is 0"),
    "rtol one": (lambda: qj.SolverSettings(rtol=1.0), "`rtol` must be below 1, but is 1"),
    "atol zero": (lambda: qj.SolverSettings(atol=0.0), "`atol` must be positive and finite, but is 0"),
    "no steps": (lambda: qj.SolverSettings(max_steps=0), "`max_steps` must be at least 1, but is 0"),
    "method": (lambda: qj.SolverSettings(method="euler"), "`method` must be one of .*tsit5.* but is 'euler'"),
    "coordinates": (lambda: qj.SolverSettings(coordinates="polar"), "`coordinates` must be one of .* but is 'polar'"),
    "adjoint": (lambda: qj.SolverSettings(adjoint="both"), "`adjoint` must be one of .* but is 'both'"),
    "c too long": (lambda: loop_of(Troubled(), [1.0]), "`c` .* must have 0 coefficients .* order 1, but has 1"),
    "drift a vector": (lambda: loop_of(Vector(), [1.0]), r"`drift` of `Vector` must return one number, .* \(2,\)"),
    "gain None": (lambda: loop_of(Nothing()), "`gain` of `Nothing` must return one number, but returns NoneType"),
    "scenario t1": (lambda: qj.Scenario(LOOP, [0.0], -1.0), "`t1` must be positive and finite, but is -1"),
    "scenario x0": (lambda: qj.Scenario(LOOP, [0.0, 0.0], 1.0), r"`x0` must have shape \(1,\)"),
    "no function": (lambda: qj.Study(None, 0.1), "`scenario` must be a function of `draw`, but is None"),
    "no scenario": (lambda: qj.Study(lambda draw: 3, 0.1), "`scenario` must return a `Scenario.*, but returns a `int`"),
    "two draws": (lambda: qj.Study(twice, 0.1), "`name` must be new in the scenario, but is `a` a second time"),
    "study's bandwidth": (lambda: qj.Study(problems.dispersed_example1, 4.0), "`bandwidth` must lie strictly between"),
    "unknown name": (lambda: STUDY.substitute(rho_in=1.0), "no name `rho_in` .* Did you mean `rho_inf`"),
    "out of bounds": (lambda: STUDY.substitute(mu=100.0), r"`mu` must lie in \[0.5, 10\], but is 100"),
    "replay of none": (lambda: STUDY.replay(-1), r"`indices` must be in \[0, .* has -1"),
    "no threads": (lambda: qj.monte_carlo(STUDY, 1, threads=0), "`threads` must be at least 1, but is 0"),
}


@pytest.fixture
def _as_users_have_it():
    """Without the checks of annotations that only tests make, and that would come first."""
    jaxtyping.config.update("jaxtyping_disable", True)
    yield
    jaxtyping.config.update("jaxtyping_disable", False)


@pytest.mark.usefixtures("_as_users_have_it")
@pytest.mark.parametrize(("wrong", "message"), BAD.values(), ids=BAD.keys())
def test_wrong_call_is_told_the_argument_its_value_and_what_must_hold(wrong, message):
    with pytest.raises(ValueError, match=message):
        wrong()

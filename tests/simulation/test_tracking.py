"""The claims on later times: judged from t_r and t_s on, whatever the horizon; what was not followed stays open."""

import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import problems
import qsmc_jax as qj
from qsmc_jax.base.module import float_field

HELD, VIOLATED, UNDECIDED = "HELD", "VIOLATED", "UNDECIDED"
ZERO = qj.references.Constant(0.0)
SATURATED = qj.Implementation(0.02, saturation=1.0)


class Pulse(qj.AbstractDisturbance):
    """A rectangular push."""

    height: Float[Array, ""] = float_field()
    start: Float[Array, ""] = float_field()
    end: Float[Array, ""] = float_field()

    def __call__(self, t):
        return jnp.where((t >= self.start) & (t < self.end), self.height, 0.0)

    @property
    def bound(self):
        return jnp.abs(self.height)

    @property
    def break_times(self):
        return jnp.stack([jnp.asarray(self.start), jnp.asarray(self.end)])


def simulate(d, x0, t1, c=(), funnel=(4.0, 3.0, 0.05), bandwidth=0.1, implementation=None):
    control = qj.QuasiSlidingControl(qj.SlidingSurface(list(c)), qj.Funnel(*funnel))
    loop = qj.ClosedLoop(problems.chain(len(c) + 1)(), ZERO, d, control, implementation)
    return qj.simulate(loop, x0, t1, bandwidth=bandwidth, ts=np.array([0.0, t1]))


def claims(run):
    f = run.metrics
    return [qj.Verdict(int(v)).name for v in (f.verdict, f.verdict_reaching, f.verdict_tracking)]


@pytest.mark.parametrize("t1", [*range(18, 26), 100])
def test_a_loop_that_swings_out_for_ever_violates_tracking_at_every_horizon(t1):
    # In each half-period d exceeds the input's limit of 1 and drives the state .336 away; 2 s later it is back.
    swinging = simulate(qj.disturbances.Sine(1.2, 0.5), [0.5], float(t1), implementation=SATURATED)
    assert claims(swinging) == [VIOLATED] * 3


@pytest.mark.parametrize("t1", [2.9, 3.5, 6.0, 30.0])
def test_an_error_that_was_outside_once_is_not_forgiven_when_it_comes_back(t1):
    # sigma stays within the bandwidth but the push, from 2.5 to 2.8, takes it out; t_r = 1.46.
    pushed = simulate(Pulse(1.5, 2.5, 2.8), [0.0], t1, implementation=SATURATED)
    assert claims(pushed) == [VIOLATED] * 3
    if t1 > 6.0:
        assert float(pushed.metrics.settle_time) < 4.0


@pytest.mark.parametrize("t1", [2.0, 30.0])
def test_an_excursion_that_is_over_before_the_settling_time_breaks_nothing(t1):
    # The push ends at 0.4; the errors are back in their bounds by t_r = 1.46.
    pushed = simulate(Pulse(1.5, 0.1, 0.4), [0.0], t1, implementation=SATURATED)
    assert claims(pushed) == [HELD] * 3


@pytest.mark.slow
@pytest.mark.parametrize("implementation", [None, qj.Implementation(0.005)], ids=["ideal", "sampled"])
@pytest.mark.parametrize(("t1", "expected"), [(1.4, [UNDECIDED] * 2), (50.0, [HELD, UNDECIDED]), (130.0, [HELD] * 2)])
def test_a_horizon_up_to_the_settling_time_decides_nothing_about_tracking(implementation, t1, expected):
    # e' = -0.05 e + sigma from e = 20: the bound of 2 is reached after some ln(10) / 0.05 = 46 s, the envelope's after
    # 21 exp(-0.05 t) + 1 = 2, or nearly, for rho comes down from 4: t_s = 60 s.
    run = simulate(qj.disturbances.Constant(0.1), [20.0, -1.0], t1, (0.05,), implementation=implementation)
    assert claims(run) == [HELD, *expected]
    if t1 > 50.0:
        assert 46.0 < float(run.metrics.settle_time) < float(run.settling_time) < 61.0
        assert f"t_s = {float(run.settling_time):.6g} s" in str(run)


def test_a_horizon_before_the_reaching_time_decides_nothing_about_either():
    run = simulate(qj.disturbances.Constant(0.0), [0.0], 0.01, funnel=(4.0, 0.5, 0.05))
    assert claims(run) == [HELD, UNDECIDED, UNDECIDED]


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_run_along_its_envelope_is_held(sign):
    # z = .94 in the end, e starts on that side, and its bound is hardly wider than rho_inf leaves it.
    d, x0 = qj.disturbances.Constant(sign * 10.0), [sign * 2.0, sign * -0.2]
    run = simulate(d, x0, 40.0, (2.0,), bandwidth=0.0505)
    assert claims(run) == [HELD] * 3
    settled = float(run.metrics.settle_time)
    assert 0.7 * float(run.settling_time) < settled < float(run.settling_time)


@pytest.mark.parametrize("level", [30.0, -1000.0])
@pytest.mark.parametrize("bandwidth", [0.0505, 0.06, 0.1])
def test_a_step_that_begins_outside_before_the_settling_time_and_ends_inside_after_it_breaks_nothing(level, bandwidth):
    # sigma = z rho all along, e starts on that side: the envelope is all but reached, and from t_s on it is inside.
    sigma0, side = 2.0 / math.pi * math.atan(abs(level)) * 4.05, math.copysign(1.0, level)
    x0 = [side, side * (sigma0 - 2.0)]
    run = simulate(qj.disturbances.Constant(level), x0, 40.0, (2.0,), bandwidth=bandwidth)
    assert claims(run) == [HELD] * 3


class Runaway(qj.AbstractPlant):
    """f = a x, which the limited input cannot hold once x is beyond 1 / a."""

    speed: Float[Array, ""] = float_field(default=1.0)
    order: ClassVar[int] = 1

    def drift(self, t, x):
        return self.speed * x[0]

    def gain(self, t, x):
        return 1.0


def lost(funnel):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(*funnel))
    loop = qj.ClosedLoop(Runaway(10.0), ZERO, qj.disturbances.Constant(5.0), control, SATURATED)
    run = qj.simulate(loop, [0.5], 20.0, bandwidth=0.1)
    assert run.outcome == qj.Outcome.LOST
    return run


def test_what_is_lost_before_it_had_to_reach_leaves_the_later_claims_open():
    run = lost((1.0, 0.5, 0.05))
    assert float(run.metrics.end_time) < run.reaching_time
    assert claims(run) == [VIOLATED, UNDECIDED, UNDECIDED]
    assert "open" in run.outcome.advice


def test_what_is_lost_after_that_has_broken_every_claim():
    run = lost((1.0, 60.0, 0.05))
    assert float(run.metrics.end_time) > run.reaching_time
    assert claims(run) == [VIOLATED] * 3


def test_a_run_out_of_steps_that_was_outside_before_has_broken_every_claim():
    settings = qj.SolverSettings(max_steps=2000)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(4.0, 3.0, 0.05))
    loop = qj.ClosedLoop(problems.chain(1)(), ZERO, Pulse(1.5, 2.5, 2.8), control, SATURATED)
    run = qj.simulate(loop, [0.0], 1000.0, settings=settings)
    assert run.outcome == qj.Outcome.MAX_STEPS
    assert claims(run) == [VIOLATED] * 3
    assert math.isnan(float(run.metrics.peak_ratio))

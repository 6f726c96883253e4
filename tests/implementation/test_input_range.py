"""Commands that are kept between two numbers, against closed forms of a scalar loop and its mirror image."""

import dataclasses
import math

import jax.numpy as jnp
import numpy as np
import pytest

import qsmc_jax as qj
from studies_for_tests import Integrator

FUNNEL = qj.Funnel(1.0, 2.0, 0.1)


def loop(d=0.0, sign=1.0, **limits):
    """x' = sign u + d."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL, sign)
    made = qj.Implementation(1e-3, **limits)
    return qj.ClosedLoop(Integrator(sign), qj.references.Constant(0.0), qj.disturbances.Constant(d), control, made)


def simulate(x0, t1=4.0, **about):
    return qj.simulate(loop(**about), [x0], t1, bandwidth=0.2)


def test_a_range_is_kept_to_the_last_digit_at_either_end():
    """x0 = 0.95 of 1.1 asks for u = -4.6; d = -3 for u = 3, later."""
    run = simulate(0.95, d=-3.0, input_range=(-2.0, 2.5))
    assert float(np.nanmin(run.u)) == -2.0
    assert float(np.nanmax(run.u)) == 2.5


def test_a_range_on_both_sides_is_a_saturation():
    one, other = simulate(0.95, d=0.6, input_range=(-1.5, 1.5)), simulate(0.95, d=0.6, saturation=1.5)
    assert np.array_equal(one.x, other.x)
    assert np.array_equal(one.u, other.u)


def test_a_loop_in_the_mirror_has_the_mirrored_range():
    ours = simulate(0.6, d=0.8, input_range=(-1.4, 0.3))
    theirs = simulate(-0.6, d=-0.8, input_range=(-0.3, 1.4))
    assert np.array_equal(ours.x, -theirs.x)
    assert float(ours.metrics.peak_u) == float(theirs.metrics.peak_u)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_an_input_that_only_pulls_cannot_hold_what_pulls_the_same_way(sign):
    """x = t leaves the funnel when t = exp(-2 t) + 0.1; what pulls the other way is held."""
    lost, held = (simulate(0.0, d=d, sign=sign, input_range=sorted((0.0, sign * 9.0))) for d in (1.0, -1.0))
    assert held.verdict is qj.Verdict.HELD
    assert lost.verdict is qj.Verdict.VIOLATED
    time = float(lost.metrics.violation_time)
    assert time == pytest.approx(math.exp(-2.0 * time) + 0.1, rel=1e-4)


@pytest.mark.slow
def test_a_range_that_is_drawn_is_known_run_by_run():
    def scenario(draw):
        high = draw.uniform("high", -0.5, 1.0)
        made = loop(d=0.5)
        made = dataclasses.replace(made, implementation=qj.Implementation(1e-2, input_range=jnp.stack([0.0, high])))
        return qj.Scenario(made, x0=[0.0], t1=0.5)

    rows = qj.monte_carlo(qj.Study(scenario, bandwidth=0.2), 64, block=64)
    is_one = rows["high"] > 0.0
    assert 0 < is_one.sum() < 64
    assert np.array_equal(rows["outcome"] == qj.Outcome.BAD_PARAMETERS, ~is_one)


BAD = {
    "turned": ((2.0, -1.0), "must have low < high, but is (2, -1)"),
    "one": ((2.0,), "must be two numbers, but has shape (1,)"),
    "empty": ((1.0, 1.0), "must have low < high, but is (1, 1)"),
    "nan": ((math.nan, 1.0), "must have low < high"),
}


@pytest.mark.parametrize(("limits", "message"), BAD.values(), ids=BAD)
def test_a_range_that_is_none_is_named(limits, message):
    with pytest.raises(qj.InputError) as error:
        qj.Implementation(1e-3, input_range=limits)
    assert message in str(error.value)

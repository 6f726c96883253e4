"""Bounds of the residual in the funnel: closed forms, and runs whose sliding variable is anywhere in it."""

import math

import jax.numpy as jnp
import numpy as np
import pytest

import qsmc_jax as qj
from problems import STILL, STILL_BANDWIDTH, WIDTH
from proof import proofs

C, BOUND, END = 2.0, 0.3, 1.0


class Double(qj.AbstractPlant):
    """x'' = u + d."""

    order = 2

    def drift(self, t, x):
        """None."""
        return 0.0

    def gain(self, t, x):
        """Of one."""
        return 1.0


def double(control=None):
    control = control or qj.QuasiSlidingControl(qj.SlidingSurface([C]), STILL)
    loop = qj.ClosedLoop(Double(), proofs.REST, qj.disturbances.Constant(BOUND), control)
    return qj.Study(lambda draw: qj.Scenario(loop, x0=[0.0, 0.0], t1=END), bandwidth=STILL_BANDWIDTH)


def test_the_residual_of_a_double_integrator_is_its_closed_form():
    """w = c e2 + d, e1' = sigma - c e1: the worst is sigma at one edge until the end, and there at the other."""
    found = qj.residual_bound(double())
    truth = C * WIDTH * (2.0 - math.exp(-C * END)) + BOUND
    assert truth <= found.residual <= 1.02 * truth
    assert found.gain_bounds == pytest.approx((1.0, 1.0), abs=1e-12)
    assert found.ratio0 == pytest.approx(0.0, abs=1e-12)
    assert found.until == END


def test_gain_and_offset_of_the_law_count():
    control = qj.QuasiSlidingControl(qj.SlidingSurface([C]), STILL, gain=3.0, offset=-0.5)
    found, plain = qj.residual_bound(double(control)), qj.residual_bound(double())
    assert found.gain_bounds == pytest.approx((3.0, 3.0), abs=1e-12)
    assert found.residual == pytest.approx(plain.residual + 0.5, rel=1e-9)


def test_no_path_within_the_funnel_has_a_larger_residual():
    """Example 1: paths that jump from edge to edge, for random pendulums, worked out step by step."""
    study, rng = proofs.example(1), np.random.default_rng(3)
    found = qj.residual_bound(study)
    ts, runs = np.linspace(0.0, 6.0, 6001), 200
    rho = 4.0 * np.exp(-3.0 * ts) + 0.05
    jumps = np.where(rng.uniform(size=(runs, len(ts))) < 0.003, -1.0, 1.0)
    sides = jumps.cumprod(axis=1) * rng.choice([-1, 1], (runs, 1))
    mass, length, friction = (rng.choice([0.8, 1.0, 1.2], (3, runs)).T * [0.01, 9.8, 0.01]).T
    e, worst = rng.choice([0.1, 0.9], runs), 0.0
    for k, t in enumerate(ts):
        highest = sides[:, k] * rho[k] - 2.0 * e
        x = e + np.sin(t), highest + np.cos(t)
        drift = -9.8 / length * np.sin(x[0]) - friction / mass * x[1] + np.sin(x[1])
        worst = max(worst, np.max(np.abs(drift + np.sin(t) + 2.0 * highest)) + 0.5)
        e = e + 1e-3 * highest
    assert 0.4 * found.residual < worst <= found.residual
    gains = 1.0 / (0.012 * 11.76**2), 1.0 / (0.008 * 7.84**2)
    assert found.gain_bounds == pytest.approx(gains, rel=1e-9)
    assert found.gain_bounds[0] <= gains[0] <= gains[1] <= found.gain_bounds[1] * (1.0 + 1e-15)


def test_limits_follow_from_it():
    """The law with the amplitude that follows is at its limit no further out than the funnel's edge."""
    study = proofs.still()
    found, funnel = qj.residual_bound(study), study.nominal.loop.control.funnel
    assert found.residual == pytest.approx(2.0, rel=1e-12)
    least = qj.thresholds.sufficient_saturation(found.residual, found.gain_bounds[0], funnel)
    assert least == pytest.approx(2.0, rel=1e-12)


def test_what_is_not_bounded_is_refused():
    control = qj.QuasiSlidingControl(qj.SlidingSurface([0.4, 0.4]), STILL)  # roots that swing

    class Third(qj.AbstractPlant):
        order = 3

        def drift(self, t, x):
            """Infinite where x is -1."""
            return 1.0 / (1.0 + x[0])

        def gain(self, t, x):
            """Of one."""
            return 1.0

    loop = qj.ClosedLoop(Third(), proofs.REST, qj.disturbances.Zero(), control)
    study = qj.Study(lambda draw: qj.Scenario(loop, x0=[0.0, 0.0, 0.0], t1=40.0), bandwidth=STILL_BANDWIDTH)
    with pytest.raises(qj.InputError, match="must have a residual that is bounded in the funnel"):
        qj.residual_bound(study)


def test_an_operation_without_an_enclosure_is_named():
    class Stairs(qj.AbstractPlant):
        order = 1

        def drift(self, t, x):
            """Jumps in time."""
            return jnp.floor(t)

        def gain(self, t, x):
            """Of one."""
            return 1.0

    loop = qj.ClosedLoop(Stairs(), proofs.REST, qj.disturbances.Zero(), proofs.still().nominal.loop.control)
    study = qj.Study(lambda draw: qj.Scenario(loop, x0=[0.0], t1=3.0), bandwidth=STILL_BANDWIDTH)
    with pytest.raises(qj.InputError, match="computes by `floor`"):
        qj.residual_bound(study)

"""Smoothed friction: limits and bounds in closed form, and a loop with it against SciPy with true friction."""

import functools as ft
import math

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import qsmc_jax as qj

WIDTHS = (1e-6, 1e-3, 0.1, 7.0)
STEPS = np.concatenate([-np.logspace(3, -3, 30), [0.0], np.logspace(-3, 3, 30)])


def across(function, vs):
    return np.asarray(jax.vmap(function)(jnp.asarray(vs)))


@pytest.mark.parametrize("width", WIDTHS)
def test_sign_and_step_are_hyperbolic_tangents(width):
    vs = STEPS * width
    exact = np.array([float(mp.tanh(mp.mpf(v) / mp.mpf(width))) for v in vs])
    np.testing.assert_allclose(across(lambda v: qj.smoothed.sign(v, width), vs), exact, rtol=1e-13)
    np.testing.assert_allclose(across(lambda v: qj.smoothed.step(v, width), vs), 0.5 + 0.5 * exact, atol=1e-15)


@pytest.mark.parametrize("width", WIDTHS)
def test_sign_and_step_come_as_near_as_they_say(width):
    vs = np.array([-50.0, -10.0, 10.0, 50.0]) * width
    assert np.max(np.abs(across(lambda v: qj.smoothed.sign(v, width), vs) - np.sign(vs))) < 5e-9
    vs = np.array([-7.0, -5.0, 5.0, 7.0]) * width
    assert np.max(np.abs(across(lambda v: qj.smoothed.sign(v, width), vs) - np.sign(vs))) < 1e-4
    assert np.max(np.abs(across(lambda v: qj.smoothed.step(v, width), vs) - (vs > 0))) < 5e-5
    assert float(qj.smoothed.sign(width, width)) == pytest.approx(math.tanh(1.0))
    assert float(jax.grad(qj.smoothed.sign)(0.0, width)) == pytest.approx(1.0 / width)


@pytest.mark.parametrize("width", WIDTHS)
@pytest.mark.parametrize("half_gap", [0.0, 0.3, 5.0])
def test_a_dead_zone_keeps_its_bound_and_its_asymptotes(half_gap, width):
    def zone(v):
        return qj.smoothed.dead_zone(v, half_gap, width)

    vs = np.concatenate([STEPS * width + half_gap, STEPS * width - half_gap, np.linspace(-20.0, 20.0, 101)])
    exact = vs - np.clip(vs, -half_gap, half_gap)
    rounding = 1e-12 * (1.0 + np.abs(vs))
    error = np.abs(across(zone, vs) - exact)
    assert np.all(error <= width * math.log(2.0) + rounding)
    off = np.minimum(np.abs(vs - half_gap), np.abs(vs + half_gap)) >= 5.0 * width
    assert np.all((error <= 0.007 * width + rounding)[off])
    if half_gap > 50.0 * width:  # far from the other edge it is that far at the edge
        assert float(zone(half_gap)) == pytest.approx(width * math.log(2.0), rel=1e-12)
    np.testing.assert_allclose(across(zone, -vs), -across(zone, vs), rtol=1e-14, atol=1e-15 * (half_gap + width))
    slopes = across(jax.grad(zone), vs)
    assert np.all((slopes >= 0.0) & (slopes <= 1.0 + 1e-14))
    assert float(zone(1e3)) == pytest.approx(1e3 - half_gap, rel=1e-14)


def test_stribeck_friction_is_its_formula_and_has_the_peak_it_says():
    coulomb, static, at, viscous, width = 1.0, 1.5, 0.1, 0.2, 1e-3
    vs = np.linspace(-1.0, 1.0, 2001)
    exact = (coulomb + (static - coulomb) * np.exp(-((vs / at) ** 2))) * np.tanh(vs / width) + viscous * vs
    found = across(lambda v: qj.smoothed.stribeck(v, coulomb, static, at, viscous, width=width), vs)
    np.testing.assert_allclose(found, exact, rtol=1e-13, atol=1e-15)
    fine = np.linspace(0.0, 0.2, 20_001)
    for sliding in (0.0, 1.0):
        friction = ft.partial(qj.smoothed.stribeck, coulomb=sliding, static=static, stribeck_velocity=at, width=width)
        peak = np.max(across(friction, fine))
        assert static * 0.997 < peak <= static


HUGE = {
    "sign": lambda v, w: qj.smoothed.sign(v, w),
    "step": lambda v, w: qj.smoothed.step(v, w),
    "dead zone": lambda v, w: qj.smoothed.dead_zone(v, 0.1, w),
    "stribeck": lambda v, w: qj.smoothed.stribeck(v, 1.0, 1.5, w, 0.1, width=w),
}


@pytest.mark.parametrize("v", [-1e150, -1e10, 0.0, 1e10, 1e150])
@pytest.mark.parametrize("function", HUGE.values(), ids=HUGE)
def test_values_and_derivatives_are_finite_however_many_widths_away(function, v):
    width = 1e-12 if abs(v) < 1e100 else 1.0
    value, slopes = jax.value_and_grad(function, argnums=(0, 1))(v, width)
    assert np.all(np.isfinite([value, *slopes]))


REFUSED = {
    "sign": (lambda: qj.smoothed.sign(1.0, 0.0), "`width` must be positive, but is 0. Take a small number"),
    "step": (lambda: qj.smoothed.step(1.0, -1e-3), "`width` must be positive, but is -0.001"),
    "dead zone": (lambda: qj.smoothed.dead_zone(1.0, 0.1, -1.0), "`width` must be positive, but is -1"),
    "gap": (lambda: qj.smoothed.dead_zone(1.0, -0.1, 1.0), "`half_gap` must be finite and not negative, but is -0.1"),
    "not a number": (lambda: qj.smoothed.sign(1.0, math.nan), "`width` must be finite"),
    "stribeck": (lambda: qj.smoothed.stribeck(1.0, 1.0, 1.5, 0.0, width=1.0), "`stribeck_velocity` must be positive"),
    "width": (lambda: qj.smoothed.stribeck(1.0, 1.0, 1.5, 0.1, width=0.0), "`width` must be positive, but is 0"),
    "coulomb": (lambda: qj.smoothed.stribeck(1.0, -1.0, 1.5, 0.1, width=1.0), "`coulomb` must be finite and not neg"),
}


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_a_wrong_width_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_a_traced_width_passes_also_where_it_is_wrong():
    assert float(jax.jit(lambda w: qj.smoothed.sign(1.0, w))(-1e-3)) == -1.0


class Rubbing(qj.AbstractPlant):
    """A unit mass with unit Coulomb friction."""

    order = 2

    def drift(self, t, x):
        return -qj.smoothed.sign(x[1], 1e-4)

    def gain(self, t, x):
        return 1.0


@pytest.mark.slow
def test_a_loop_with_smoothed_friction_is_that_with_true_friction():
    """Against SciPy, which integrates sliding and sticking by turns and changes over at the events between them."""

    def parts(t, x, v):
        rho = 4.0 * math.exp(-t) + 0.05
        sigma = 2.0 * (x - math.sin(t)) + v - math.cos(t)
        return -math.tan(0.5 * math.pi * sigma / rho), abs(sigma) / rho

    def excess(t, y):
        return abs(parts(t, y[0], 0.0)[0]) - 1.0

    def stops(t, y):
        return y[1]

    excess.terminal = stops.terminal = True
    t, y, side, peak = 0.0, [0.5, 0.5], 1.0, 0.0
    while t < 10.0:
        if side:
            rate, event = (lambda t, y, side=side: [y[1], parts(t, *y)[0] - side]), stops
            event.direction = -side
        else:
            rate, event = (lambda t, y: [0.0, 0.0]), excess
            event.direction = 1.0
        options = {"rtol": 1e-10, "atol": 1e-12, "dense_output": True, "max_step": 0.02}
        piece = solve_ivp(rate, (t, 10.0), y, "Radau", events=event, **options)
        ts = np.linspace(t, piece.t[-1], 4001)
        peak = max(peak, max(parts(s, *piece.sol(s))[1] for s in ts))
        t, y = piece.t[-1], [piece.y[0, -1], 0.0]
        push = parts(t, y[0], 0.0)[0]
        side = np.sign(push) if side == 0.0 or abs(push) > 1.0 else 0.0
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(4.0, 1.0, 0.05))
    loop = qj.ClosedLoop(Rubbing(), qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Zero(), control)
    run = qj.simulate(loop, [0.5, 0.5], 10.0, ts=np.array([0.0, 10.0]))
    assert run.outcome == qj.Outcome.COMPLETED
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, abs=1e-4)

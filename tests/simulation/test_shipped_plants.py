"""Plants of the studies in their own coordinates, against SciPy on equations written in another form."""

import math
import runpy

import numpy as np
import pytest
import scipy.integrate
from scipy.interpolate import CubicSpline

import places
import qsmc_jax as qj


def nominal(name):
    """What a study brings, and its nominal run."""
    study = runpy.run_path(str(places.STUDIES / f"{name}.py"))
    scenario = study["study"].nominal
    return study, scenario, qj.simulate(scenario.loop, scenario.x0, scenario.t1, bandwidth=study["study"].bandwidth)


def solved(rate, scenario, longest=np.inf):
    """By SciPy: times, states."""
    tight = {"method": "Radau", "rtol": 1e-9, "atol": 1e-11, "max_step": longest}
    span = 0.0, float(scenario.t1)
    truth = scipy.integrate.solve_ivp(rate, span, np.asarray(scenario.x0), dense_output=True, **tight)
    ts = np.linspace(*span, 100_001)
    return ts, truth.sol(ts)


@pytest.mark.slow
def test_a_quarter_car_on_a_recorded_road_is_what_scipy_makes_of_it():
    study, scenario, run = nominal("quarter_car")
    road = study["ROAD"]
    spline = CubicSpline(road.times, road.coefficients[0][1:])

    def rate(t, x):
        u = -1000.0 * math.tan(0.5 * math.pi * (5.0 * x[0] + x[1]) / (math.exp(-2.0 * t) + 0.05))
        strut = 26000.0 * (x[2] - x[0]) + 1500.0 * (x[3] - x[1])
        return [x[1], (strut + u) / 250.0, x[3], (1e5 * (spline(t) - x[2]) - strut - u) / 43.0]

    ts, x = solved(rate, scenario, longest=0.01)
    body, speed, *_ = x
    peak = np.max(np.abs(5.0 * body + speed) / (np.exp(-2.0 * ts) + 0.05))
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, rel=1e-6)
    np.testing.assert_allclose(run.x[-1], x[:, -1], atol=1e-6)


@pytest.mark.slow
def test_a_cart_pole_is_what_scipy_makes_of_its_mass_matrix():
    _, scenario, run = nominal("cart_pole")
    plant, push = scenario.loop.plant, scenario.loop.disturbance
    cart, pole, length = (float(getattr(plant, name)) for name in ("cart", "pole", "length"))
    size, frequency, phase = (float(getattr(push, name)) for name in ("amplitude", "frequency", "phase"))

    def rate(t, x):
        _, angle, speed, spin = x
        force = 10.0 * math.tan(0.5 * math.pi * (3.0 * angle + spin) / (math.exp(-2.0 * t) + 0.02))
        d = size * math.sin(frequency * t + phase)
        couples = pole * length * math.cos(angle)
        matrix = [[cart + pole, couples], [couples, 4.0 / 3.0 * pole * length**2]]
        sides = [force + pole * length * spin**2 * math.sin(angle), pole * length * (9.81 * math.sin(angle) + d)]
        return [speed, spin, *np.linalg.solve(matrix, sides)]

    ts, x = solved(rate, scenario)
    peak = np.max(np.abs(3.0 * x[1] + x[3]) / (np.exp(-2.0 * ts) + 0.02))
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, rel=1e-6)
    np.testing.assert_allclose(run.x[-1], x[:, -1], atol=1e-5)


@pytest.mark.slow
def test_a_two_link_arm_is_what_scipy_makes_of_its_inertia():
    _, scenario, run = nominal("two_link_arm")
    arm, pushes, asked = scenario.loop.plant, scenario.loop.disturbances, scenario.loop.references
    m1, m2, l1, l2 = (float(getattr(arm, name)) for name in ("m1", "m2", "l1", "l2"))

    def read(t, x):
        wanted = [(0.5 * np.sin(t), 0.5 * np.cos(t)), (0.4 * np.cos(1.3 * t), -0.52 * np.sin(1.3 * t))]
        sigma = [3.0 * (x[i] - q) + x[2 + i] - v for i, (q, v) in enumerate(wanted)]
        return np.array(sigma) / [4.0 * np.exp(-2.0 * t) + 0.2, 6.0 * np.exp(-2.0 * t) + 0.3]

    def rate(t, x):
        z = read(t, x)
        u = [-10.0 * math.tan(0.5 * math.pi * each) / rho for each, rho in zip(z, widths(t), strict=True)]
        d = [float(p.amplitude) * math.sin(float(p.frequency) * t + float(p.phase)) for p in pushes]
        (q1, q2), v = x[:2], x[2:]
        bend = m2 * l1 * l2
        inertia = np.array([[(m1 + m2) * l1**2 + m2 * l2**2 + 2 * bend * math.cos(q2), 0.0], [0.0, m2 * l2**2]])
        inertia[0, 1] = inertia[1, 0] = m2 * l2**2 + bend * math.cos(q2)
        coriolis = bend * math.sin(q2) * np.array([[-v[1], -(v[0] + v[1])], [v[0], 0.0]])
        lower = m2 * 9.81 * l2 * math.cos(q1 + q2)
        weight = [(m1 + m2) * 9.81 * l1 * math.cos(q1) + lower, lower]
        return [*v, *np.linalg.solve(inertia, np.array(u) + d - coriolis @ v - weight)]

    def widths(t):
        return 4.0 * math.exp(-2.0 * t) + 0.2, 6.0 * math.exp(-2.0 * t) + 0.3

    assert [float(each.frequencies[0]) for each in asked] == [1.0, 1.3]
    ts, x = solved(rate, scenario)
    peaks = np.abs(read(ts, x)).max(axis=1)
    for i in range(2):
        assert float(run.metrics.channels[f"peak_ratio[{i}]"]) == pytest.approx(peaks[i], rel=1e-6)
    np.testing.assert_allclose(run.x[-1], x[:, -1], atol=1e-6)


COLD_AND_EAGER = {"damkoehler": 0.079, "heat": 8.3, "conversion_0": 0.2, "temperature_0": 0.6}


def reactor(**values):
    """A reactor's nominal run with some numbers given, and by SciPy: times, ratios, inputs, final state."""
    study = runpy.run_path(str(places.STUDIES / "cstr.py"))["study"].substitute(**values)
    scenario = study.nominal
    plant, feed, limits = scenario.loop.plant, scenario.loop.disturbance, scenario.loop.control.input_range
    speed, heat = float(plant.damkoehler), float(plant.heat)
    size, frequency, phase = (float(getattr(feed, name)) for name in ("amplitude", "frequency", "phase"))

    def ratio(t, x):
        return (x[1] - 2.75) / (2.5 * np.exp(-0.3 * t) + 0.3)

    def coolant(t, x):
        return np.clip(-0.5 - np.tan(0.5 * np.pi * np.clip(ratio(t, x), -1.0, 1.0)), *limits)

    def rate(t, x):
        turned = speed * (1.0 - x[0]) * math.exp(20.0 * x[1] / (20.0 + x[1]))
        feed_is_off = size * math.sin(frequency * t + phase)
        return [turned - x[0], heat * turned - x[1] + feed_is_off - 0.3 * (x[1] - coolant(t, x))]

    # The middle state is unstable: what a solve is off by grows, at the default tolerance to 2e-5.
    settings = qj.SolverSettings(rtol=1e-8)
    run = qj.simulate(scenario.loop, scenario.x0, scenario.t1, bandwidth=study.bandwidth, settings=settings)
    # Steps so short that a limit's kink costs them less than their tolerance.
    ts, x = solved(rate, scenario, longest=0.01)
    return run, ts, ratio(ts, x), coolant(ts, x), x[:, -1]


@pytest.mark.slow
@pytest.mark.parametrize(("values", "met"), [({}, 0), (COLD_AND_EAGER, 2)], ids=["neither", "both"])
def test_a_reactor_that_meets_so_many_of_its_coolant_s_limits_is_what_scipy_makes_of_it(values, met):
    run, _, ratios, u, end = reactor(**values)
    assert np.sum([np.any(u == -3.0), np.any(u == 1.75)]) == met
    assert run.verdict is qj.Verdict.HELD
    assert float(run.metrics.peak_ratio) == pytest.approx(np.max(np.abs(ratios)), rel=1e-6)
    np.testing.assert_allclose(run.x[-1], end, atol=1e-6)


@pytest.mark.slow
def test_a_reactor_that_runs_away_leaves_its_funnel_when_scipy_s_does():
    run, ts, ratios, u, _ = reactor(**COLD_AND_EAGER, coldest=-2.5)
    first = int(np.argmax(ratios >= 1.0))
    leaves = np.interp(1.0, ratios[first - 1 : first + 1], ts[first - 1 : first + 1])
    assert u[first - 1] == -2.5
    assert run.verdict is qj.Verdict.VIOLATED
    assert float(run.metrics.violation_time) == pytest.approx(leaves, rel=1e-6)

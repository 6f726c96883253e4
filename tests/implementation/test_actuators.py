"""Actuators that are limited in rate and travel, or have a dead zone: against their equations, and closed forms."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import qsmc_jax as qj
from studies_for_tests import Integrator

act = qj.actuators
EXACT = {"rtol": 1e-11, "atol": 1e-13}
# Starts and commands: through all of a dead zone of 0.4 both ways, into it and out of it, along its edge, and none.
WAYS = [
    (-1.0, 1.5),
    (1.2, -0.9),
    (0.9, 0.1),
    (0.1, 0.9),
    (0.7, 1.6),
    (0.4, 2.0),
    (-0.4, -2.0),
    (0.4, -1.0),
    (math.nextafter(0.4, 1.0), -1.0),
    (1.6, 0.4),
    (0.8, 0.8),
]


def positions(lag, rate, travel, start, command, ts):
    """T v' = clip(c - v, -T R, T R) between stops, at the times given."""
    if lag == 0.0:
        path = start + np.clip(command - start, -rate * ts, rate * ts)
    else:
        slope = lambda t, v: np.clip((command - v) / lag, -rate, rate)  # noqa: E731
        path = scipy.integrate.solve_ivp(slope, (0.0, ts[-1]), [start], "DOP853", ts, **EXACT).y[0]
    return np.clip(path, *travel)


@eqx.filter_jit
def moved(actuator, position, command, dt):
    state = actuator.rest()[:-1] + (position,)
    return actuator.move(state, command, dt)[0], actuator.swing(state, command, dt)


@pytest.mark.parametrize("zone", [None, 0.0, 0.4])
@pytest.mark.parametrize("travel", [(-math.inf, math.inf), (-1.1, 1.3)], ids=["free", "stops"])
@pytest.mark.parametrize(("lag", "rate"), [(0.0, 3.0), (0.2, 3.0), (0.5, 0.9), (1e-3, 50.0)])
def test_the_motion_is_that_of_the_equation(lag, rate, travel, zone):
    inner = act.RateLimited(lag, rate, travel)
    actuator = inner if zone is None else act.DeadZone(zone, inner)
    for start, command in WAYS:
        start = np.clip(start, *travel)
        for dt in (1e-3, 0.3, 4.0):
            ts = np.unique([np.linspace(0.0, min(dt, 0.1), 4001), np.linspace(0.0, dt, 4001)])
            v = positions(lag, rate, travel, start, command, ts)
            u = v if zone is None else np.where(np.abs(v) <= zone, 0.0, v - np.sign(v) * zone)
            end, swing = moved(actuator, jnp.asarray(start), jnp.asarray(command), jnp.asarray(dt))
            integrals = (np.trapezoid(values, ts) for values in (u, u**2))
            np.testing.assert_allclose(end, u[-1], rtol=1e-9, atol=1e-9)
            truth = np.sum(np.abs(np.diff(u))), np.min(u), np.max(u), *integrals
            np.testing.assert_allclose(swing, truth, rtol=1e-5, atol=1e-6)


def test_kinks_are_where_full_speed_ends_at_the_stop_and_at_the_edges_of_the_zone():
    actuator = act.DeadZone(0.5, act.RateLimited(0.25, 2.0, (-3.0, 3.0)))
    # From -1: edges at -0.5 and 0.5; full speed to 0.5 before the command.
    ends = sorted(map(float, actuator.kinks((-0.5, -1.0), 2.0)))
    np.testing.assert_allclose(ends, [0.25, 0.75, 1.25, math.inf], rtol=1e-14)
    # The last 0.4 of 0.5 to the stop: T log(0.5 / 0.1).
    ends = sorted(map(float, actuator.kinks((2.1, 2.6), 3.1)))
    np.testing.assert_allclose(ends, [0.25 * math.log(5.0), *[math.inf] * 3], rtol=1e-13)
    at_rest = *actuator.kinks((0.0, 0.5), 3.0), *actuator.kinks((2.5, 3.0), 7.0)
    assert [float(time) for time in at_rest].count(math.inf) == 7  # but full speed, from 0.5 on


@jax.jit
def numbers(values):
    """All that an actuator says of a stretch of time."""
    lag, rate, low, width, command, begin, dt = values
    actuator = act.DeadZone(width, act.RateLimited(lag, rate, jnp.stack([low, -low])))
    state = (0.0, begin)
    kinks = jnp.stack(actuator.kinks(state, command))
    known = jnp.where(kinks < jnp.inf, kinks, 0.0)
    return jnp.stack([*actuator.move(state, command, dt), *actuator.swing(state, command, dt), *known])


SLOPES = jax.jit(jax.jacfwd(numbers))


@pytest.mark.parametrize("start", [-1.0, 0.2, 0.9])
@pytest.mark.parametrize("dt", [0.05, 0.4, 2.0])
def test_gradients_are_differences(start, dt):
    at = jnp.array([0.3, 1.7, -0.95, 0.25, -1.3, start, dt])
    steps = 1e-6 * jnp.eye(len(at))
    differences = jnp.stack([(numbers(at + step) - numbers(at - step)) / 2e-6 for step in steps], axis=1)
    np.testing.assert_allclose(SLOPES(at), differences, rtol=1e-6, atol=1e-8)


# x' = u under the command -2 of one sample: u stays 0 until the actuator leaves its zone, follows it, and stands still.
START, LEVEL = 0.9, 2.0


def held_once(draw):
    actuator = act.DeadZone(draw.uniform("width", -0.1, 1.0), act.RateLimited(0.0, draw.uniform("rate", 2.5, 9.0)))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 0.1, 0.1))
    made = qj.Implementation(1.0, saturation=LEVEL, actuator=actuator)
    loop = qj.ClosedLoop(Integrator(1.0), qj.references.Constant(0.0), qj.disturbances.Zero(), control, made)
    return qj.Scenario(loop, x0=[START], t1=1.0)


@pytest.fixture(scope="module")
def once():
    """Runs whose input is known in closed form, with metrics and a requirement on it."""
    own = qj.metrics
    metrics = [
        own.Final("end", lambda s: s.x[0]),
        own.Peak("size", lambda s: jnp.abs(s.u)),
        own.Integral("area", lambda s: s.u),
    ]
    study = qj.Study(
        held_once, bandwidth=0.5, metrics=metrics, requirements={"gentle": qj.always(lambda s: 1.6 - jnp.abs(s.u))}
    )
    return qj.monte_carlo(study, 64, block=64)


def test_the_plant_gets_what_the_zone_leaves_and_is_integrated_from_kink_to_kink(once):
    is_good = once["width"] >= 0.0
    width, rate = once["width"][is_good], once["rate"][is_good]
    left = LEVEL - width
    area = -(left**2 / (2.0 * rate) + left * (1.0 - LEVEL / rate))
    energy = left**3 / (3.0 * rate) + left**2 * (1.0 - LEVEL / rate)
    # A cell across a kink would be off by its tolerance, 1e-6 of the funnel.
    for name, truth in {
        "end": START + area,
        "area": area,
        "energy_u": energy,
        "min_u": -left,
        "max_u": 0.0 * left,
        "peak_u": left,
        "size": left,
        "total_variation_u": left,
        "margin_gentle": 1.6 - left,
    }.items():
        np.testing.assert_allclose(once[name][is_good], truth, rtol=1e-12, atol=1e-12, err_msg=name)
    assert np.array_equal(once["verdict_gentle"][is_good] == qj.Verdict.HELD, left < 1.6)


def test_a_drawn_width_that_is_negative_leaves_a_run_without_a_premise(once):
    is_bad = once["width"] < 0.0
    assert 0 < is_bad.sum() < 64
    assert np.array_equal(once["outcome"] == qj.Outcome.BAD_PARAMETERS, is_bad)


def heater(**limits):
    """A heater, x' = u, that can't cool: to follow sin 3 t it would have to."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.2))
    made = qj.Implementation(5e-3, **limits) if limits else None
    reference = qj.references.SumOfSines([1.0], [3.0])
    return qj.ClosedLoop(Integrator(1.0), reference, qj.disturbances.Zero(), control, made)


def test_least_input_tells_that_a_heater_would_have_to_cool():
    """Where sigma/rho turns, u is x_d', from -3 to 3, less what the funnel shrinks by, mu (rho - rho_inf) <= 1."""
    about = {"x0": [0.0], "t1": 4.0, "bandwidth": 0.4}
    free, limited = qj.simulate(heater(), **about), qj.simulate(heater(input_range=(0.0, 40.0)), **about)
    assert free.verdict is qj.Verdict.HELD
    assert -4.0 < float(free.metrics.min_u) < -2.5
    assert 2.5 < float(free.metrics.max_u) < 4.0
    assert float(limited.metrics.min_u) == 0.0
    assert limited.verdict is qj.Verdict.VIOLATED


BAD = {
    "rate": (lambda: act.RateLimited(0.1, 0.0), "`rate` must be positive and finite, but is 0"),
    "negative rate": (lambda: act.RateLimited(0.1, -1.0), "`rate` must be positive and finite, but is -1"),
    "lag": (lambda: act.RateLimited(-0.1, 1.0), "`time_constant` must be finite and not negative, but is -0.1"),
    "travel": (lambda: act.RateLimited(0.1, 1.0, (1.0, 1.0)), "`travel` must have low < high, but is (1, 1)"),
    "turned": (lambda: act.RateLimited(0.1, 1.0, (2.0, 1.0)), "`travel` must have low < high, but is (2, 1)"),
    "zone": (lambda: act.DeadZone(-0.1), "`half_width` must be finite and not negative, but is -0.1"),
}


@pytest.mark.parametrize(("make", "message"), BAD.values(), ids=BAD)
def test_what_is_out_of_range_is_named(make, message):
    with pytest.raises(qj.InputError) as error:
        make()
    assert message in str(error.value)


def test_a_dead_zone_behind_an_actuator_that_swings_is_refused():
    """By whichever check comes first: here that of the annotations."""
    with pytest.raises(Exception, match="AbstractMonotoneActuator"):
        act.DeadZone(0.1, act.SecondOrderLag(9.0))

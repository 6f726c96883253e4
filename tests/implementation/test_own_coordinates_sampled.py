"""Sampled loops of plants in their own coordinates: against SciPy from sample to sample, the chain, closed forms."""

import functools as ft
import math

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate

import qsmc_jax as qj
from own_plants import BANDWIDTH, FUNNEL, PLANTS, WAVE, Pendulum, loop_of

TAU, T1 = 0.02, 3.0


def implemented(loop, made):
    """The loop with an implementation."""
    return qj.ClosedLoop(loop.plant, loop.reference, loop.disturbance, loop.control, made)


@ft.cache
def tank_by_scipy(fault=1.0):
    """The tank under the law of the sample before: states at the samples, the peak of |sigma| / rho between them."""
    _, rates, outputs, (c,), x0, amplitude = PLANTS["tank"]
    rho0, mu, rho_inf = FUNNEL
    width = lambda t: rho0 * np.exp(-mu * t) + rho_inf  # noqa: E731
    sigma = lambda t, x: c * (x[0] - amplitude * np.sin(t)) + x[1] - amplitude * np.cos(t)  # noqa: E731
    x, states, peak, energy = np.asarray(x0), [x0], 0.0, 0.0
    for k in range(round(T1 / TAU)):
        t = k * TAU
        u = -math.tan(0.5 * math.pi * sigma(t, x) / width(t))
        field = lambda s, y, u=u: rates(s, y, fault * u, WAVE[0] * math.sin(WAVE[1] * s))  # noqa: E731
        ts = np.linspace(t, t + TAU, 21)
        solved = scipy.integrate.solve_ivp(field, (t, t + TAU), x, t_eval=ts, rtol=1e-10, atol=1e-12)
        peak = max(peak, np.max(np.abs(sigma(ts, solved.y)) / width(ts)))
        x, energy = solved.y[:, -1], energy + TAU * u * u
        states.append(x)
    return np.array(states), peak, energy


def test_a_held_loop_is_scipys():
    states, peak, energy = tank_by_scipy()
    ts = np.arange(len(states)) * TAU
    loop = implemented(loop_of("tank"), qj.Implementation(TAU))
    run = qj.simulate(loop, PLANTS["tank"][4], T1, bandwidth=BANDWIDTH, ts=np.minimum(ts, T1))
    assert run.verdict is qj.Verdict.HELD
    np.testing.assert_allclose(run.x, states, atol=2e-5)
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, rel=2e-5)
    assert float(run.metrics.energy_u) == pytest.approx(energy, rel=1e-5)


class Pulse(qj.AbstractDisturbance):
    """A push, a hundred thousandth of a second long; a hint of it would save steps."""

    size: float

    def __call__(self, t):
        """About 0.6137 s."""
        return self.size * jnp.exp(-(((t - 0.6137) / 1e-5) ** 2))

    @property
    def bound(self):
        """Its height."""
        return jnp.abs(jnp.asarray(self.size))

    @property
    def break_times(self):
        """None."""
        return jnp.zeros((0,))


class Reservoir(qj.AbstractStateSpace):
    """The disturbance fills a second state, which the output never sees."""

    states, relative_degrees = 2, (1,)

    def vector_field(self, t, x, d):
        """x2 decays in a second."""
        return 0.0 * x[0], -x[1] + d

    def input_matrix(self, t, x):
        """The gain."""
        return 1.0, 0.0

    def output(self, t, x):
        """The first state."""
        return x[0]


def test_a_short_push_on_an_internal_state_is_not_stepped_over_in_a_long_hold():
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.5))
    loop = qj.ClosedLoop(Reservoir(), qj.references.Constant(0.0), Pulse(1e4), control, qj.Implementation(0.5))
    run = qj.simulate(loop, [0.1, 0.0], 1.0, bandwidth=0.8)
    area = 1e4 * 1e-5 * math.sqrt(math.pi)
    assert run.verdict is qj.Verdict.HELD
    assert float(run.x[-1, 1]) == pytest.approx(area * math.exp(-0.3863), rel=1e-3)


class Swinging(qj.AbstractStateSpace):
    """Two states that the output never sees, on a circle."""

    states, relative_degrees = 3, (1,)

    def vector_field(self, t, x, d):
        """20 rad/s."""
        return d, 20.0 * x[2], -20.0 * x[1]

    def input_matrix(self, t, x):
        """The gain."""
        return 1.0, 0.0, 0.0

    def output(self, t, x):
        """The first state."""
        return x[0]


def test_states_that_nobody_sees_are_as_exact_as_the_others():
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 1.0, 0.5))
    loop = qj.ClosedLoop(
        Swinging(), qj.references.Constant(0.0), qj.disturbances.Zero(), control, qj.Implementation(0.5)
    )
    run = qj.simulate(loop, [0.1, 1.0, 0.0], 3.0, bandwidth=0.8)
    np.testing.assert_allclose(run.x[-1, 1:], [math.cos(60.0), -math.sin(60.0)], atol=2e-5)


@pytest.mark.slow
def test_a_chain_in_its_own_coordinates_is_the_chain_with_all_that_an_implementation_has():
    made = qj.Implementation(
        0.01,
        delay=0.004,
        saturation=3.0,
        actuator=qj.actuators.FirstOrderLag(0.01),
        noise=qj.noises.Signals((qj.disturbances.Sine(1e-3, 3.0), qj.disturbances.Sine(2e-3, 5.0))),
        measurement_resolution=[1e-5, 1e-5],
        gain_fault=qj.GainFault(2.0, 3.0, 0.7),
    )
    chain = implemented(qj.paper.example1(), made)
    own = qj.ClosedLoop(Pendulum(), chain.reference, chain.disturbance, chain.control, made)
    one, other = (qj.simulate(loop, [0.9, 0.9], 5.0, bandwidth=0.1) for loop in (own, chain))
    assert one.verdicts == other.verdicts
    np.testing.assert_allclose(one.x, other.x, atol=2e-4)
    np.testing.assert_allclose(one.e, other.e, atol=2e-4)
    assert float(one.metrics.peak_ratio) == pytest.approx(float(other.metrics.peak_ratio), rel=1e-4)


def test_what_does_not_fit_is_named():
    unmatched = qj.Implementation(TAU, unmatched=(qj.disturbances.Zero(),))
    with pytest.raises(
        qj.InputError, match="`unmatched` of the implementation must be left out for a plant in its own"
    ):
        implemented(loop_of("tank"), unmatched)
    coarse = implemented(loop_of("tank"), qj.Implementation(TAU, measurement_resolution=[0.1, 0.1]))
    with pytest.raises(qj.InputError, match="`measurement_resolution` must fit a plant with 3 states, but is for 2"):
        qj.simulate(coarse, PLANTS["tank"][4], T1, bandwidth=BANDWIDTH)

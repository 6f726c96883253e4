"""What a function can hide between the nodes of a step: never less than it does hide, and not much more."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial

import qsmc_jax as qj
from qsmc_jax.model.unseen import gain_range, is_nothing, unseen_in_reference, unseen_in_signal
from qsmc_jax.numerics.unseen import Nodes, Step, unseen

FOUR = Nodes((0.0, 0.5, 0.75, 1.0), few=(0.0, 0.5, 1.0))
SIX = Nodes((0.0, 0.16, 0.33, 0.9, 0.98, 1.0), few=(0.0, 0.33, 1.0))
NODES = pytest.mark.parametrize("nodes", [FOUR, SIX], ids=["4 nodes", "6 nodes"])
THETAS = np.linspace(0.0, 1.0, 4001)


def step_of(start, end, nodes):
    return Step(jnp.asarray(start), jnp.asarray(end), nodes)


def missed_by_polynomial(function, step):
    """By how much the polynomial through the nodes is off, at most."""
    h, places = float(step.length), np.array(step.nodes.places)
    at = lambda theta: np.array([float(function(float(step.t0) + t * h)) for t in np.atleast_1d(theta)])  # noqa: E731
    fit = Polynomial.fit(places, at(places), len(places) - 1, domain=[0.0, 1.0], window=[0.0, 1.0])
    thetas = THETAS[::20]
    return np.max(np.abs(at(thetas) - fit(thetas)))


@NODES
def test_a_polynomial_of_the_order_of_the_nodes_hides_just_its_remainder(nodes):
    """Of t^m, whose m-th derivative is m!, the interpolant through m nodes misses the product of the distances."""
    step, m = Step(0.0, 0.3, nodes), nodes.order
    found = float(step.beyond_polynomial(lambda k: float(math.factorial(k))))
    assert found == pytest.approx(missed_by_polynomial(lambda t: t**m, step), rel=1e-3)


@NODES
def test_a_parabola_rises_above_its_nodes_by_no_more_than_between_the_widest_two(nodes):
    step = Step(1.0, 1.4, nodes)
    places = np.array(nodes.places)
    i = int(np.argmax(np.diff(places)))
    middle = 1.0 + 0.4 * 0.5 * (places[i] + places[i + 1])
    rise = 3.0 * (0.4 * np.diff(places)[i] / 2.0) ** 2  # of -3 (t - middle)^2 above its values at these two
    assert float(step.beyond_chords(6.0)) == pytest.approx(rise, rel=1e-9)
    ts = 1.0 + 0.4 * THETAS
    seen = np.max(-3.0 * (1.0 + 0.4 * places - middle) ** 2)
    assert np.max(-3.0 * (ts - middle) ** 2) - seen == pytest.approx(rise, rel=1e-3)


SIGNALS = {
    "sine": qj.disturbances.Sine(5.0, 30.0, 0.4),
    "negative sine": qj.disturbances.Sine(-5.0, -30.0, 0.4),
    "sum of sines": qj.disturbances.SumOfSines([3.0, -2.0], [30.0, 7.0], [0.1, 1.0]),
    "sum": qj.disturbances.Sine(5.0, 30.0, 0.4) + qj.disturbances.Sine(2.0, 40.0, 1.4),
    "multiple": -3.0 * qj.disturbances.Sine(5.0, 30.0, 0.4),
    "pieces": qj.disturbances.Piecewise([9.0], (qj.disturbances.Sine(5.0, 30.0), qj.disturbances.Sine(1.0, 1.0))),
}


@NODES
@pytest.mark.parametrize("name", SIGNALS)
def test_a_signal_hides_at_least_what_the_polynomial_through_its_nodes_misses(name, nodes):
    for start, length in ((0.0, 0.05), (0.3, 0.02), (0.7, 0.1)):
        step = Step(start, start + length, nodes)
        found = unseen_in_signal(SIGNALS[name], step)
        missed = missed_by_polynomial(SIGNALS[name], step)
        assert missed <= float(found.amount) * (1.0 + 1e-9)
        assert float(found.amount) <= 100.0 * missed


def test_smooth_steps_hide_at_least_what_the_polynomial_misses_in_a_ramp():
    steps = qj.disturbances.SmoothSteps([1.0], [0.0, 4.0], 0.5)
    for start in (1.0, 1.2, 1.4):
        step = Step(start, start + 0.1, FOUR)
        missed = missed_by_polynomial(steps, step)
        assert 0.0 < missed <= float(unseen_in_signal(steps, step).amount) <= 100.0 * missed
    # Of degree 5: six nodes miss nothing.
    assert is_nothing(unseen_in_signal(steps, Step(1.0, 1.1, SIX)).amount)


@NODES
def test_noise_rises_above_its_nodes_by_no_more_than_it_hides(nodes):
    noise = qj.disturbances.BandLimitedNoise([0.7, 0.5], [60.0, 90.0], [0.2, 1.0], 0.8)
    for start in np.arange(0.0, 1.0, 0.05):
        step = Step(start, start + 0.02, nodes)
        values = np.array([float(noise(t)) for t in start + 0.02 * THETAS[::50]])
        seen = np.array([float(noise(start + 0.02 * place)) for place in nodes.places])
        beyond = max(values.max() - seen.max(), seen.min() - values.min())
        assert beyond <= float(unseen_in_signal(noise, step).amount)


@pytest.mark.parametrize("order", [0, 1, 2])
def test_a_reference_hides_at_least_what_the_polynomial_misses_in_each_derivative(order):
    reference = qj.references.SumOfSines([2.0, 0.5], [12.0, 30.0], [0.3, 1.0])
    step = Step(0.2, 0.25, SIX)
    missed = missed_by_polynomial(lambda t: reference.derivatives(t, order)[order], step)
    found = float(unseen_in_reference(reference, order, step).amount)
    assert missed <= found <= 100.0 * missed


def test_what_is_constant_between_its_break_times_hides_nothing():
    step = Step(0.0, 0.5, SIX)
    for signal in (qj.disturbances.Zero(), qj.disturbances.Constant(3.0), qj.disturbances.Telegraph([1.0], [2.0, 3.0])):
        assert is_nothing(unseen_in_signal(signal, step).amount)


def tent(t):
    """Up at 4 from 0.1 on, and down at 1: between nodes at 0 and 0.33 nothing shows that lies between."""
    return jnp.maximum(jnp.minimum(4.0 * (t - 0.1), 0.2 - (t - 0.15)), 0.0)


FUNCTIONS = {
    "bump": lambda t: jnp.exp(-(((t - 0.2) / 0.02) ** 2)),
    "dip": lambda t: 2.0 - 3.0 * jnp.exp(-(((t - 0.6) / 0.01) ** 2)),
    "wave": lambda t: jnp.sin(40.0 * t),
    "window": lambda t: jnp.where((t > 0.4) & (t < 0.41), 3.0, 1.0),
    "tent": tent,
    "slope": lambda t: 5.0 * t + 1.0,
    "table": lambda t: jnp.interp(t, jnp.array([0.0, 0.5, 0.52, 0.54, 1.0]), jnp.array([0.0, 0.0, 2.0, 0.0, 0.0])),
}


@NODES
@pytest.mark.parametrize("name", FUNCTIONS)
def test_a_function_of_time_passes_what_was_seen_by_no_more_than_is_said(name, nodes):
    for start, length in ((0.0, 1.0), (0.05, 0.3)):
        found = unseen(FUNCTIONS[name], step_of(start, start + length, nodes))
        values = np.asarray(FUNCTIONS[name](jnp.asarray(start + length * THETAS)))
        seen = np.asarray(FUNCTIONS[name](jnp.asarray(start + length * np.array(nodes.few))))
        beyond = max(values.max() - seen.max(), seen.min() - values.min(), 0.0)
        assert beyond <= float(found.amount) + 1e-12
        assert float(found.low) <= values.min() + 1e-12
        assert float(found.high) >= values.max() - 1e-12


def test_a_monotone_function_hides_nothing():
    found = unseen(lambda t: jnp.exp(3.0 * t), step_of(0.0, 1.0, SIX))
    assert float(found.amount) == pytest.approx(0.0, abs=1e-9)


def test_a_zigzag_hides_what_its_slopes_allow_between_two_nodes():
    """Up at a and down at b between nodes of equal value and distance d: a b d / (a + b), which is the least bound."""
    up, down, d = 4.0, 1.0, 0.5
    nodes = Nodes((0.0, 1.0), few=(0.0, 1.0))
    found = unseen(lambda t: jnp.minimum(up * t, down * (d - t)), step_of(0.0, d, nodes))
    assert float(found.amount) == pytest.approx(up * down * d / (up + down))
    found = unseen(lambda t: jnp.maximum(-down * t, up * (t - d)), step_of(0.0, d, nodes))
    assert float(found.amount) == pytest.approx(up * down * d / (up + down))


def test_a_constant_is_a_point():
    found = unseen(lambda t: jnp.asarray(-2.0), step_of(0.0, 1.0, SIX))
    assert is_nothing(found.amount)
    assert (float(found.low), float(found.high)) == (-2.0, -2.0)


def test_the_gain_of_the_librarys_plants_stays_in_its_range():
    rng = np.random.default_rng(0)
    for plant in (qj.plants.InvertedPendulum(0.2, 3.0), qj.plants.FourthOrderExample(1.7)):
        low, high = map(float, gain_range(plant))
        states = rng.uniform(-10.0, 10.0, (500, plant.order))
        gains = np.array([float(plant.gain(0.0, tuple(x))) for x in states])
        assert low - 1e-12 <= gains.min() <= 1.01 * low
        assert 0.99 * high <= gains.max() <= high + 1e-12

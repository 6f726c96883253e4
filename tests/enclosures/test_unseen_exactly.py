"""What a function can hide between the nodes of a step, where the least bound is known in closed form."""

import math

import jax.numpy as jnp
import numpy as np
import pytest
from numpy.polynomial import Polynomial

import qsmc_jax as qj
from qsmc_jax.enclosures.unseen import Nodes, Step, unseen
from qsmc_jax.model.unseen import gain_range, unseen_in_signal

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


FUNCTIONS = {
    "bump": lambda t: jnp.exp(-(((t - 0.2) / 0.02) ** 2)),
    "dip": lambda t: 2.0 - 3.0 * jnp.exp(-(((t - 0.6) / 0.01) ** 2)),
    "wave": lambda t: jnp.sin(40.0 * t),
    "window": lambda t: jnp.where((t > 0.4) & (t < 0.41), 3.0, 1.0),
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


def test_a_zigzag_hides_what_its_slopes_allow_between_two_nodes():
    """Up at a and down at b between nodes of equal value and distance d: a b d / (a + b), which is the least bound."""
    up, down, d = 4.0, 1.0, 0.5
    nodes = Nodes((0.0, 1.0), few=(0.0, 1.0))
    found = unseen(lambda t: jnp.minimum(up * t, down * (d - t)), step_of(0.0, d, nodes))
    assert float(found.amount) == pytest.approx(up * down * d / (up + down))
    found = unseen(lambda t: jnp.maximum(-down * t, up * (t - d)), step_of(0.0, d, nodes))
    assert float(found.amount) == pytest.approx(up * down * d / (up + down))


def test_the_gain_of_the_librarys_plants_stays_in_its_range():
    rng = np.random.default_rng(0)
    for plant in (qj.plants.InvertedPendulum(0.2, 3.0), qj.plants.FourthOrderExample(1.7)):
        low, high = map(float, gain_range(plant))
        states = rng.uniform(-10.0, 10.0, (500, plant.order))
        gains = np.array([float(plant.gain(0.0, tuple(x))) for x in states])
        assert low - 1e-12 <= gains.min() <= 1.01 * low
        assert 0.99 * high <= gains.max() <= high + 1e-12

"""Recorded signals: values and derivatives against SciPy's, the bound against a closed form, and what is refused."""

import itertools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.interpolate import CubicSpline, PchipInterpolator, PPoly, interp1d

import qsmc_jax as qj
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.enclosures.unseen import Nodes, Step
from qsmc_jax.model.recording import is_recorded
from qsmc_jax.model.unseen import unseen_in_reference, unseen_in_signal

GENERATOR = np.random.default_rng(5)
EVEN = np.linspace(0.0, 3.0, 31)
UNEVEN = np.sort(np.r_[0.0, GENERATOR.uniform(0.1, 2.9, 29), 3.0])
VALUES = GENERATOR.normal(size=31)
KINDS = ("hold", "linear", "pchip", "cubic")
each_kind = pytest.mark.parametrize("kind", KINDS)


def by_scipy(times, values, kind):
    """Value and three derivatives, as functions of times within the record."""
    if kind == "hold":
        return [interp1d(times, values, kind="previous"), *[np.zeros_like] * 3]
    if kind == "linear":
        made = PPoly([np.diff(values) / np.diff(times), values[:-1]], times)
    else:
        made = {"pchip": PchipInterpolator, "cubic": CubicSpline}[kind](times, values)
    return [lambda t, k=k: made(t, nu=k) for k in range(4)]


@eqx.filter_jit
def all_derivatives(recording, ts):
    return jax.vmap(lambda t: jnp.stack([jnp.asarray(v, float) for v in recording.derivatives(t, 3)]))(ts)


@each_kind
@pytest.mark.parametrize("times", [EVEN, UNEVEN], ids=["even", "uneven"])
def test_values_and_derivatives_are_those_of_scipy(kind, times):
    recording = qj.Recording(times, VALUES, kind)
    ts = np.linspace(0.0, 3.0, 5003)[:-1]
    with in_64_bits():
        found = np.asarray(all_derivatives(recording, ts))
    assert recording.is_even == (times is EVEN)
    for k, truth in enumerate(by_scipy(times, VALUES, kind)):
        np.testing.assert_allclose(found[:, k], truth(ts), rtol=1e-9, atol=1e-9 * np.max(np.abs(truth(ts)) + 1.0))


@pytest.mark.parametrize("step", [0.1, 1e-3, 1.0 / 3.0, 0.017])
@pytest.mark.parametrize("made", [lambda n, h: h * np.arange(n), lambda n, h: np.cumsum(np.full(n, h)) - h])
def test_each_sample_rules_from_its_time_on_to_the_last_digit(made, step):
    times = made(4000, step)
    recording = qj.Recording(times, np.arange(4000.0), "hold")
    assert recording.is_even
    with in_64_bits():
        at, before = (all_derivatives(recording, ts)[:, 0] for ts in (times, np.nextafter(times[1:], -np.inf)))
    assert np.array_equal(at, np.arange(4000.0))
    assert np.array_equal(before, np.arange(3999.0))


def test_a_clock_that_jitters_is_still_a_grid():
    times = np.arange(1000.0) + np.r_[0.0, GENERATOR.uniform(-0.24, 0.24, 998), 0.0]
    recording = qj.Recording(times, np.arange(1000.0), "hold")
    assert recording.is_even
    with in_64_bits():
        ts = GENERATOR.uniform(0.0, recording.end, 5000)
        found = all_derivatives(recording, ts)[:, 0]
    assert np.array_equal(found, np.searchsorted(recording.times, ts, side="right") - 1.0)


@each_kind
def test_the_bound_is_reached_and_never_passed(kind):
    recording = qj.Recording(UNEVEN, VALUES, kind)
    ts = np.sort(np.r_[np.linspace(0.0, 3.0, 200_001), UNEVEN])
    reached = float(np.max(np.abs(by_scipy(UNEVEN, VALUES, kind)[0](ts[ts < 3.0]))))
    with in_64_bits():
        bound = float(qj.disturbances.Recorded(recording).bound)
    assert reached <= bound * (1.0 + 1e-12)
    assert bound <= max(reached, abs(VALUES[-1])) * (1.0 + 1e-6)


def test_a_spline_through_a_parabola_turns_where_the_parabola_does():
    """Both are largest at t = 2, between samples."""
    times = np.array([0.0, 1.0, 3.0, 4.0])
    with in_64_bits():
        for values, largest in ((times * (4.0 - times), 4.0), (2.0 * times * (times - 4.0) + 1.0, 7.0)):
            assert float(qj.Recording(times, values, "cubic").bound) == pytest.approx(largest, rel=1e-12)


@each_kind
def test_between_samples_the_stages_show_all_there_is(kind):
    recording = qj.Recording(EVEN, VALUES, kind)
    step = lambda *places: Step(0.1, 0.2, Nodes(places, few=(0.0, 1.0)))  # noqa: E731
    assert unseen_in_signal(qj.disturbances.Recorded(recording), step(0.0, 0.5, 0.75, 1.0)).amount == 0.0
    with in_64_bits():
        for order in range(3):
            said = float(unseen_in_reference(qj.references.Recorded(recording), order, step(0.0, 1.0)).amount)
            truth = by_scipy(EVEN, VALUES, kind)[order]
            for a, b in zip(EVEN[:-1], EVEN[1:], strict=True):
                ts = np.linspace(a, np.nextafter(b, a), 100)
                line = np.interp(ts, ts[[0, -1]], truth(ts[[0, -1]]))
                assert np.max(np.abs(truth(ts) - line)) <= said * (1.0 + 1e-9) + 1e-6


def test_beyond_the_record_it_is_nan_or_holds_as_it_was_told():
    with in_64_bits():
        for kind in KINDS:
            refuses, holds = (qj.Recording(EVEN + 1.0, VALUES, kind, beyond) for beyond in ("refuse", "hold"))
            found = np.asarray(all_derivatives(refuses, np.array([0.9, 4.1])))
            assert np.all(np.isnan(found))
            assert float(refuses(4.0 + 1e-13)) == pytest.approx(VALUES[-1])
            found = np.asarray(all_derivatives(holds, np.array([0.0, 0.9, 4.0, 4.1, 1e6])))
            assert found[:, 0].tolist() == [*VALUES[[0, 0, -1, -1, -1]]]
            assert not np.any(found[:, 1:])


@pytest.mark.parametrize(("beyond", "late"), [("refuse", False), ("hold", True)])
def test_a_recording_knows_what_it_covers(beyond, late):
    recordings = [qj.Recording([0.0, end], [1.0, 2.0], "linear", beyond) for end in (3.0, 2.0)]
    with in_64_bits():
        asked = jax.vmap(lambda t1: is_recorded((recordings, 1.0), t1))
        assert asked(np.array([1.0, 2.0, 2.0 + 1e-13, 2.5, 4.0])).tolist() == [True, True, True, late, late]


def test_held_and_joined_values_have_gradients_in_both_modes():
    weights = np.zeros(31)
    weights[[3, 4]] = 0.25, 0.75
    value = lambda values: qj.Recording(EVEN, values, "linear")(0.375)  # noqa: E731
    with in_64_bits():
        for mode in (jax.grad, jax.jacfwd):
            np.testing.assert_allclose(mode(value)(jnp.asarray(VALUES)), weights, atol=1e-12)
        held = jax.grad(lambda values: qj.Recording(EVEN, values, "hold")(0.375))(jnp.asarray(VALUES))
    assert held.tolist() == [float(i == 3) for i in range(31)]


REFUSED = {
    "one sample": (dict(times=[0.0], values=[1.0]), r"`times` must be a list of at least two"),
    "shapes": (dict(values=[1.0, 2.0]), r"`values` must have shape \(3,\)"),
    "nan": (dict(values=[1.0, math.nan, 2.0]), r"`values` must be finite"),
    "infinite time": (dict(times=[0.0, 1.0, math.inf]), r"`times` must be finite"),
    "unsorted": (dict(times=[0.0, 2.0, 1.0]), r"`times` must be increasing, but entry 2 is 1 after 2"),
    "repeated": (dict(times=[0.0, 1.0, 1.0]), r"`times` must be increasing, but entry 2 is 1 after 1"),
    "the same but for rounding": (dict(times=[0.0, 0.3, 0.1 + 0.2]), r"`times` must be increasing"),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_no_recording_is_refused(name):
    changed, message = REFUSED[name]
    with pytest.raises(qj.InputError, match=message):
        qj.Recording(**{"times": [0.0, 1.0, 2.0], "values": [1.0, 2.0, 3.0], **changed})


def test_smooth_kinds_of_traced_values_are_refused():
    with pytest.raises(qj.InputError, match=r'`kind` must be "hold" or "linear" for values that are traced'):
        jax.grad(lambda values: qj.Recording(EVEN, values, "cubic")(0.5))(jnp.asarray(VALUES))


def loop(order, kind, beyond="refuse"):
    plant = type("Mine", (qj.AbstractPlant,), dict(order=order, drift=lambda s, t, x: 0.0, gain=lambda s, t, x: 1.0))()
    control = qj.QuasiSlidingControl(qj.SlidingSurface.binomial(2.0, order), qj.Funnel(4.0, 3.0, 0.05))
    reference = qj.references.Recorded(qj.Recording(EVEN, VALUES, kind, beyond))
    return qj.ClosedLoop(plant, reference, qj.disturbances.Zero(), control)


@each_kind
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_a_reference_has_as_many_continuous_derivatives_as_the_errors_need(order, kind):
    jumps = []
    for truth in by_scipy(EVEN, VALUES, kind)[:order]:
        inner = EVEN[1:-1]
        jumps.append(np.max(np.abs(truth(inner + 1e-11) - truth(inner - 1e-11))) > 1e-4)
    if not any(jumps) and order < 4:
        assert loop(order, kind).order == order
        return
    with pytest.raises(
        qj.InputError, match=rf"must have {order - 1} continuous derivatives for a plant of order {order}"
    ):
        loop(order, kind)


def test_a_reference_that_begins_to_hold_kinks_there():
    assert loop(1, "cubic", "hold").order == 1
    with pytest.raises(qj.InputError, match=r'`reference` must have 1 .*Give `kind="pchip"` and `beyond="refuse"`'):
        loop(2, "pchip", "hold")


@each_kind
def test_a_piece_is_the_signal_until_the_next_sample(kind):
    times = np.array([0.0, 0.3, 0.4, 1.0, 1.7])
    signal = qj.Recording(times, [0.0, 2.0, -1.0, 0.5, 0.7], kind)
    with in_64_bits():
        for a, b in itertools.pairwise(times):
            piece = signal.piece(0.5 * (a + b))
            for part in (0.01, 0.4, 0.99):
                t = a + part * (b - a)
                assert float(piece(t)) == pytest.approx(float(signal(t)), rel=1e-12)

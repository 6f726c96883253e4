"""Disturbances: values against closed forms, the bound, and completeness of the break times."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate, stats

from fake_draw import FakeDraw
from qsmc_jax.model import disturbances as qd
from qsmc_jax.model.recording import Recording

PI = math.pi
ROUNDING = 1e-12


BUILDERS = {
    "sine": lambda draw: qd.random_sine(draw, "d", 0.7),
    "sines": lambda draw: qd.random_sines(draw, "d", 0.7),
    "telegraph": lambda draw: qd.random_telegraph(draw, "d", 0.7, rate=0.5, horizon=10.0),
    "steps": lambda draw: qd.random_steps(draw, "d", 0.7, steps=4, horizon=10.0, rise_time=3.0),
    "noise": lambda draw: qd.random_noise(draw, "d", 0.7, cutoff=8.0),
}
each_random = pytest.mark.parametrize("build", BUILDERS.values(), ids=BUILDERS)
seeds = st.integers(0, 2**32 - 1)


@eqx.filter_jit
def values(disturbance, ts):
    return jax.vmap(disturbance)(ts)


def example_2():
    return qd.Piecewise(
        [6.0, 9.0], (qd.Sine(0.5, PI / 2), qd.Sine(1.0, PI), qd.Sine(1.0, PI, PI / 2) + qd.Constant(-1.0))
    )


def telegraph():
    return qd.Telegraph([1.0, 2.5, math.inf], [0.5, -1.0, 0.25, 9.0])


def steps(rise_time=0.4):
    return qd.SmoothSteps([1.0, 2.0], [0.0, 1.0, -2.0], rise_time)


def noise():
    return qd.BandLimitedNoise([1.0, 2.0], [1.0, 3.0], [0.0, 1.0], 0.5)


ALL = {
    "zero": qd.Zero(),
    "constant": qd.Constant(-2.0),
    "sine": qd.Sine(-0.5, 3.0, 1.0),
    "sum_of_sines": qd.SumOfSines([1.0, -0.5], [1.0, 7.0]),
    "piecewise": example_2(),
    "nested_piecewise": qd.Piecewise([4.0], (telegraph(), steps())),
    "telegraph": telegraph(),
    "steps": steps(),
    "overlapping_steps": steps(rise_time=3.0),
    "noise": noise(),
    "sum": telegraph() + steps() - qd.Sine(1.0, 2.0),
    "scaled": -3.0 * telegraph(),
    "held": qd.Recorded(Recording([0.0, 1.0, 2.5, 20.0], [0.5, -1.0, 0.25, 0.0], "hold", "hold")),
    "spline": qd.Recorded(Recording([0.0, 1.0, 2.5, 20.0], [0.5, -1.0, 0.25, 0.0], "cubic", "hold")),
}
each = pytest.mark.parametrize("disturbance", ALL.values(), ids=ALL)


# Values


def test_sine_and_sum_of_sines_match_their_formula():
    ts = np.linspace(0.0, 20.0, 101)
    np.testing.assert_allclose(values(qd.Sine(2.0, 3.0, 0.5), ts), 2 * np.sin(3 * ts + 0.5), atol=1e-14)
    sines = qd.SumOfSines([1.0, -2.0], [0.5, 4.0], [0.1, 0.2])
    np.testing.assert_allclose(values(sines, ts), np.sin(0.5 * ts + 0.1) - 2 * np.sin(4 * ts + 0.2), atol=1e-13)


def test_phases_of_a_sum_of_sines_are_zero_by_default():
    assert qd.SumOfSines([1.0, 1.0], [1.0, 2.0])(0.0) == 0.0


def test_zero_and_constant_do_not_depend_on_time():
    assert qd.Zero()(3.0) == 0.0
    assert qd.Constant(-2.0)(3.0) == -2.0


def test_example_2_of_the_paper_matches_its_formula():
    def formula(t):
        return 0.5 * math.sin(PI * t / 2) if t < 6 else math.sin(PI * t) if t < 9 else math.cos(PI * t) - 1

    ts = np.linspace(0.0, 20.0, 401)
    np.testing.assert_allclose(values(example_2(), ts), [formula(t) for t in ts], atol=1e-13)


@pytest.mark.parametrize("jitted", [False, True], ids=["eager", "jit"])
def test_example_2_jumps_exactly_at_nine(jitted):
    call = eqx.filter_jit(lambda d, t: d(t)) if jitted else lambda d, t: d(t)
    d = example_2()
    assert abs(call(d, np.nextafter(9.0, 0.0))) < 1e-12
    assert call(d, np.float64(9.0)) == pytest.approx(-2.0)
    assert call(d, np.nextafter(9.0, 10.0)) == pytest.approx(-2.0)


def test_telegraph_holds_the_following_level_at_a_switch():
    ts = np.array([0.0, np.nextafter(1.0, 0.0), 1.0, np.nextafter(2.5, 0.0), 2.5, 1e9])
    assert values(telegraph(), ts).tolist() == [0.5, 0.5, -1.0, -1.0, 0.25, 0.25]


def test_equal_switching_times_skip_the_level_between():
    d = qd.Telegraph([1.0, 1.0], [0.0, 5.0, 2.0])
    assert [float(d(t)) for t in (0.5, 1.0, 2.0)] == [0.0, 2.0, 2.0]


def test_smooth_steps_hold_their_levels_between_ramps():
    ts = np.array([0.0, 1.0, 1.4, 1.7, 2.0, 2.4, 100.0])
    np.testing.assert_allclose(values(steps(), ts), [0.0, 0.0, 1.0, 1.0, 1.0, -2.0, -2.0], atol=1e-15)


def test_smoothstep_is_the_integral_of_its_known_derivative():
    # S' = 30 s^2 (1 - s)^2 is the only quartic with double zeros at 0 and 1 and unit area.
    d = qd.SmoothSteps([0.0], [0.0, 1.0], 1.0)
    for s in (0.1, 0.5, 0.83):
        area, _ = integrate.quad(lambda x: 30 * x**2 * (1 - x) ** 2, 0.0, s)
        assert float(d(s)) == pytest.approx(area, abs=1e-14)


def test_smooth_steps_have_two_continuous_derivatives_at_their_breaks():
    d = steps()
    ts = np.asarray(d.break_times)
    for derivative in (jax.grad(d), jax.grad(jax.grad(d))):
        jumps = values(derivative, ts + 1e-9) - values(derivative, ts - 1e-9)
        np.testing.assert_allclose(jumps, 0.0, atol=1e-4)


def test_band_limited_noise_is_the_bounded_sum_of_cosines():
    ts = np.linspace(0.0, 10.0, 50)
    unbounded = np.cos(ts) + 2 * np.cos(3 * ts + 1)
    np.testing.assert_allclose(values(noise(), ts), 0.5 * np.tanh(unbounded / 0.5), atol=1e-14)


# Algebra


def test_sums_and_multiples_are_exact():
    a, b, t = telegraph(), steps(), 1.2
    assert float((a + b)(t)) == float(a(t)) + float(b(t))
    assert float((a - b)(t)) == float(a(t)) - float(b(t))
    assert float((-a)(t)) == -float(a(t))
    assert float((3.0 * a)(t)) == float((a * 3.0)(t)) == 3.0 * float(a(t))


@pytest.mark.parametrize("number", [2.0, np.float64(2.0), jnp.asarray(2.0)], ids=["float", "numpy", "jax"])
def test_a_number_combines_from_either_side(number):
    d = qd.Constant(5.0)
    assert float((number * d)(0.0)) == float((d * number)(0.0)) == 10.0
    assert float((number + d)(0.0)) == float((d + number)(0.0)) == 7.0
    assert float((d - number)(0.0)) == 3.0


def test_bounds_of_sums_and_multiples_follow_the_triangle_inequality():
    a, b = qd.Constant(-2.0), qd.Sine(0.5, 1.0)
    assert float((a + b).bound) == 2.5
    assert float((-3.0 * a).bound) == 6.0


def test_bound_of_pieces_is_the_largest():
    assert float(example_2().bound) == 2.0


def test_sums_pieces_and_multiples_keep_all_break_times():
    d = qd.Piecewise([4.0], (telegraph() + steps(), -1.0 * telegraph()))
    assert sorted(d.break_times.tolist()) == [1, 1, 1, 1.4, 2, 2.4, 2.5, 2.5, 4, math.inf, math.inf]


# Bounds and break times, for everything


@each
def test_bound_holds_on_a_fine_grid(disturbance):
    peak = np.max(np.abs(values(disturbance, np.linspace(0.0, 30.0, 20_001))))
    assert peak <= float(disturbance.bound) * (1 + ROUNDING)


@each_random
@settings(max_examples=30, deadline=None)
@given(seed=seeds, ts=st.lists(st.floats(0.0, 1e3), min_size=8, max_size=8))
def test_random_bound_is_never_exceeded(build, seed, ts):
    d = build(FakeDraw(seed))
    assert np.all(np.abs(values(d, np.array(ts))) <= float(d.bound) * (1 + ROUNDING))
    assert float(d.bound) <= 0.7 * (1 + ROUNDING)


@settings(max_examples=50, deadline=None)
@given(
    times=st.lists(st.floats(0.0, 10.0), min_size=5, max_size=5).map(sorted),
    levels=st.lists(st.floats(-5.0, 5.0), min_size=6, max_size=6),
    rise_time=st.floats(1e-3, 100.0),
)
def test_overlapping_ramps_keep_the_bound(times, levels, rise_time):
    d = qd.SmoothSteps(times, levels, rise_time)
    assert np.all(np.abs(values(d, np.linspace(0.0, 110.0, 512))) <= float(d.bound) * (1 + ROUNDING))


@pytest.mark.parametrize("bound", [1e-3, 1e3])
def test_noise_far_above_its_bound_stays_within(bound):
    d = qd.BandLimitedNoise([1e4, 1e4], [1.0, 2.0], [0.0, 0.0], bound)
    assert np.max(np.abs(values(d, np.linspace(0.0, 10.0, 1001)))) <= bound


# Short pieces, because the bounded noise has complex poles close by.
FINE_CUTS = np.arange(0.0, 10.0, 0.25)


def worst_tail(disturbance, cuts, horizon=10.0, degree=48):
    """Largest of the last Chebyshev coefficients of the pieces between cuts: at rounding level if each is analytic."""
    cuts = np.unique(np.clip(np.concatenate([[0.0, horizon], cuts]), 0.0, horizon))
    nodes = np.cos(np.pi * (np.arange(degree + 1) + 0.5) / (degree + 1))
    ts = np.stack([(a + b) / 2 + (b - a) / 2 * nodes for a, b in zip(cuts, cuts[1:], strict=False)])
    pieces = np.asarray(values(disturbance, ts.ravel())).reshape(ts.shape)
    return np.max(np.abs(np.polynomial.chebyshev.chebfit(nodes, pieces.T, degree)[-4:]))


@each
def test_disturbance_is_analytic_between_its_break_times(disturbance):
    assert worst_tail(disturbance, np.concatenate([disturbance.break_times, FINE_CUTS])) < 1e-11


@each_random
@pytest.mark.parametrize("seed", range(3))
def test_random_disturbance_is_analytic_between_its_break_times(build, seed):
    d = build(FakeDraw(seed))
    assert worst_tail(d, np.concatenate([d.break_times, FINE_CUTS])) < 1e-11


@pytest.mark.parametrize("disturbance", [example_2(), telegraph(), steps()], ids=["piecewise", "telegraph", "steps"])
def test_a_missing_break_time_would_be_noticed(disturbance):
    assert worst_tail(disturbance, np.asarray(disturbance.break_times)[1:]) > 1e-7


# Transformations


@each
def test_vmap_equals_a_loop(disturbance):
    ts = np.array([0.0, 1.0, 1.2, 2.5, 6.0, 9.0, 12.0])
    np.testing.assert_allclose(values(disturbance, ts), [float(disturbance(t)) for t in ts], rtol=0, atol=1e-14)


@each
def test_gradients_are_finite_even_at_break_times(disturbance):
    def total(parts, ts):
        return jnp.sum(jax.vmap(parts)(ts)) + parts.bound

    numbers = jax.tree.map(jnp.asarray, disturbance)
    ts = jnp.asarray([0.0, 1.0, 1.4, 2.0, 2.4, 2.5, 6.0, 9.0, 9.5])
    gradients = eqx.filter_jit(eqx.filter_grad(total))(numbers, ts)
    times = values(jax.grad(disturbance), ts)
    assert all(bool(jnp.all(jnp.isfinite(leaf))) for leaf in [times, *jax.tree.leaves(gradients)])


def test_a_batch_is_built_by_vmap_over_the_constructor():
    batch = eqx.filter_vmap(lambda a: qd.Sine(a, 2.0) + qd.Telegraph([1.0], [a, 2 * a]))(jnp.asarray([1.0, 3.0]))
    result = eqx.filter_vmap(lambda d: d(1.5))(batch)
    np.testing.assert_allclose(result, [math.sin(3.0) + 2.0, 3 * math.sin(3.0) + 6.0], atol=1e-14)


# Random ones


@each_random
def test_the_same_draw_gives_the_same_disturbance(build):
    assert bool(eqx.tree_equal(build(FakeDraw(3)), build(FakeDraw(3))))


@pytest.mark.parametrize(
    ("kind", "names"),
    [
        ("sine", ["d.amplitude", "d.frequency", "d.phase"]),
        ("sines", ["d.amplitude", "d.frequency", "d.phase"]),
        ("telegraph", ["d.holding_time", "d.level"]),
        ("steps", ["d.time", "d.level"]),
        ("noise", ["d.frequency", "d.phase"]),
    ],
)
def test_drawn_numbers_carry_the_given_name(kind, names):
    draw = FakeDraw()
    BUILDERS[kind](draw)
    assert draw.names == names


@each_random
def test_a_traced_bound_passes(build):
    bounds = {
        "sine": lambda b: qd.random_sine(FakeDraw(), "d", b),
        "sines": lambda b: qd.random_sines(FakeDraw(), "d", b),
        "telegraph": lambda b: qd.random_telegraph(FakeDraw(), "d", b, 0.5, 10.0),
        "steps": lambda b: qd.random_steps(FakeDraw(), "d", b, 4, 10.0, 3.0),
        "noise": lambda b: qd.random_noise(FakeDraw(), "d", b, 8.0),
    }
    kind = next(key for key, value in BUILDERS.items() if value is build)
    traced = jax.jit(lambda b: bounds[kind](b)(3.3))(jnp.asarray(0.7))
    assert float(traced) == pytest.approx(float(build(FakeDraw())(3.3)), abs=1e-14)


def test_amplitudes_of_random_sines_are_a_partition_of_the_bound():
    d = qd.random_sines(FakeDraw(), "d", 0.5, terms=8, frequencies=(0.2, 3.0))
    assert np.all(np.asarray(d.amplitudes) >= 0)
    assert np.sum(d.amplitudes) == pytest.approx(0.5)
    assert np.all((np.asarray(d.frequencies) >= 0.2) & (np.asarray(d.frequencies) <= 3.0))


@pytest.mark.parametrize("mean", [0.01, 1.0, 30.0, 1000.0])
def test_random_telegraph_has_just_enough_switches(mean):
    switches = np.size(qd.random_telegraph(FakeDraw(), "d", 1.0, rate=mean / 10, horizon=10.0).switch_times)
    assert stats.poisson.sf(switches, mean) < 1e-12 <= stats.poisson.sf(switches - 1, mean)


def test_random_telegraph_switches_at_its_rate():
    # n = 2000 holding times of mean 0.5: 5 sigma is 5 * 0.5 / sqrt(2000).
    times = np.asarray(qd.random_telegraph(FakeDraw(), "d", 1.0, rate=2.0, horizon=900.0).switch_times)[:2000]
    assert times[-1] / 2000 == pytest.approx(0.5, abs=5 * 0.5 / math.sqrt(2000))


def test_random_steps_start_one_in_each_part_of_the_horizon():
    d = qd.random_steps(FakeDraw(), "d", 1.0, steps=5, horizon=10.0, rise_time=0.1)
    assert np.floor(np.asarray(d.times) / 2.0).tolist() == [0, 1, 2, 3, 4]


def test_random_noise_has_the_asked_power_within_the_asked_band():
    d = qd.random_noise(FakeDraw(), "d", 1e3, cutoff=6.0, rms=0.25)
    ts = np.linspace(0.0, 2000.0, 40_000)
    assert np.std(values(d, ts)) == pytest.approx(0.25, rel=0.02)
    assert np.all((np.asarray(d.frequencies) >= 0) & (np.asarray(d.frequencies) <= 6.0))


def test_random_noise_has_an_rms_of_a_third_of_the_bound_by_default():
    d = qd.random_noise(FakeDraw(), "d", 0.9, cutoff=6.0)
    assert math.sqrt(np.sum(np.asarray(d.amplitudes) ** 2) / 2) == pytest.approx(0.3)


# Refusals

REFUSED = {
    "unsorted times": (lambda: qd.Piecewise([2.0, 1.0], (qd.Zero(),) * 3), "`times` must be sorted"),
    "nan times": (lambda: qd.Telegraph([math.nan], [0.0, 1.0]), "`switch_times` must be sorted"),
    "too few pieces": (lambda: qd.Piecewise([1.0, 2.0], (qd.Zero(),) * 2), "`pieces` must have 3 entries"),
    "piece is a number": (lambda: qd.Piecewise([1.0], (qd.Zero(), 1.0)), "`pieces` must hold disturbances"),
    "empty sum": (lambda: qd.Sum(()), "`terms` must hold disturbances"),
    "too many levels": (lambda: qd.Telegraph([1.0], [0.0, 1.0, 2.0]), "`levels` must have 2 entries"),
    "infinite level": (lambda: qd.Telegraph([1.0], [0.0, math.inf]), "`levels` must be finite"),
    "padded ramps": (lambda: qd.SmoothSteps([math.inf], [0.0, 1.0], 1.0), "`times` must be finite"),
    "no rise time": (lambda: qd.SmoothSteps([1.0], [0.0, 1.0], 0.0), "`rise_time` must be positive"),
    "unequal lengths": (lambda: qd.SumOfSines([1.0], [1.0, 2.0]), "`frequencies` must have shape"),
    "scalar amplitudes": (lambda: qd.SumOfSines(1.0, 1.0), "`amplitudes` .* must be a one-dimensional list"),
    "infinite amplitude": (lambda: qd.Sine(math.inf, 1.0), "`amplitude` must be finite"),
    "undefined scale": (lambda: math.nan * qd.Zero(), "`scale` must be finite"),
    "infinite constant": (lambda: qd.Constant(math.inf), "`value` must be finite"),
    "noise without bound": (lambda: qd.BandLimitedNoise([1.0], [1.0], [0.0], 0.0), "`bound` must be positive"),
    "zero bound, sine": (lambda: qd.random_sine(FakeDraw(), "d", 0.0), "`bound` must be positive"),
    "zero bound, sines": (lambda: qd.random_sines(FakeDraw(), "d", 0.0), "`bound` must be positive"),
    "zero bound, telegraph": (lambda: qd.random_telegraph(FakeDraw(), "d", 0.0, 1.0, 1.0), "`bound` must be positive"),
    "zero bound, steps": (lambda: qd.random_steps(FakeDraw(), "d", 0.0, 1, 1.0, 1.0), "`bound` must be positive"),
    "zero bound, noise": (lambda: qd.random_noise(FakeDraw(), "d", 0.0, 1.0), "`bound` must be positive"),
    "no terms": (lambda: qd.random_sines(FakeDraw(), "d", 1.0, terms=0), "`terms` must be at least 1, but is 0"),
    "no noise terms": (lambda: qd.random_noise(FakeDraw(), "d", 1.0, 1.0, terms=0), "`terms` must be at least 1"),
    "no steps": (lambda: qd.random_steps(FakeDraw(), "d", 1.0, 0, 1.0, 1.0), "`steps` must be at least 1"),
    "reversed band": (lambda: qd.random_sine(FakeDraw(), "d", 1.0, (2.0, 1.0)), "`frequencies` must be"),
    "point band": (lambda: qd.random_sines(FakeDraw(), "d", 1.0, frequencies=(1.0, 1.0)), "`frequencies` must be"),
    "zero rate": (lambda: qd.random_telegraph(FakeDraw(), "d", 1.0, 0.0, 1.0), "`rate` must be positive"),
    "zero horizon": (lambda: qd.random_telegraph(FakeDraw(), "d", 1.0, 1.0, 0.0), "`horizon` must be positive"),
    "no horizon": (lambda: qd.random_steps(FakeDraw(), "d", 1.0, 1, 0.0, 1.0), "`horizon` must be positive"),
    "no ramp": (lambda: qd.random_steps(FakeDraw(), "d", 1.0, 1, 1.0, 0.0), "`rise_time` must be positive"),
    "no band": (lambda: qd.random_noise(FakeDraw(), "d", 1.0, 0.0), "`cutoff` must be positive"),
    "no power": (lambda: qd.random_noise(FakeDraw(), "d", 1.0, 1.0, rms=0.0), "`rms` must be positive"),
    "traced rate": (
        lambda: jax.jit(lambda r: qd.random_telegraph(FakeDraw(), "d", 1.0, r, 1.0).bound)(1.0),
        "`rate` must be a plain number",
    ),
}


@pytest.mark.parametrize(("call", "message"), REFUSED.values(), ids=REFUSED)
def test_a_wrong_argument_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()

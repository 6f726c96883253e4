"""The controllers to compare with: their laws, their memory, their accuracy when sampled, and how they are tuned."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest

import qsmc_jax as qj
from qsmc_jax.base.precision import enable_x64
from qsmc_jax.control.control import Sample

qc = qj.controllers
SURFACE, FUNNEL = qj.SlidingSurface([2.0]), qj.Funnel(4.0, 3.0, 0.05)
CONTROL = qj.QuasiSlidingControl(SURFACE, FUNNEL)
RHO, RHO_INF, PERIOD, DESIRED = 0.8, 0.05, 1e-3, (0.1, -0.2, 0.7)

# Every controller, and its law written anew: u(sigma) before the sign of the gain, with its memory at 0.3.
LAWS = {
    "sign": (lambda s: qc.Sign(SURFACE, FUNNEL, 2.5, s), lambda x: -2.5 * np.sign(x)),
    "boundary layer": (
        lambda s: qc.BoundaryLayer(SURFACE, FUNNEL, 2.5, 0.5, s),
        lambda x: -2.5 * (x / 0.5 if abs(x) < 0.5 else np.copysign(1.0, x)),
    ),
    "super-twisting": (
        lambda s: qc.SuperTwisting(SURFACE, FUNNEL, 1.7, 3.1, s),
        lambda x: -1.7 * abs(x) ** 0.5 * np.sign(x) + 0.3,
    ),
    "prescribed performance": (
        lambda s: qc.PrescribedPerformance(SURFACE, FUNNEL, 1.3, s),
        lambda x: -1.3 * np.log((1.0 + x / RHO) / (1.0 - x / RHO)),
    ),
    "funnel": (
        lambda s: qc.FunnelControl(SURFACE, FUNNEL, 1.3, s),
        lambda x: -1.3 * (x / RHO) / (1.0 - (x / RHO) ** 2),
    ),
    "proportional-derivative": (
        lambda s: qc.ProportionalDerivative(SURFACE, FUNNEL, 4.0, 0.9, s),
        lambda x: 0.9 * DESIRED[2] - 4.0 * x,
    ),
}
each_law = pytest.mark.parametrize(("make", "law"), LAWS.values(), ids=LAWS)
BARRIERS = {"prescribed performance": qc.PrescribedPerformance, "funnel": qc.FunnelControl}
each_barrier = pytest.mark.parametrize("kind", BARRIERS.values(), ids=BARRIERS)
# Those with the same slope as `CONTROL`.
EQUAL = {
    "boundary layer": lambda control: qc.BoundaryLayer.with_equal_slope(control, 7.0),
    "prescribed performance": qc.PrescribedPerformance.with_equal_slope,
    "funnel": qc.FunnelControl.with_equal_slope,
    "proportional-derivative": qc.ProportionalDerivative.with_equal_slope,
}


def memory_of(control, v):
    return tuple(v for _ in control.first_memory())


def input_of(control, sigma, rho=RHO, beyond="saturate", desired=DESIRED, v=0.0):
    """The command at a sliding variable."""
    sample = Sample(0.0, PERIOD, sigma, rho, desired, beyond)
    return control.command(sample, memory_of(control, v))[0]


def sampled_loop(control, period, gain, horizon, integral, sigma=1.0):
    """The samples of sigma' = w(t) + g u with u held: an exact step each, from the integral of w."""
    step = jax.jit(lambda sigma, memory: control.command(Sample(0.0, period, sigma, 9.0, (0.0, 0.0)), memory))
    times = period * np.arange(round(horizon / period) + 1)
    memory, sigmas = control.first_memory(), []
    for push in np.diff(integral(times)):
        sigmas.append(sigma)
        u, memory = step(sigma, memory)
        sigma = sigma + push + gain * period * float(u)
    return np.array(sigmas)


def rest(sigmas):
    """|sigma| in the last third of a run."""
    return np.abs(sigmas[2 * len(sigmas) // 3 :])


def sine_loop(control, period, gain=1.0, horizon=6.0):
    """Under w = 2 sin t, which with its rate is bounded by 2."""
    return sampled_loop(control, period, gain, horizon, lambda t: -2.0 * np.cos(t))


@each_law
@pytest.mark.parametrize("gain_sign", [1.0, -1.0])
@pytest.mark.parametrize("sigma", [-0.79, -0.6, -1e-3, 0.0, 0.2, 0.45, 0.7])
def test_each_law_is_its_formula(make, law, gain_sign, sigma):
    mirrored = gain_sign * law(sigma) if make(1.0).first_memory() == () else 0.3 + gain_sign * (law(sigma) - 0.3)
    u = input_of(make(gain_sign), sigma, v=0.3)
    np.testing.assert_allclose(u, mirrored, rtol=1e-14, atol=1e-15)


@each_law
def test_the_laws_are_odd_without_memory_and_feedforward(make, law):
    for sigma in (1e-9, 0.3, 0.79, 1.2):
        left, right = (input_of(make(1.0), x, desired=(0.0, 0.0, 0.0)) for x in (-sigma, sigma))
        assert left == -right


@each_law
def test_the_laws_never_rise_inside(make, law):
    u = jax.vmap(lambda sigma: input_of(make(1.0), sigma))(np.linspace(-RHO, RHO, 1001)[1:-1])
    assert np.all(np.diff(u) <= 0.0)


@each_barrier
@pytest.mark.parametrize("gap", [1e-3, 1e-6, 1e-8])
def test_the_barriers_are_accurate_near_the_edge(kind, gap):
    sigma = RHO - gap
    with mp.workdps(50):
        z = mp.mpf(sigma) / mp.mpf(RHO)
        truth = -mp.log((1 + z) / (1 - z)) if kind is qc.PrescribedPerformance else -z / (1 - z**2)
    # The ratio sigma / rho is rounded: that costs the logarithm digits, which the distances to the edges do not.
    rtol = 4e-16 / gap if kind is qc.PrescribedPerformance else 1e-15
    np.testing.assert_allclose(input_of(kind(SURFACE, FUNNEL, 1.0), sigma), float(truth), rtol=max(rtol, 1e-15))


@each_barrier
@pytest.mark.parametrize("sigma", [0.8, -0.8, 0.8 * (1.0 + 1e-12), 3.0, -np.inf])
def test_outside_the_funnel_a_barrier_holds_what_it_has_just_inside(kind, sigma):
    control = kind(SURFACE, FUNNEL, 2.0)
    inside = input_of(control, np.copysign((1.0 - 1e-9) * RHO, sigma))
    assert input_of(control, sigma) == inside
    held = np.log((2.0 - 1e-9) / 1e-9) if kind is qc.PrescribedPerformance else 0.5e9
    np.testing.assert_allclose(inside, -np.copysign(2.0 * held, sigma), rtol=1e-7)


@each_barrier
def test_a_barrier_is_continuous_at_the_edge(kind):
    edge = (1.0 - 1e-9) * RHO
    control = kind(SURFACE, FUNNEL, 1.0)
    step = abs(input_of(control, edge) - input_of(control, edge * (1.0 - 1e-13)))
    assert step <= 2e-4 * abs(input_of(control, edge))


def test_wrapped_prescribed_performance_has_no_value_outside():
    control = qc.PrescribedPerformance(SURFACE, FUNNEL, 1.0)
    assert np.isnan(input_of(control, 0.9, beyond="wrap"))
    assert np.isnan(input_of(control, -0.9, beyond="wrap"))
    np.testing.assert_allclose(input_of(control, 0.4, beyond="wrap"), -np.log(3.0), rtol=1e-14)


def test_wrapped_funnel_control_has_the_wrong_sign_outside():
    control = qc.FunnelControl(SURFACE, FUNNEL, 1.0)
    np.testing.assert_allclose(input_of(control, 1.6, beyond="wrap"), 2.0 / 3.0, rtol=1e-14)
    np.testing.assert_allclose(input_of(control, 0.4, beyond="wrap"), -2.0 / 3.0, rtol=1e-14)


@pytest.mark.parametrize("name", ["sign", "boundary layer", "super-twisting", "proportional-derivative"])
@pytest.mark.parametrize("beyond", ["saturate", "wrap"])
def test_the_others_go_on_outside(name, beyond):
    make, law = LAWS[name]
    np.testing.assert_allclose(input_of(make(1.0), 5.0, beyond=beyond, v=0.3), law(5.0), rtol=1e-14)


@each_law
def test_only_super_twisting_keeps_a_memory(make, law):
    control = make(1.0)
    memory = control.command(Sample(0.0, PERIOD, 0.1, RHO, DESIRED), memory_of(control, 0.0))[1]
    assert len(memory) == len(control.first_memory()) == isinstance(control, qc.SuperTwisting)


@pytest.mark.parametrize("gain_sign", [1.0, -1.0])
def test_the_super_twisting_memory_is_an_explicit_sum(gain_sign):
    control = qc.SuperTwisting(SURFACE, FUNNEL, 1.7, 3.1, gain_sign)
    memory, v = control.first_memory(), 0.0
    assert memory[0] == 0.0
    for k, sigma in enumerate([0.3, 0.2, -0.1, 0.0, -0.7, 5.0]):
        period = 0.01 * (1 + k)
        u, memory = control.command(Sample(0.0, period, sigma, RHO, DESIRED), memory)
        np.testing.assert_allclose(u, v - gain_sign * 1.7 * np.sign(sigma) * abs(sigma) ** 0.5, rtol=1e-14)
        v -= gain_sign * 3.1 * period * np.sign(sigma)
        np.testing.assert_allclose(memory[0], v, rtol=1e-14)


def test_sampled_super_twisting_is_accurate_to_second_order():
    control = qc.SuperTwisting.for_rate(CONTROL, 2.0, 1.0)
    periods = np.array([4e-3, 2e-3, 1e-3])
    errors = [rest(sine_loop(control, period)) for period in periods]
    # The ratios are those of means, because the largest value of this irregular motion jumps between 5 and 12 tau^2.
    means = np.array([np.mean(error) for error in errors])
    ratios = means[:-1] / means[1:]
    assert np.all((ratios > 3.3) & (ratios < 4.7)), ratios
    assert np.all([np.max(error) < 15.0 * period**2 for error, period in zip(errors, periods, strict=True)])


def test_sampled_sign_control_is_accurate_to_first_order():
    control = qc.Sign.for_bound(CONTROL, 2.0, 1.0, 1.0)
    errors = [np.max(rest(sine_loop(control, period))) for period in (4e-3, 2e-3, 1e-3)]
    ratios = np.divide(errors[:-1], errors[1:])
    assert np.all((ratios > 1.7) & (ratios < 2.3)), ratios
    assert errors[-1] <= 1e-3 * 5.0  # no step is longer than that of full input with w behind it


def test_super_twisting_agrees_with_a_numpy_simulation():
    control, period, sigma, v = qc.SuperTwisting.for_rate(CONTROL, 2.0, 1.0), 2e-3, 1.0, 0.0
    integral, truth = -2.0 * np.cos(period * np.arange(3001)), []
    for k in range(3000):
        truth.append(sigma)
        u = -1.5 * np.sqrt(2.0) * np.sqrt(abs(sigma)) * np.sign(sigma) + v
        v -= 2.2 * period * np.sign(sigma)
        sigma += integral[k + 1] - integral[k] + period * u
    sigmas = sine_loop(control, period)
    # until it first crosses zero; from then on the root magnifies what is rounded differently
    first = np.flatnonzero(np.array(truth) < 0.0)[0]
    np.testing.assert_allclose(sigmas[:first], truth[:first], atol=1e-12)
    assert np.max(np.abs(truth[2000:])) == pytest.approx(np.max(np.abs(sigmas[2000:])), rel=0.2)


@pytest.mark.parametrize("gain", [1.0 / 64.0, 16.0])
def test_the_loop_of_super_twisting_does_not_depend_on_a_known_gain(gain):
    # Powers of 2, so that no bit differs.
    truth = sine_loop(qc.SuperTwisting.for_rate(CONTROL, 2.0, 1.0), 4e-3)
    np.testing.assert_array_equal(sine_loop(qc.SuperTwisting.for_rate(CONTROL, 2.0, gain), 4e-3, gain), truth)


def triangle_integral(t):
    """The integral of -2, 2, -2 ... at t = 0, 2, 4 ... with straight lines between."""
    phase = np.mod(t, 4.0)
    return np.where(phase < 2.0, phase**2 - 2.0 * phase, 2.0 * (phase - 2.0) - (phase - 2.0) ** 2)


@pytest.mark.parametrize("excess", [1.0, 4.0, 25.0])
def test_super_twisting_overcomes_the_rate_at_every_gain_above_the_least(excess):
    # w is a triangle wave of slope 2 and -2: the fastest change there may be, all the time.
    control, period = qc.SuperTwisting.for_rate(CONTROL, 2.0, 0.01), 4e-3
    error = rest(sampled_loop(control, period, 0.01 * excess, 12.0, triangle_integral))
    # A step of the root turns (g k1 tau / 2)^2 into its negative: the error is of that size.
    assert np.max(error) < 3.0 * (1.5 * np.sqrt(2.0) * excess * period) ** 2


def test_super_twisting_with_too_little_for_the_gain_does_not_come_to_rest():
    # Both gains stand with g: the root of L / g, in place of the root of L over g, is too little where g is small.
    weak = qc.SuperTwisting(SURFACE, FUNNEL, 1.5 * np.sqrt(2.0 / 0.01), 1.1 * 2.0 / 0.01)
    assert np.max(rest(sampled_loop(weak, 4e-3, 0.01, 24.0, triangle_integral))) > 1.0


@pytest.mark.parametrize("gain_sign", [1.0, -1.0])
@pytest.mark.parametrize("make", EQUAL.values(), ids=EQUAL)
def test_equal_slope_is_the_slope_of_the_quasi_sliding_law(make, gain_sign):
    reference = qj.QuasiSlidingControl(SURFACE, FUNNEL, gain_sign)
    control, h = make(reference), 1e-5 * RHO_INF
    slope = (input_of(control, h, RHO_INF) - input_of(control, -h, RHO_INF)) / (2.0 * h)
    np.testing.assert_allclose(slope, -gain_sign * np.pi / (2.0 * RHO_INF), rtol=1e-9)
    assert control.surface is SURFACE
    assert control.funnel is FUNNEL


@each_barrier
def test_the_slope_of_a_barrier_is_equal_at_every_width(kind):
    slope = jax.grad(lambda sigma: input_of(kind.with_equal_slope(CONTROL), sigma, 3.7))(0.0)
    np.testing.assert_allclose(slope, -np.pi / 7.4, rtol=1e-14)


def test_equal_slope_keeps_the_feedforward():
    control = qc.ProportionalDerivative.with_equal_slope(CONTROL, 0.6)
    np.testing.assert_allclose(input_of(control, 0.0), 0.6 * DESIRED[2], rtol=1e-14)


@pytest.mark.parametrize("residual_bound", [0.02, 1.0, 40.0])
def test_equal_accuracy_is_equal_where_the_loops_come_to_rest(residual_bound):
    gain_min, sigmas = 0.5, []
    layer = qc.BoundaryLayer.with_equal_accuracy(CONTROL, 100.0, residual_bound, gain_min)
    for control in (CONTROL, layer):
        low, high = 0.0, RHO_INF
        for _ in range(60):  # bisection for w + g u = 0
            middle = 0.5 * (low + high)
            rises = residual_bound + gain_min * float(input_of(control, middle, RHO_INF)) > 0.0
            low, high = (middle, high) if rises else (low, middle)
        sigmas.append(low)
    np.testing.assert_allclose(sigmas[1], sigmas[0], rtol=1e-11)


def test_the_sign_law_reaches_at_the_rate_asked_for():
    control = qc.Sign.for_bound(CONTROL, 3.0, 0.5, 0.25)
    np.testing.assert_allclose(3.0 + 0.5 * input_of(control, 0.1), -0.25, rtol=1e-14)
    np.testing.assert_allclose(qc.Sign.for_bound(CONTROL, 0.0, 0.5, 0.25).amplitude, 0.5)


def test_the_rules_keep_64_bits_where_jax_has_32():
    with enable_x64(False):
        control = qc.BoundaryLayer.with_equal_accuracy(CONTROL, 9.0, 1.0, 0.5)
    np.testing.assert_allclose(control.width, 9.0 * 2.0 / np.pi * RHO_INF * np.arctan(2.0) / 2.0, rtol=1e-14)


TUNED = {
    "sign": lambda w, g, c: qc.Sign.for_bound(c, w, g, 0.5),
    "boundary layer, slope": lambda w, g, c: qc.BoundaryLayer.with_equal_slope(c, 3.0 * w / g),
    "boundary layer, accuracy": lambda w, g, c: qc.BoundaryLayer.with_equal_accuracy(c, 3.0 * w / g, w, g),
    "super-twisting": lambda w, g, c: qc.SuperTwisting.for_rate(c, w, g),
    "prescribed performance": lambda w, g, c: qc.PrescribedPerformance.with_equal_slope(c),
    "funnel": lambda w, g, c: qc.FunnelControl.with_equal_slope(c),
    "proportional-derivative": lambda w, g, c: qc.ProportionalDerivative.with_equal_slope(c, 1.0 / g),
}


@pytest.mark.parametrize("tuned", TUNED.values(), ids=TUNED)
def test_controllers_can_be_drawn(tuned):
    def value(w, g, rho_inf, sigma):
        control = qj.QuasiSlidingControl(SURFACE, qj.Funnel(4.0, 3.0, rho_inf), jnp.where(g > 0.0, 1.0, -1.0))
        return input_of(tuned(w, g, control), sigma)

    w, g, rho_inf = np.array([0.5, 1.0, 2.0]), np.array([0.4, 0.2, 0.9]), np.array([0.05, 0.1, 0.2])
    for sigma in (0.0, 0.3):
        sigmas = np.full(3, sigma)
        batch = jax.jit(jax.vmap(value))(w, g, rho_inf, sigmas)
        np.testing.assert_allclose(batch, [value(*run) for run in zip(w, g, rho_inf, sigmas, strict=True)], rtol=1e-13)
        slopes = jax.jit(jax.vmap(jax.grad(value, argnums=(0, 1, 2, 3))))(w, g, rho_inf, sigmas)
        assert np.all(np.isfinite(slopes))


@each_law
@pytest.mark.parametrize("sigma", [0.0, 0.8, -2.0])
def test_derivatives_are_finite_on_the_surface_and_outside(make, law, sigma):
    assert np.all(np.isfinite(jax.grad(lambda sigma, rho: input_of(make(1.0), sigma, rho), (0, 1))(sigma, RHO)))


BAD = {
    "amplitude": lambda bad: qc.Sign(SURFACE, FUNNEL, bad),
    "amplitude of the layer": lambda bad: qc.BoundaryLayer(SURFACE, FUNNEL, bad, 1.0),
    "width": lambda bad: qc.BoundaryLayer(SURFACE, FUNNEL, 1.0, bad),
    "k1": lambda bad: qc.SuperTwisting(SURFACE, FUNNEL, bad, 1.0),
    "k2": lambda bad: qc.SuperTwisting(SURFACE, FUNNEL, 1.0, bad),
    "gain": lambda bad: qc.PrescribedPerformance(SURFACE, FUNNEL, bad),
    "gain of funnel control": lambda bad: qc.FunnelControl(SURFACE, FUNNEL, bad),
    "gain of PD": lambda bad: qc.ProportionalDerivative(SURFACE, FUNNEL, bad),
    "reaching_rate": lambda bad: qc.Sign.for_bound(CONTROL, 1.0, 1.0, bad),
    "gain_min": lambda bad: qc.Sign.for_bound(CONTROL, 1.0, bad, 1.0),
    "gain_min of the layer": lambda bad: qc.BoundaryLayer.with_equal_accuracy(CONTROL, 1.0, 1.0, bad),
    "residual_bound of the layer": lambda bad: qc.BoundaryLayer.with_equal_accuracy(CONTROL, 1.0, bad, 1.0),
    "residual_rate": lambda bad: qc.SuperTwisting.for_rate(CONTROL, bad, 1.0),
    "gain_min of super-twisting": lambda bad: qc.SuperTwisting.for_rate(CONTROL, 1.0, bad),
}


@pytest.mark.parametrize(("name", "make"), BAD.items(), ids=BAD)
@pytest.mark.parametrize("bad", [0.0, -1.0, np.inf])
def test_numbers_that_must_be_positive_are_refused_by_name(name, make, bad):
    with pytest.raises(ValueError, match=f"Argument `{name.split()[0]}` must be positive and finite, but is"):
        make(bad)


def test_a_negative_bound_and_an_infinite_feedforward_are_refused_by_name():
    with pytest.raises(ValueError, match="Argument `residual_bound` must be finite and not negative, but is -1"):
        qc.Sign.for_bound(CONTROL, -1.0, 1.0, 1.0)
    with pytest.raises(ValueError, match="Argument `feedforward` must be finite, but is inf"):
        qc.ProportionalDerivative(SURFACE, FUNNEL, 1.0, np.inf)


@pytest.mark.parametrize("amplitude", [1.0, 2.0])
def test_a_layer_too_weak_to_hold_is_refused(amplitude):
    with pytest.raises(ValueError, match="Argument `amplitude` must be above `residual_bound / gain_min` = 2, but is"):
        qc.BoundaryLayer.with_equal_accuracy(CONTROL, amplitude, 1.0, 0.5)


@each_law
@pytest.mark.parametrize("gain_sign", [0.0, 2.0, np.nan])
def test_the_gain_sign_is_one_or_minus_one(make, law, gain_sign):
    with pytest.raises(ValueError, match="Argument `gain_sign` must be 1 or -1, but is"):
        make(gain_sign)

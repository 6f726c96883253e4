"""The reference of the sampled loop against closed forms: what is held constant can be integrated by hand."""

import dataclasses
import math

import numpy as np
import pytest
import scipy.integrate
import scipy.linalg
import scipy.optimize
import scipy.signal

import reference_sampled_loop as ref

TAU, W, G, WIDTH = 0.1, 0.4, 1.5, 0.8
EXACT = {"rel": 1e-9, "abs": 1e-10}
NEAR_EDGE = 1.0 - 1e-9


def table(*commands):
    """A law that plays back what it is given, and then holds the last."""
    return lambda sample, memory: (commands[min(sample.k, len(commands) - 1)], memory)


def scalar(**changes):
    """x' = W + G u regulated to 0 in a funnel that is constant to 1e-12: sigma = x; t_r = ln(.3/.25) 1e12, never."""
    loop = ref.SampledLoop(
        drift=lambda t, x: 0.0 * x[0],
        gain=lambda t, x: G + 0.0 * x[0],
        disturbance=lambda t: W + 0.0 * t,
        desired=lambda t: (0.0, 0.0),
        c=(),
        rho0=0.3,
        mu=1e-12,
        rho_inf=WIDTH - 0.3,
        sample_period=TAU,
    )
    return dataclasses.replace(loop, **changes)


def law(x):
    return -math.tan(0.5 * math.pi * np.clip(x / WIDTH, -NEAR_EDGE, NEAR_EDGE))


def by_hand(x, holds, command, w=W, g=G, begin=0.0):
    """States at the samples and commands of x' = w + g u, the command of sample k a function of k, states, commands."""
    xs, us = [x], []
    for k in range(holds):
        us.append(command(k, xs, us))
        xs.append(xs[-1] + TAU * (w + g * us[-1]))
    return np.array(xs), np.array(us)


# A start from which it swings, and one beyond the funnel, where the law is held at its edge and saturated.
@pytest.mark.parametrize(("x0", "limit"), [(0.5, 2.0), (0.95, 3.0)], ids=["inside", "outside"])
def test_scalar_loop_is_the_recursion(x0, limit):
    xs, us = by_hand(x0, 40, lambda k, xs, us: np.clip(law(xs[-1]), -limit, limit))
    run = ref.simulate(scalar(saturation=limit), [x0], 40 * TAU, 0.75)
    np.testing.assert_allclose(run.commands, us, rtol=1e-9)
    np.testing.assert_allclose(run.times, TAU * np.arange(40), rtol=1e-15)
    np.testing.assert_allclose([run.trajectory.at(t)[0][0] for t in run.times], xs[:-1], rtol=0, atol=1e-11)
    metrics, size = run.metrics, np.abs(xs)
    assert metrics.peak_ratio == pytest.approx(size.max() / WIDTH, **EXACT)
    assert metrics.peak_excess == pytest.approx(size.max() - WIDTH, **EXACT)
    assert metrics.peak_u == pytest.approx(np.abs(us).max(), **EXACT)
    assert metrics.energy_u == pytest.approx(TAU * np.sum(us**2), **EXACT)
    assert metrics.total_variation_u == pytest.approx(np.sum(np.abs(np.diff(us))), **EXACT)
    squares = TAU * np.sum(xs[:-1] ** 2 + xs[:-1] * xs[1:] + xs[1:] ** 2) / 3.0
    assert metrics.rms_error == pytest.approx(math.sqrt(squares / (40 * TAU)), **EXACT)


def test_steady_phase_is_what_follows_the_reaching_time():
    # rho = 3 exp(-t) + 0.5, t_r = ln(3 / 0.7) = 1.455: the 15th sample is the first in the steady phase.
    loop = scalar(rho0=3.0, mu=1.0, rho_inf=0.5)
    _, us = by_hand(
        2.0, 40, lambda k, xs, us: -math.tan(0.5 * math.pi * xs[-1] / (3.0 * math.exp(-k * TAU) + 0.5)), w=W
    )
    metrics = ref.simulate(loop, [2.0], 40 * TAU, 1.2).metrics
    # The equivalent input is constant, and has no variation.
    assert metrics.excess_variation_u == pytest.approx(np.sum(np.abs(np.diff(us[14:]))), **EXACT)
    assert metrics.peak_rate_u == pytest.approx(np.max(np.abs(np.diff(us[14:]))) / TAU, **EXACT)
    assert metrics.reversal_rate == pytest.approx(ref.reversals(us[15:]) / (4.0 - math.log(3.0 / 0.7)), **EXACT)


def test_high_frequency_ratio_is_that_of_scipys_filter():
    cutoff, fine, us = 6.0, 400, [1.0, -1.0, 0.5, 2.0, -0.3, 0.0, 1.0, -2.0]
    loop = scalar(rho0=3.0, mu=4.0, rho_inf=0.5, cutoff=cutoff, law=table(*us))
    skipped = math.log(3.0 / 0.7) / 4.0
    system = scipy.signal.butter(2, cutoff, "highpass", analog=True)
    powers = np.zeros(2)
    for k in range(len(us)):  # the response up to each hold's end is that of all steps before
        t = np.linspace(max(k * TAU, skipped), (k + 1) * TAU, fine + 1)
        if t[-1] > skipped:
            y = sum(jump * _step_response(system, t - j * TAU) for j, jump in enumerate(np.diff([0.0, *us])) if j <= k)
            powers += scipy.integrate.simpson(y**2, x=t), us[k] ** 2 * (t[-1] - t[0])
    found = ref.simulate(loop, [0.0], len(us) * TAU, 1.2).metrics.high_frequency_ratio
    assert found == pytest.approx(powers[0] / powers[1], rel=1e-7)


def _step_response(system, t):
    (b2, _, _), (_, a1, a2) = system
    # s / (s^2 + a1 s + a2): a damped oscillation
    decay, frequency = 0.5 * a1, math.sqrt(a2 - 0.25 * a1**2)
    return b2 * np.exp(-decay * t) * (np.cos(frequency * t) - decay / frequency * np.sin(frequency * t))


def test_first_order_lag_is_the_exponential():
    lag, us = 0.07, [1.0, 1.0, -2.0, 0.5]
    actuator, x, energy = [0.0], 0.3, 0.0
    for u in us:
        gap, decay = actuator[-1] - u, math.exp(-TAU / lag)
        actuator.append(u + gap * decay)
        x += W * TAU + G * (u * TAU + gap * lag * (1.0 - decay))
        energy += u**2 * TAU + 2.0 * u * gap * lag * (1.0 - decay) + gap**2 * lag * (1.0 - decay**2) / 2.0
    run = ref.simulate(scalar(lag=lag, law=table(*us)), [0.3], 4 * TAU, 0.75)
    at_end, u_at_end = run.trajectory.at(4 * TAU)
    assert (at_end[0], u_at_end) == pytest.approx((x, actuator[-1]), **EXACT)
    assert run.trajectory.at(2.5 * TAU)[1] == pytest.approx(
        -2.0 + (actuator[2] + 2.0) * math.exp(-0.5 * TAU / lag), **EXACT
    )
    assert run.metrics.energy_u == pytest.approx(energy, **EXACT)
    assert run.metrics.peak_u == pytest.approx(np.abs(actuator).max(), **EXACT)
    assert run.metrics.total_variation_u == pytest.approx(np.sum(np.abs(np.diff(actuator))), **EXACT)


def test_second_order_lag_overshoots_as_the_textbook_says():
    damping = 0.2
    overshoot = math.exp(-math.pi * damping / math.sqrt(1.0 - damping**2))
    metrics = ref.simulate(scalar(oscillator=(40.0, damping), law=table(1.0)), [0.3], 50 * TAU, 0.75).metrics
    assert metrics.peak_u == pytest.approx(1.0 + overshoot, **EXACT)
    # Up by 1 + q, down by q + q^2, up by q^2 + q^3, ...
    assert metrics.total_variation_u == pytest.approx((1.0 + overshoot) / (1.0 - overshoot), rel=1e-7)


def test_input_delay_need_not_be_a_multiple_of_the_period():
    xs, us = [0.5], []
    for k in range(30):
        us.append(law(xs[-1]))
        old, new = (us[k - j] if k >= j else 0.0 for j in (2, 1))  # the newer one arrives at 0.4 of the hold
        xs.append(xs[-1] + TAU * (W + G * (0.4 * old + 0.6 * new)))
    run = ref.simulate(scalar(delay=1.4 * TAU), [0.5], 30 * TAU, 0.75)
    np.testing.assert_allclose(run.commands, us, rtol=1e-8)
    assert run.trajectory.at(1.39 * TAU)[1] == 0.0
    assert run.trajectory.at(1.41 * TAU)[1] == run.commands[0]
    # What has arrived counts: from 0 on, and not the last command, which comes too late.
    assert run.metrics.total_variation_u == pytest.approx(np.sum(np.abs(np.diff([0.0, *us[:-1]]))), **EXACT)


def test_measurement_is_old_and_the_reference_is_not():
    def command(k, xs, us):
        age = 1.3  # periods
        j = k - 2
        old = xs[0] if k < age else xs[j] + 0.7 * TAU * (W + G * us[j])
        return law(old - 0.1 * k * TAU)

    _, us = by_hand(0.5, 30, command)
    loop = scalar(measurement_delay=1.3 * TAU, desired=lambda t: (0.1 * t, 0.1))
    np.testing.assert_allclose(ref.simulate(loop, [0.5], 30 * TAU, 0.75).commands, us, rtol=1e-8)


def test_rate_limit_is_counted_from_zero_and_comes_after_saturation_and_rounding():
    def command(k, xs, us):
        last = us[-1] if us else 0.0
        rounded = np.clip(np.round(law(xs[-1]) / 0.25) * 0.25, -1.1, 1.1)
        return np.clip(rounded, last - 0.4, last + 0.4)

    _, us = by_hand(0.7, 40, command)
    loop = scalar(rate_limit=0.4 / TAU, saturation=1.1, input_resolution=0.25)
    found = ref.simulate(loop, [0.7], 40 * TAU, 0.75).commands
    assert found[0] == pytest.approx(-0.4)
    assert min(found) == pytest.approx(-1.1)
    np.testing.assert_allclose(found, us, rtol=1e-9)


def test_noise_is_added_before_rounding():
    noise = 0.05 * np.random.default_rng(0).standard_normal(30)
    _, us = by_hand(0.3, 30, lambda k, xs, us: law(np.round((xs[-1] + noise[k]) / 0.02) * 0.02))
    loop = scalar(noise=lambda k, t: (noise[k],), measurement_resolution=(0.02,))
    np.testing.assert_allclose(ref.simulate(loop, [0.3], 30 * TAU, 0.75).commands, us, rtol=1e-8)


def test_jittered_samples_come_late():
    late = [0.5, 0.0, 0.9, 0.3]
    run = ref.simulate(scalar(jitter=lambda k: late[k % 4], law=table(1.0, -1.0, 2.0, 0.0)), [0.0], 4 * TAU, 0.75)
    np.testing.assert_allclose(run.times, TAU * (np.arange(4) + late), rtol=1e-15)
    held = np.diff([*run.times, 4 * TAU]) @ [1.0, -1.0, 2.0, 0.0]
    assert run.trajectory.at(4 * TAU)[0][0] == pytest.approx(W * 4 * TAU + G * held, **EXACT)
    assert run.metrics.total_variation_u == pytest.approx(1.0 + 2.0 + 3.0 + 2.0)  # the first command comes after time 0


def test_jumps_are_met_exactly():
    fault = {"fault": lambda t: np.where((t >= 0.123) & (t < 0.31), -1.0, 1.0), "jumps": (0.123, 0.31, 0.25)}
    step = {"disturbance": lambda t: np.where(t < 0.25, W, -W)}
    run = ref.simulate(scalar(law=table(0.5), **fault, **step), [0.0], 4 * TAU, 0.75)
    assert run.trajectory.at(4 * TAU)[0][0] == pytest.approx(W * (0.25 - 0.15) + G * 0.5 * (0.4 - 2 * 0.187), **EXACT)


def test_variation_of_the_equivalent_input_has_its_jumps():
    # t_r is 0.18. -w / g jumps from -W / G to W / G with the disturbance at 0.25, back at 0.31 and forth again at 0.35.
    loop = scalar(
        rho0=3.0,
        mu=8.0,
        rho_inf=0.5,
        law=table(0.5),
        disturbance=lambda t: np.where(t < 0.25, W, -W),
        fault=lambda t: np.where((t >= 0.31) & (t < 0.35), -1.0, 1.0),
        jumps=(0.25, 0.31, 0.35),
    )
    metrics = ref.simulate(loop, [0.0], 4 * TAU, 1.2).metrics
    assert metrics.excess_variation_u == pytest.approx(-3 * 2 * W / G, **EXACT)


def test_unmatched_disturbances_drive_the_first_states_and_the_surface():
    loop = scalar(
        desired=lambda t: (0.0, 0.0, 0.0),
        c=(2.0,),
        unmatched=(lambda t: 0.3 + 0.0 * t,),
        law=table(1.0),
    )
    run = ref.simulate(loop, [0.1, -0.2], 0.4, 0.75)
    acceleration = W + G
    x = [0.1 + 0.1 * 0.4 + acceleration * 0.08, -0.2 + acceleration * 0.4]
    assert run.trajectory.at(0.4)[0] == pytest.approx(x, **EXACT)
    first_rate = x[1] + 0.3
    assert loop.equivalent_input(0.4, x) == pytest.approx(-(W + 2.0 * first_rate) / G)


def test_linear_plant_is_its_matrix_exponential():
    # x_1'' = -2 x_1 - x_2 / 2 + 1.5 u + 0.4 behind the actuator u'' + 2 0.3 9 u' + 81 u = 81 command; c = 2
    matrix = np.zeros((6, 6))
    matrix[:4, :4] = [[0, 1, 0, 0], [-2, -0.5, G, 0], [0, 0, 0, 1], [0, 0, -81, -5.4]]
    matrix[1, 4], matrix[3, 5] = W, 81.0
    move, y, us = scipy.linalg.expm(matrix * TAU), np.array([0.2, -0.1, 0.0, 0.0, 1.0, 0.0]), []
    for _ in range(25):
        y[5] = law(2.0 * y[0] + y[1])
        us.append(y[5])
        y = move @ y
    loop = scalar(
        drift=lambda t, x: -2.0 * x[0] - 0.5 * x[1], desired=lambda t: (0.0, 0.0, 0.0), c=(2.0,), oscillator=(9.0, 0.3)
    )
    run = ref.simulate(loop, [0.2, -0.1], 25 * TAU, 0.75)
    np.testing.assert_allclose(run.commands, us, rtol=1e-8)
    np.testing.assert_allclose([*run.trajectory.at(25 * TAU)[0], run.trajectory.at(25 * TAU)[1]], y[:3], rtol=1e-8)


def test_curved_peak_is_found_between_samples():
    # sigma = x_0 + 3/8 sin(8 t): from -0.2 the start is the peak, from 0.1 the crest.
    loop = scalar(disturbance=lambda t: 3.0 * np.cos(8.0 * t), law=table(0.0), sample_period=1.0)
    metrics = ref.simulate(loop, [-0.2], 0.35, 0.75).metrics
    assert metrics.peak_ratio == pytest.approx(0.2 / WIDTH, **EXACT)
    metrics = ref.simulate(loop, [0.1], 0.35, 0.75).metrics
    assert metrics.peak_ratio == pytest.approx((0.1 + 3.0 / 8.0) / WIDTH, **EXACT)


def test_times_of_leaving_and_of_return_are_the_roots():
    # sigma = 0.2 + 0.5 sin(2 t) twice leaves and enters rho = 0.8 exp(-t / 2) + 0.1, and |sigma| < 0.35.
    loop = scalar(rho0=0.8, mu=0.5, rho_inf=0.1, disturbance=lambda t: np.cos(2.0 * t), law=table(0.0))

    def sigma(t):
        return 0.2 + 0.5 * math.sin(2.0 * t)

    def above(t):
        return abs(sigma(t)) - 0.8 * math.exp(-0.5 * t) - 0.1

    metrics = ref.simulate(loop, [0.2], 5.0, 0.35).metrics
    ts = np.linspace(0.0, 5.0, 100_001)
    values = np.array([above(t) for t in ts])
    first, last = np.flatnonzero(np.diff(np.sign(values)))[[0, -1]]
    assert metrics.violation_time == pytest.approx(scipy.optimize.brentq(above, ts[first], ts[first + 1]), **EXACT)
    assert metrics.recovery_time == pytest.approx(scipy.optimize.brentq(above, ts[last], ts[last + 1]), **EXACT)
    assert metrics.peak_excess == pytest.approx(values.max(), abs=1e-8)
    assert metrics.reach_time == pytest.approx(0.5 * (3.0 * math.pi - math.asin(0.3)), **EXACT)


@pytest.mark.parametrize(
    ("x0", "horizon", "expected"),
    [(0.0, 0.5, (math.inf, 0.0)), (0.0, 3.0, (2.0, math.inf)), (-1.2, 2.0, (0.0, 1.0))],
    ids=["never", "still at the end", "from the start"],
)
def test_times_of_leaving_and_of_return_at_the_ends(x0, horizon, expected):
    metrics = ref.simulate(scalar(law=table(0.0)), [x0], horizon, 0.75).metrics
    assert (metrics.violation_time, metrics.recovery_time) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("commands", "count"),
    [
        ([], 0),
        ([1.0, 1.0, 1.0], 0),
        ([0.0, 0.0, -1.0, -2.0], 0),
        ([0.0, 1.0, 0.0, 1.0], 2),
        ([0.0, 1.0, 0.995, 1.0, 0.995], 0),  # within the band
        ([0.0, 1.0, 0.995, 0.985], 1),  # out of it in two moves
        ([0.0, 1.0, 0.5, 0.495, 0.504, 0.506], 2),  # from the extreme 0.495
        ([0.0, 1e-6, 0.0, 1.0, 0.999, 1.0], 2),  # the band is that of the range so far
    ],
)
def test_reversals_have_hysteresis(commands, count):
    assert ref.reversals(np.array(commands)) == count


@pytest.mark.parametrize("sigma", [0.3, -0.3, 0.79999, -0.79999])
def test_law_is_the_tangent_inside(sigma):
    for beyond in ("saturate", "wrap"):
        sample = ref.Sample(0, 0.0, TAU, sigma, WIDTH, (0.0, 0.0))
        assert ref.tangent(-1.0, beyond)(sample, ())[0] == pytest.approx(math.tan(0.5 * math.pi * sigma / WIDTH))


def test_law_beyond_the_funnel():
    sample = ref.Sample(0, 0.0, TAU, 1.2 * WIDTH, WIDTH, (0.0, 0.0))
    assert ref.tangent()(sample, ())[0] == pytest.approx(-2.0 / (math.pi * 1e-9), rel=1e-6)
    assert ref.tangent(beyond="wrap")(sample, ())[0] == pytest.approx(math.tan(0.4 * math.pi))


def test_law_may_keep_a_memory():
    def integral(sample, memory):
        total = memory + sample.period * sample.sigma
        return -total, total

    loop = scalar(law=integral, memory=0.5)
    totals = [0.5]

    def command(k, xs, us):
        totals.append(totals[-1] + TAU * xs[-1])
        return -totals[-1]

    _, us = by_hand(0.3, 20, command)
    np.testing.assert_allclose(ref.simulate(loop, [0.3], 20 * TAU, 0.75).commands, us, rtol=1e-9)

"""Implemented loops with known answers: limits of the input, noise, chattering, recovery; and bad input."""

import dataclasses
import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import problems
import qsmc_jax as qj
from qsmc_jax.control import thresholds
from qsmc_jax.robustness.limits import noise_bound

RHO, T1 = 0.1, 8.0
FUNNEL = qj.Funnel(1.0, 2.0, RHO)


class Scalar(qj.AbstractPlant):
    """x' = g (1 + s sin(w t)) u + d."""

    g: float
    swing: float = 0.0
    frequency: float = 1.0

    order: ClassVar[int] = 1

    def drift(self, t, x):
        """None."""
        return 0.0 * x[0]

    def gain(self, t, x):
        """Swinging."""
        return self.g * (1.0 + self.swing * jnp.sin(self.frequency * t))


def scalar_loop(implementation, d=0.0, g=1.0, control=None, funnel=FUNNEL):
    control = control or qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel)
    return qj.ClosedLoop(Scalar(g), qj.references.Constant(0.0), qj.disturbances.Constant(d), control, implementation)


def example1_study(**fields):
    """Example 1 from random starts, with or without an implementation."""

    def scenario(draw):
        ideal = qj.paper.example1()
        made = {name: value(draw) if callable(value) else value for name, value in fields.items()}
        loop = dataclasses.replace(ideal, implementation=qj.Implementation(**made) if made else None)
        return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=4.0)

    return qj.Study(scenario, bandwidth=0.1)


@pytest.mark.slow
def test_a_saturation_above_the_peak_of_the_ideal_input_changes_nothing():
    ideal = qj.monte_carlo(example1_study(), 128, block=64)
    free = qj.monte_carlo(example1_study(sample_period=1e-3), 128, block=64)
    # The hold adds some 1e-3 to the peak.
    limited = qj.monte_carlo(example1_study(sample_period=1e-3, saturation=1.01 * ideal["peak_u"].max()), 128, block=64)
    for column in free:
        exact = column.startswith("verdict") or column in ("index", "outcome", "steps")
        np.testing.assert_allclose(
            limited[column], free[column], rtol=0.0 if exact else 1e-9, atol=0.0 if exact else 1e-9
        )


@pytest.mark.parametrize("d", [0.7, -0.7])
def test_a_saturation_below_what_a_constant_disturbance_asks_for_is_lost(d):
    needed = thresholds.necessary_saturation(abs(d), 2.0, FUNNEL)
    assert needed == pytest.approx(0.35)
    run = qj.simulate(scalar_loop(qj.Implementation(1e-3, saturation=0.99 * needed), d, g=2.0), [0.0], 100.0)
    assert run.verdict == qj.Verdict.VIOLATED
    # Full input from the start would keep |sigma| = (|d| - g u_max) t in the funnel for longest.
    time = scipy.optimize.brentq(lambda t: (0.7 - 0.99 * 0.7) * t - 1.0 * math.exp(-2.0 * t) - RHO, 0.1, 100.0)
    assert 0.0 < float(run.metrics.violation_time) <= time


@pytest.mark.parametrize("d", [0.7, -0.7])
def test_a_saturation_that_suffices_holds(d):
    enough = thresholds.sufficient_saturation(abs(d), 2.0, FUNNEL)
    run = qj.simulate(scalar_loop(qj.Implementation(1e-3, saturation=enough), d, g=2.0), [1.05], T1)
    assert run.verdict == qj.Verdict.HELD


@pytest.mark.slow
def test_sigma_stays_within_the_funnel_and_the_bound_of_a_continuous_noise():
    """Even for noise wider than the funnel ends up: the law sees sigma + nu in the funnel, the proof with w + nu'."""
    study = example1_study(
        sample_period=5e-4, noise=lambda draw: qj.noises.coloured(draw, "noise", [0.02, 0.08], frequencies=(0.5, 10.0))
    )
    nu = float(noise_bound(study.nominal.loop.implementation, study.nominal.loop))
    assert nu == pytest.approx(2.0 * 0.02 + 0.08)
    runs = qj.monte_carlo(study, 512)
    assert np.all(runs["outcome"] == qj.Outcome.COMPLETED)
    gap = nu - runs["peak_excess"]
    assert np.all(gap > 0.0)
    assert runs["peak_excess"].max() > 0.0  # the funnel itself is left: the statement says something


def test_white_noise_is_amplified_as_the_linearised_loop_says():
    """sigma_{k+1} = (1 - k tau) sigma_k - k tau nu_k, held to a line between: its mean square is v (2 + a) / 3."""
    period, std = 0.02, 1e-4
    loop = scalar_loop(qj.Implementation(period, noise=qj.noises.White([std], 0.3)), funnel=qj.Funnel(1.0, 20.0, RHO))
    run = qj.simulate(loop, [0.0], 2000.0, settings=qj.SolverSettings(max_steps=200_000))
    a = 1.0 - thresholds.small_signal_gain(1.0, 0.0, RHO) * period
    wanted = std**2 * thresholds.noise_gain(1.0, 0.0, RHO, period) * (2.0 + a) / 3.0
    # 100 000 samples with correlation time of some three: two per cent are about five standard deviations.
    assert float(run.metrics.rms_error) ** 2 == pytest.approx(wanted, rel=0.03)


def test_the_sign_law_chatters_as_it_must():
    """On sigma = 0 without a disturbance it flips at every sample: 2 K each."""
    control = qj.controllers.Sign(qj.SlidingSurface([]), FUNNEL, 0.5)
    run = qj.simulate(scalar_loop(qj.Implementation(0.01), control=control), [1e-3], T1)
    steady = T1 - run.reaching_time
    chattering = run.metrics.sampled
    assert float(chattering.excess_variation_u) == pytest.approx(2 * 0.5 * steady / 0.01, rel=0.01)
    assert float(chattering.reversal_rate) == pytest.approx(1 / 0.01, rel=0.01)
    assert float(chattering.peak_rate_u) == pytest.approx(2 * 0.5 / 0.01)
    assert float(chattering.high_frequency_ratio) > 0.95


@pytest.mark.parametrize(("factor", "is_free"), [(0.9, True), (1.2, False)])
def test_the_quasi_sliding_law_is_chattering_free_up_to_the_critical_period(factor, is_free):
    """Beyond g / sqrt(3) it does not leave the funnel just above it, but swings from sample to sample."""
    period = factor * thresholds.critical_period(1.0, 1.2, RHO)
    run = qj.simulate(scalar_loop(qj.Implementation(period), 1.2), [0.1], 40.0)
    assert run.verdict == qj.Verdict.HELD
    swings = float(run.metrics.sampled.excess_variation_u) / (40.0 / period)
    assert (swings < 1e-3) == is_free
    assert (swings > 0.1) == (not is_free)


@pytest.mark.parametrize(("factor", "reaching"), [(0.99, "HELD"), (1.01, "VIOLATED")])
def test_reaching_is_judged_at_the_reaching_time(factor, reaching):
    """Too little input for the funnel, not for the bandwidth: at full input from the start |sigma| = sigma_0 - u_max t,
    outside the funnel until it falls through the bandwidth, a hundredth before the reaching time or after it."""
    bandwidth, sigma0 = 0.2, 1.0
    reaching_time = math.log(1.0 / (bandwidth - RHO)) / 2.0
    time = factor * reaching_time
    plan = qj.Implementation(1e-3, saturation=(sigma0 - bandwidth) / time)
    run = qj.simulate(scalar_loop(plan), [sigma0], 3.0, bandwidth=bandwidth)
    assert float(run.metrics.reach_time) == pytest.approx(time, rel=1e-6)
    assert run.verdict == qj.Verdict.VIOLATED
    # Of order 1 the error is the sliding variable, and t_s is t_r.
    for claim in (run.metrics.verdict_reaching, run.metrics.verdict_tracking):
        assert qj.Verdict(int(claim)).name == reaching


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("period", "v"), [(1.0, 0.5), (0.3, 0.6), (0.013, 0.6)])
def test_the_excess_is_its_largest_value_also_between_samples(period, v, sign):
    """At full input |sigma| = sigma_0 - v t, which leaves the funnel and comes back: |sigma| - rho is largest where
    rho' = -v, that is where exp(-mu t) = v / (mu rho_0), in the middle of a hold."""
    sigma0, mu = 1.0, 2.0
    ts = np.array([0.0, 1.0])  # a cell ends at each of these times
    run = qj.simulate(scalar_loop(qj.Implementation(period, saturation=v)), [sign * sigma0], 1.0, ts=ts)
    time = math.log(mu / v) / mu
    excess = sigma0 - v * time - v / mu - RHO
    assert excess > 0.2
    # Within 1e-6 of the funnel's width.
    assert float(run.metrics.sampled.peak_excess) == pytest.approx(excess, abs=1e-6 * (v / mu + RHO))


class Pushed(qj.AbstractPlant):
    """x' = u + a exp(-((t - t_0) / b)^2), a push that it does not announce."""

    height: float
    at: float
    width: float

    order: ClassVar[int] = 1

    def drift(self, t, x):
        """The push."""
        return self.height * jnp.exp(-(((t - self.at) / self.width) ** 2))

    def gain(self, t, x):
        """One."""
        return 1.0


@pytest.mark.parametrize("width", [1e-2, 1e-3, 1e-4])
def test_a_short_push_inside_a_hold_is_met(width):
    """From rest sigma jumps by the push's area, a sqrt(pi) b, within a hold, and stays there until the next sample."""
    period, place, size = 0.2, 0.53, 0.06
    plant = Pushed(size / (math.sqrt(math.pi) * width), place, width)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL)
    plan = qj.Implementation(period)
    loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Zero(), control, plan)
    run = qj.simulate(loop, [0.0], 0.6, ts=np.array([0.0, 0.6]))  # a cell ends at each of these times
    assert float(run.metrics.peak_ratio) == pytest.approx(size / float(FUNNEL(0.6)), rel=1e-4)


@pytest.mark.parametrize(("margin", "verdict"), [(5e-4, "HELD"), (-5e-4, "VIOLATED")])
def test_a_run_leaves_by_however_little(margin, verdict):
    """At full input |sigma| = sigma_0 - v t, nearest to the funnel's edge where exp(-mu t) = v / (mu rho_0)."""
    v, mu = 0.6, 2.0
    time = math.log(mu / v) / mu
    sigma0 = v * time + (1.0 - margin) * (v / mu + RHO)
    run = qj.simulate(scalar_loop(qj.Implementation(1.0, saturation=v)), [sigma0], 1.0)
    assert run.verdict.name == verdict
    assert float(run.metrics.margin) == pytest.approx(margin, rel=0.01)


def test_a_sampled_run_is_admissible_strictly_inside_the_funnel():
    inside, edge = (
        qj.simulate(scalar_loop(qj.Implementation(1e-3, saturation=4.0)), [x0], 0.01)
        for x0 in ((1.0 - 1e-9) * (1.0 + RHO), 1.0 + RHO)
    )
    assert inside.verdict == qj.Verdict.HELD
    assert edge.verdict == qj.Verdict.INADMISSIBLE


def test_a_start_outside_is_no_premise_but_is_followed():
    """It comes back at full input: |sigma| = sigma_0 - g u_max t until it meets the funnel."""
    run = qj.simulate(scalar_loop(qj.Implementation(1e-3, saturation=2.0)), [3.0], T1)
    assert [run.verdict, run.outcome] == [qj.Verdict.INADMISSIBLE, qj.Outcome.COMPLETED]
    back = scipy.optimize.brentq(lambda t: 3.0 - 2.0 * t - float(FUNNEL(t)), 0.0, 3.0)
    assert float(run.metrics.sampled.recovery_time) == pytest.approx(back, abs=1e-9)
    assert float(run.metrics.violation_time) == 0.0
    highest = scipy.optimize.minimize_scalar(lambda t: (2.0 * t - 3.0) / float(FUNNEL(t)), bounds=(0.0, back))
    assert float(run.metrics.peak_ratio) == pytest.approx(-highest.fun, rel=1e-6)


def test_wrapping_around_the_pole_is_a_fault():
    """Just outside, the tangent as it stands pushes outwards: the run that saturation brings back is lost."""
    saved, lost = (
        qj.simulate(scalar_loop(qj.Implementation(1e-3, saturation=5.0, beyond=beyond)), [1.15], T1)
        for beyond in ("saturate", "wrap")
    )
    assert math.isfinite(saved.metrics.sampled.recovery_time)
    assert math.isinf(lost.metrics.sampled.recovery_time)


@pytest.mark.parametrize("configurations", [500, pytest.param(10_000, marks=pytest.mark.slow)])
def test_a_sufficient_period_is_never_violated(configurations):
    """Random bounds on w and g, funnels and starts, each under two random disturbances and a swinging gain."""
    rng = np.random.default_rng(3)
    w, g, mu, rho0, rho, z0, spread = (
        np.exp(rng.uniform(math.log(low), math.log(high), configurations))
        for low, high in ((0.05, 5), (0.3, 3), (0.2, 5), (0.6, 5), (0.02, 0.5), (0.01, 0.95), (0.02, 0.6))
    )
    bounds = [
        thresholds.sufficient_period(wi, (gi * (1 - si), gi * (1 + si)), qj.Funnel(*numbers), zi)
        for wi, gi, si, zi, *numbers in zip(w, g, spread, z0, rho0, mu, rho, strict=True)
    ]
    table = np.stack([w, g, mu, rho0, rho, z0, spread, [0.999 * bound.period for bound in bounds]])

    def scenario(draw):
        config = draw.choice("config", np.arange(configurations)).astype(int)
        wi, gi, mui, rho0i, rhoi, zi, si, period = jnp.asarray(table)[:, config]
        telegraph = qj.disturbances.Telegraph(
            jnp.sort(draw.uniform("switches", 0.0, 1.0, shape=(12,))) * 200.0 * period, wi * draw.sign("w", shape=(13,))
        )
        plant = Scalar(gi, si, draw.log_uniform("frequency", 0.01, 1.0) / period)
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0i, mui, rhoi))
        loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), telegraph, control, qj.Implementation(period))
        start = draw.sign("side") * zi * (rho0i + rhoi)
        return qj.Scenario(loop, x0=start[None], t1=200.0 * period)

    runs = qj.monte_carlo(qj.Study(scenario, bandwidth=0.55), 2 * configurations)
    ratio = np.array([bound.ratio for bound in bounds])[runs["config"].astype(int)]
    assert np.all(runs["outcome"] == qj.Outcome.COMPLETED)
    assert np.all(runs["peak_ratio"] <= ratio * (1.0 + 1e-6))
    assert np.max(runs["peak_ratio"] / ratio) > 0.9  # it is not far from being broken


@pytest.mark.slow
def test_rows_are_the_same_to_the_last_bit_however_they_are_solved_and_replayed():
    study = example1_study(
        sample_period=5e-3,
        jitter=lambda draw: qj.random_jitter(draw, "jitter", 0.5),
        noise=lambda draw: qj.noises.white(draw, "noise", [1e-4, 1e-3]),
    )
    once, again = qj.monte_carlo(study, 128, block=64, threads=1), qj.monte_carlo(study, 128, block=128)
    for column in once:
        np.testing.assert_array_equal(once[column], again[column], err_msg=column)
    assert len(np.unique(once["noise.seed"])) == 128
    # A replay stops at the times of its grid too: the same to the tolerance, not to the last bit.
    run = study.replay(100).metrics.named()
    for name in ("peak_ratio", "total_variation_u", "energy_u", "peak_rate_u"):
        assert float(run[name]) == pytest.approx(once[name][100], rel=1e-6)


@pytest.mark.slow
def test_an_actuator_without_a_lag_changes_nothing():
    plain, through = (
        example1_study(sample_period=2e-3, **fields) for fields in ({}, {"actuator": qj.actuators.FirstOrderLag(0.0)})
    )
    plain, through = (qj.monte_carlo(study, 64, block=64) for study in (plain, through))
    for column in plain:
        np.testing.assert_allclose(through[column], plain[column], rtol=1e-9, atol=1e-9, err_msg=column)


def test_drawn_numbers_out_of_range_leave_a_run_without_a_premise():
    runs = qj.monte_carlo(
        example1_study(sample_period=lambda draw: draw.uniform("sample_period", -0.01, 0.02)), 64, block=64
    )
    is_bad = runs["sample_period"] <= 0.0
    assert 0 < is_bad.sum() < 64
    assert np.all((runs["verdict"] == qj.Verdict.INADMISSIBLE) == is_bad)
    assert np.all((runs["outcome"] == qj.Outcome.BAD_PARAMETERS) == is_bad)


def test_drawn_numbers_of_a_part_are_checked_too():
    study = example1_study(sample_period=0.01, jitter=lambda draw: qj.Jitter(draw.uniform("fraction", 0.0, 1.9)))
    runs = qj.monte_carlo(study, 64, block=64)
    is_bad = runs["fraction"] >= 1.0
    assert 0 < is_bad.sum() < 64
    assert np.all((runs["verdict"] == qj.Verdict.INADMISSIBLE) == is_bad)


def test_a_delay_that_the_queue_does_not_hold_is_undecided():
    study = example1_study(sample_period=0.01, delay=lambda draw: draw.uniform("delay", 0.0, 0.05), queue=4)
    runs = qj.monte_carlo(study, 64, block=64)
    is_long = runs["delay"] > 0.04
    assert 0 < is_long.sum() < 64
    assert np.all((runs["outcome"] == qj.Outcome.QUEUE_FULL) == is_long)
    assert np.all(runs["verdict"][is_long] == qj.Verdict.UNDECIDED)


def test_too_few_steps_are_undecided_and_a_violation_before_that_is_not():
    few = qj.SolverSettings(max_steps=500)
    calm = qj.simulate(scalar_loop(qj.Implementation(1e-3)), [0.0], T1, settings=few)
    assert [calm.outcome, calm.verdict] == [qj.Outcome.MAX_STEPS, qj.Verdict.UNDECIDED]
    lost = qj.simulate(scalar_loop(qj.Implementation(1e-3, saturation=0.1), 5.0), [0.9], T1, settings=few)
    assert [lost.outcome, lost.verdict] == [qj.Outcome.MAX_STEPS, qj.Verdict.VIOLATED]


def test_a_run_that_is_lost_never_recovers():
    lost = qj.simulate(scalar_loop(qj.Implementation(0.5)), [0.9], 200.0)
    assert [lost.outcome, lost.verdict] == [qj.Outcome.LOST, qj.Verdict.VIOLATED]
    assert math.isinf(lost.metrics.sampled.recovery_time)


BAD = {
    "sample_period": (0.0, "must be positive and finite, but is 0"),
    "saturation": (0.0, "must be positive and finite, but is 0"),
    "rate_limit": (-1.0, "must be positive and finite, but is -1"),
    "delay": (-1e-3, "must be finite and not negative, but is -0.001"),
    "input_resolution": (math.nan, "must be finite and not negative, but is nan"),
    "queue": (0, "must be at least 1, but is 0"),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_number_is_named(name):
    value, words = BAD[name]
    with pytest.raises(ValueError, match=f"Argument `{name}` {words}"):
        qj.Implementation(**{"sample_period": 1e-3, name: value})


@pytest.mark.parametrize(("name", "value"), [("actuator", "third order"), ("noise", 0.1)])
def test_a_part_of_another_kind_is_named(name, value):
    """By whichever check comes first: here that of the annotations, which says the name and the value."""
    with pytest.raises(Exception, match=f"(?s){name}.*{value}"):
        qj.Implementation(**{"sample_period": 1e-3, name: value})


def test_a_queue_that_is_too_short_is_named_with_the_length_it_needs():
    with pytest.raises(ValueError, match="Argument `queue` must be at least 51, .* but is 16. Give `queue=51`"):
        qj.Implementation(1e-3, delay=0.05)


def test_a_delay_longer_than_the_horizon_is_named():
    with pytest.raises(ValueError, match="Argument `delay` must not be longer than the horizon, 4 s, but is 5"):
        qj.simulate(scalar_loop(qj.Implementation(1.0, delay=5.0)), [0.1], 4.0)


def test_noise_for_another_order_is_named():
    loop = scalar_loop(qj.Implementation(1e-3, noise=qj.noises.Uniform([0.1, 0.1])))
    with pytest.raises(ValueError, match="Argument `noise` must fit a plant with 1 states, but is for 2"):
        qj.simulate(loop, [0.1], T1)


def test_a_rival_needs_an_implementation():
    control = qj.controllers.Sign(qj.SlidingSurface([]), FUNNEL, 0.5)
    with pytest.raises(ValueError, match="Argument `implementation` must be given for a `Sign`"):
        scalar_loop(None, control=control)


@pytest.mark.parametrize("period", [1.0, 0.3, 0.1])
def test_a_peak_inside_a_long_cell_is_not_missed_while_the_funnel_bends(period):
    # x' = u with u = -0.6, its limit, from the first sample on: z = (0.7614 - 0.6 t) / (exp(-2 t) + 0.1).
    ts = np.linspace(0.0, 1.0, 200_001)
    margin = 1.0 - np.max((0.7614 - 0.6 * ts) / (np.exp(-2.0 * ts) + 0.1))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, 2.0, 0.1))
    implementation = qj.Implementation(period, saturation=0.6)
    loop = qj.ClosedLoop(
        problems.chain(1)(), qj.references.Constant(0.0), qj.disturbances.Zero(), control, implementation
    )
    metrics = qj.simulate(loop, [0.7614], 1.0, ts=np.array([0.0, 1.0])).metrics
    assert margin == pytest.approx(-5.2e-4, abs=1e-5)
    assert float(metrics.margin) == pytest.approx(margin, abs=1e-5)
    assert metrics.verdict == qj.Verdict.VIOLATED

"""Gradients of every metric through both engines: against central differences, and mode against mode."""

import functools as ft
import runpy

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import places
import problems
import qsmc_jax as qj
from qsmc_jax.simulation.engine import pose, solve
from qsmc_jax.study import tangents
from qsmc_jax.study.tangents import differentiate
from qsmc_jax.tuning.objectives import METRICS

GAINS = {"rho_inf": 0.1, "mu": 1.0}
DEFAULT, TIGHT, TIGHTEST = 1e-6, 1e-9, 1e-12
IMPLEMENTED = ("recovery_time", "peak_excess", "excess_variation_u", "high_frequency_ratio", "peak_rate_u")
# Sums of |b - a| have a kink wherever the input turns, and a sampled loop's peak is that of a parabola between samples.
KINKED = ("total_variation_u", "excess_variation_u", "peak_ratio", "margin", "peak_excess")
RUNS = 64


def example(number, is_sampled, draw):
    """Example 1 or 2 of the paper over 3 s, with numbers of every kind as parameters."""
    rho_inf = draw.parameter("rho_inf", 0.05, bounds=(0.01, 0.09))
    funnel = qj.Funnel(draw.parameter("rho0", 5.0, bounds=(1, 10)), draw.parameter("mu", 3.0, bounds=(1, 5)), rho_inf)
    order = 2 * number
    surface = qj.SlidingSurface.binomial(draw.parameter("pole", 2.0, bounds=(1, 3)), order)
    scale = draw.parameter("scale", 1.0, bounds=(0.5, 2))
    pendulum = qj.plants.InvertedPendulum(mass=0.01 * scale)
    plant = pendulum if number == 1 else qj.plants.FourthOrderExample(gain_scale=scale)
    start = draw.parameter("start", 0.3, bounds=(0, 1))
    disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5, frequencies=(0.5, 3.0))
    noise = qj.noises.uniform(draw, "noise", [0.0] * (order - 1) + [1e-3])
    implementation = qj.Implementation(sample_period=2e-3, saturation=50.0, noise=noise) if is_sampled else None
    control = qj.QuasiSlidingControl(surface, funnel)
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), disturbance, control, implementation)
    return qj.Scenario(loop, x0=jnp.stack([start, *(0.0 * start + 0.2,) * (order - 1)]), t1=3.0)


NAMES = ("mu", "rho_inf", "rho0", "pole", "scale", "start")
# Both engines, and both orders: each of the four costs most of a minute.
CASES = [
    pytest.param(1, True, id="example 1 sampled"),
    pytest.param(2, False, id="example 2"),
]


@pytest.mark.slow
@pytest.mark.parametrize(("number", "is_sampled"), CASES)
def test_gradients_are_central_differences_and_the_same_in_both_modes(number, is_sampled):
    study = qj.Study(ft.partial(example, number, is_sampled), bandwidth=0.1)
    metrics = tuple(m for m in METRICS if is_sampled or m not in IMPLEMENTED) + ("peak_error[0]", "peak_error[1]")
    # The one is 0 throughout, the other is of several inputs.
    metrics = tuple(m for m in metrics if m not in ("recovery_time", "peak_barrier"))
    settings = qj.SolverSettings(TIGHT, method="tsit5")
    made = {
        mode: differentiate(
            study,
            np.arange(RUNS),
            0,
            names=NAMES,
            metrics=metrics,
            settings=settings.replace(adjoint=mode),
            block=RUNS,
        )
        for mode in ("forward", "reverse")
    }
    forward, reverse = made["forward"].jacobian, made["reverse"].jacobian
    assert made["forward"].is_known.all()
    size = np.abs(forward).max(axis=0)
    assert np.all(np.abs(forward - reverse) <= 1e-9 * size + 1e-13)
    nominal = {spec.name: float(spec.nominal) for spec in study.specs if spec.kind == "parameter"}
    # What a solve is off, over the step of the difference, must be small: the ideal loop is solved more tightly here.
    exact = settings if is_sampled else qj.SolverSettings(TIGHTEST, method="tsit5", max_steps=1_000_000)
    for j, name in enumerate(NAMES):
        step = (1e-6 if is_sampled else 1e-4) * nominal[name]
        up, down = (
            qj.monte_carlo(study.substitute(**{name: nominal[name] + s}), RUNS, settings=exact, block=RUNS)
            for s in (step, -step)
        )
        for i, metric in enumerate(metrics):
            difference = (up[metric] - down[metric]) / (2.0 * step)
            apart = np.abs(difference - forward[:, i, j]) / max(size[i, j], 1e-6)
            # A run whose kink lies inside the step has no derivative there: three in four must not have one.
            # The lesser of the input's extremes is off by as much as the greater, which is `peak_u`.
            tolerance = 1e-3 if metric in KINKED else 5e-4 if metric in ("max_u", "min_u") else 1e-4
            assert np.quantile(apart, 0.75) < tolerance, (metric, name)


def peak(gains, gain_sign, rtol):
    """sup |sigma|/rho of a loop of order 1 that follows sin t under d = sin(3 t) / 2, and the verdict."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, gains["mu"], gains["rho_inf"]), gain_sign)
    plant, reference = problems.chain(1)(drift_scale=1.0), qj.references.SumOfSines([1.0], [1.0])
    loop = qj.ClosedLoop(plant, reference, qj.disturbances.Sine(0.5, 3.0), control)
    settings, x0 = qj.SolverSettings(rtol), (jnp.asarray(0.1),)
    metrics, _ = solve(pose(loop, x0, 0.2, settings), x0, jnp.asarray(4.0), settings)
    return metrics.peak_ratio, (metrics.verdict, metrics.peak_time)


@pytest.fixture(scope="module")
def program():
    return jax.jit(jax.value_and_grad(peak, has_aux=True))


@pytest.mark.slow
@pytest.mark.parametrize("gain", GAINS)
def test_gradient_of_one_run_is_the_central_difference(program, gain):
    (_, (verdict, peak_time)), gradient = program(GAINS, 1.0, 1e-10)
    up, down = (program({**GAINS, gain: GAINS[gain] + step}, 1.0, 1e-13)[0][0] for step in (1e-4, -1e-4))
    assert verdict == qj.Verdict.HELD
    assert 0.1 < peak_time < 3.9  # inside: both gains have a say
    assert float(gradient[gain]) == pytest.approx(float(up - down) / 2e-4, abs=1e-8, rel=0)


@pytest.mark.slow
def test_gradient_of_a_violated_run_is_finite(program):
    (value, (verdict, _)), gradient = program(GAINS, -1.0, DEFAULT)
    assert verdict == qj.Verdict.VIOLATED
    assert value == 1.0
    assert np.all(np.isfinite(list(gradient.values())))


def mixed(is_sampled, draw):
    """Runs with either sign of the gain, and starts inside and outside."""
    mu = draw.parameter("mu", 1.0, bounds=(0.5, 2))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, mu, 0.1))
    plant = problems.chain(1)(drift_scale=1.0, gain_scale=draw.sign("side"))
    implementation = qj.Implementation(sample_period=0.01) if is_sampled else None
    reference = qj.references.SumOfSines([1.0], [1.0])
    loop = qj.ClosedLoop(plant, reference, qj.disturbances.Sine(0.5, 3.0), control, implementation)
    return qj.Scenario(loop, x0=jnp.atleast_1d(draw.uniform("x0", -1.3, 1.3)), t1=4.0)


@pytest.mark.slow
@pytest.mark.parametrize("max_steps", [100_000, 20], ids=["violated", "undecided"])
@pytest.mark.parametrize(("is_sampled", "mode"), [(False, "forward"), (False, "reverse"), (True, "reverse")])
def test_gradients_are_finite_in_every_lane_whatever_became_of_it(is_sampled, mode, max_steps):
    study = qj.Study(ft.partial(mixed, is_sampled), bandwidth=0.2)
    settings = qj.SolverSettings(adjoint=mode, max_steps=max_steps)
    metrics = ("peak_ratio", "peak_u", "rms_error", "energy_u", "total_variation_u", "reach_time", "peak_error[0]")
    made = differentiate(study, np.arange(RUNS), 0, names=("mu",), metrics=metrics, settings=settings, block=RUNS)
    assert {qj.Verdict.VIOLATED, qj.Verdict.HELD} <= set(made.verdict) or qj.Verdict.UNDECIDED in made.verdict
    assert np.isfinite(made.jacobian).all()
    assert not made.jacobian[~made.is_known].any()
    assert np.isfinite(made.values[made.is_known]).all()
    if max_steps > 1000:
        assert made.jacobian[made.verdict == qj.Verdict.HELD].any(axis=(1, 2)).mean() > 0.5


@pytest.mark.as_users
@pytest.mark.slow
def test_reverse_mode_is_forward_mode_in_long_runs_and_unknown_in_longer_ones(monkeypatch):
    """1200 to 2100 steps: nothing is solved again. With room for fewer, no gradient instead of another run's."""
    path = places.STUDIES / "example2_uncertain.py"
    study = runpy.run_path(str(path))["study"].substitute(mu=3.0, rho_inf=0.05)
    settings = qj.SolverSettings(method="tsit5")
    asked = {"names": ("mu", "rho_inf"), "metrics": ("rms_error", "energy_u", "reach_time"), "block": RUNS}
    forward, reverse = (
        differentiate(study, np.arange(RUNS), 0, settings=settings.replace(adjoint=mode), **asked)
        for mode in ("forward", "reverse")
    )
    steps = qj.monte_carlo(study, RUNS, settings=settings, block=RUNS)["steps"]
    assert steps.min() > 1000
    assert reverse.is_known.all()
    size = np.abs(forward.jacobian).max(axis=0)
    assert np.all(np.abs(forward.jacobian - reverse.jacobian) <= 1e-9 * size)
    room = int(np.median(steps))
    monkeypatch.setattr(tangents, "CHECKPOINTS", room)
    short = differentiate(study, np.arange(RUNS), 0, settings=settings.replace(adjoint="reverse"), **asked)
    np.testing.assert_array_equal(short.is_known.all(axis=1), steps <= room)
    assert not short.jacobian[steps > room].any()

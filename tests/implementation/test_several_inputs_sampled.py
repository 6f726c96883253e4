"""Digital controllers of several inputs: against SciPy from event to event, and against scalar loops."""

import dataclasses
import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import qsmc_jax as qj
from own_plants import Scalar
from qsmc_jax.base.module import float_field
from several_held_loops import Held, simulate, tangent

T1, FUNNELS, GAIN = 3.0, ((4.0, 1.5, 0.4), (6.0, 1.0, 0.5)), 3.0
MATRIX, X0, TAU = ((2.0, 0.9), (-0.4, 1.0)), [0.3, -0.1, 0.9], 0.02
PUSHES = ((2.5, 3.0), (2.0, 4.0))


class Mixed(qj.AbstractStateSpace):
    """A state of the first order beside one of the second, each moved by both inputs."""

    coupling: Float[Array, ""] = float_field(default=1.0)
    matrix: Float[Array, "2 2"] = float_field(default=MATRIX)

    states, relative_degrees = 3, (1, 2)

    def vector_field(self, t, x, d):
        """A pendulum, and what each does to the other."""
        pull = -jnp.sin(x[1]) - self.coupling * jnp.cos(x[0]) * x[2]
        return self.coupling * jnp.sin(x[1]) - x[0] + d[0], x[2], pull + d[1]

    def input_matrix(self, t, x):
        """Both inputs move both."""
        (a, b), (c, d) = self.matrix
        return (a, b), (0.0, 0.0), (c, d)

    def output(self, t, x):
        """The first two states."""
        return x[0], x[1]


def by_hand(matrix=MATRIX, coupling=1.0):
    """Its rates under two sines, in NumPy."""

    def rates(t, x, u):
        v = np.asarray(matrix) @ u + [size * math.sin(w * t) for size, w in PUSHES]
        pull = -math.sin(x[1]) - coupling * math.cos(x[0]) * x[2]
        return [coupling * math.sin(x[1]) - x[0] + v[0], x[2], pull + v[1]]

    return rates


SIGMAS = (
    lambda t, x: x[0] - 0.5 * np.sin(2.0 * t),
    lambda t, x: 2.0 * (x[1] - 0.8 * np.sin(1.1 * t)) + x[2] - 0.88 * np.cos(1.1 * t),
)
RHOS = tuple(lambda t, r0=r0, mu=mu, r=r: r0 * np.exp(-mu * t) + r for r0, mu, r in FUNNELS)
SURFACES = qj.SlidingSurface([]), qj.SlidingSurface([2.0])
FUNNEL = tuple(qj.Funnel(*each) for each in FUNNELS)
LAWS = tuple(qj.QuasiSlidingControl(*each, gain=GAIN, is_scaled=True) for each in zip(SURFACES, FUNNEL, strict=True))


LIMITED = qj.Implementation(TAU, saturation=8.0)


def loop_of(made, controls=LAWS, plant=None):
    """The loop with an implementation."""
    references = qj.references.SumOfSines([0.5], [2.0]), qj.references.SumOfSines([0.8], [1.1])
    disturbances = tuple(qj.disturbances.Sine(*each) for each in PUSHES)
    return qj.MultivariableLoop(Mixed() if plant is None else plant, references, disturbances, controls, made)


def channels(*options):
    """Both channels for SciPy, with the options of each."""
    law = lambda sigma, rho, memory: (tangent(GAIN, sigma, rho), memory)  # noqa: E731
    return [
        Held(*each, **{"law": law, "period": TAU, **more}) for *each, more in zip(SIGMAS, RHOS, options, strict=True)
    ]


def check(run, expected, rel=1e-6):
    """Peaks and energy of each channel, the end, and when each first was outside."""
    x1, peaks, energy, first = expected
    f = run.metrics.channels
    for i, peak in enumerate(peaks):
        assert float(f[f"peak_ratio[{i}]"]) == pytest.approx(peak, rel=rel)
        assert float(f[f"violation_time[{i}]"]) == pytest.approx(first[i], rel=1e-4)
        assert run.verdicts[f"funnel[{i}]"].name == ("HELD" if peak < 1.0 else "VIOLATED")
    assert float(run.metrics.peak_ratio) == pytest.approx(max(peaks), rel=rel)
    assert run.verdict.name == ("HELD" if max(peaks) < 1.0 else "VIOLATED")
    assert float(run.metrics.energy_u) == pytest.approx(energy.sum(), rel=1e-4)
    np.testing.assert_allclose(run.x[-1], x1, rtol=1e-5, atol=1e-6)


@pytest.mark.parametrize("period", [TAU, 0.3], ids=["fast", "slow"])
def test_held_inputs_are_scipys_and_so_is_where_they_are_too_slow(period):
    each = {"period": period, "saturation": 8.0}
    expected = simulate(by_hand(), channels(each, each), X0, T1)
    assert (expected[1].max() > 1.0) == (period > TAU)
    made = dataclasses.replace(LIMITED, sample_period=period)
    check(qj.simulate(loop_of(made), X0, T1, bandwidth=1.0, settings=qj.tight()), expected)


class Leaky(qj.AbstractControl):
    """A linear law with a memory: a leaky sum of the sliding variable as measured."""

    surface: qj.SlidingSurface
    funnel: qj.AbstractFunnel
    gain_sign: Float[Array, ""] = float_field(default=1.0)
    positive: ClassVar[tuple[str, ...]] = ()

    def first_memory(self):
        """Nothing yet."""
        return (jnp.zeros(()),)

    def command(self, sample, memory):
        """Both parts."""
        kept = 0.9 * memory[0] + sample.period * sample.sigma
        return -4.0 * sample.sigma - 5.0 * kept, (kept,)


def leaky(sigma, rho, memory):
    """The same by hand."""
    kept = 0.9 * memory + 0.03 * sigma
    return -4.0 * sigma - 5.0 * kept, kept


def test_each_channel_has_a_computer_and_an_actuator_of_its_own():
    tremble = qj.noises.Signals(tuple(qj.disturbances.Sine(1e-2, 40.0 + i) for i in range(3)))
    made = qj.Implementation(
        (TAU, 0.03),
        delay=(0.007, 0.011),
        saturation=(4.0, 2.5),
        rate_limit=(1e4, 50.0),
        input_resolution=(0.0, 1e-3),
        noise=tremble,
        actuator=(qj.actuators.FirstOrderLag(0.02), None),
        gain_fault=(None, qj.GainFault(1.0, 1.4, 0.6)),
    )
    run = qj.simulate(
        loop_of(made, (LAWS[0], Leaky(SURFACES[1], FUNNEL[1]))), X0, T1, bandwidth=1.0, settings=qj.tight()
    )
    first = {"delay": 0.007, "saturation": 4.0, "rate_limit": 1e4, "lag": 0.02}
    second = {"law": leaky, "period": 0.03, "delay": 0.011, "saturation": 2.5, "rate_limit": 50.0, "resolution": 1e-3}
    both = channels(first, {**second, "fault": lambda t: 0.6 if 1.0 <= t < 1.4 else 1.0})
    measured = lambda x, t: x + 1e-2 * np.sin((40.0 + np.arange(3)) * t)  # noqa: E731
    check(run, simulate(by_hand(), both, X0, T1, (1.0, 1.4), measured), rel=1e-5)
    assert run.metrics.channels["max_u[0]"] <= 4.0
    assert float(run.metrics.channels["min_u[1]"]) >= -2.5


class Apart(qj.AbstractStateSpace):
    """Two scalar plants that know nothing of each other."""

    states, relative_degrees = 2, (1, 1)

    def vector_field(self, t, x, d):
        """A disturbance on each."""
        return d

    def input_matrix(self, t, x):
        """Each has its own input."""
        return (2.0, 0.0), (0.0, 0.7)

    def output(self, t, x):
        """Both states."""
        return x[0], x[1]


@pytest.mark.slow
def test_channels_that_do_not_touch_are_scalar_runs():
    controls = tuple(
        qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel, gain=GAIN, is_scaled=True) for funnel in FUNNEL
    )
    made = qj.Implementation((TAU, 0.03), delay=(0.004, 0.009), saturation=5.0, cutoff=20.0)
    tight, x0 = qj.SolverSettings(rtol=1e-12, max_steps=1_000_000), [1.5, -0.8]
    loop = loop_of(made, controls, Apart())
    run = qj.simulate(loop, x0, T1, bandwidth=(1.0, 1.2), settings=tight)
    summed = {"energy_u": 0.0, "total_variation_u": 0.0, "excess_variation_u": 0.0}
    for i, (gain, width) in enumerate(((2.0, 1.0), (0.7, 1.2))):
        alone = dataclasses.replace(made, sample_period=(TAU, 0.03)[i], delay=(0.004, 0.009)[i])
        parts = loop.references[i], loop.disturbances[i], controls[i], alone
        scalar = qj.simulate(qj.ClosedLoop(Scalar(gain), *parts), x0[i : i + 1], T1, bandwidth=width, settings=tight)
        for name in ("peak_ratio", "margin", "max_u", "min_u", "reach_time", "rms_error"):
            expected = float(getattr(scalar.metrics, name))
            assert float(run.metrics.channels[f"{name}[{i}]"]) == pytest.approx(expected, rel=1e-9), name
        np.testing.assert_allclose(run.x[:, i], scalar.x[:, 0], atol=1e-9)
        np.testing.assert_allclose(run.u[:, i], scalar.u, atol=1e-8)
        np.testing.assert_allclose(run.metrics.peak_errors[i], scalar.metrics.peak_errors[0], rtol=1e-9)
        known = scalar.metrics.named()
        summed = {name: value + float(known[name]) for name, value in summed.items()}
    for name, value in summed.items():
        assert float(run.metrics.named()[name]) == pytest.approx(value, rel=1e-7), name


@pytest.mark.parametrize("x0", [[4.5, -0.8, 0.2], [1.5, -0.8, 9.0]])
def test_a_start_outside_in_one_channel_admits_none(x0):
    run = qj.simulate(loop_of(LIMITED), x0, T1, bandwidth=1.0, settings=qj.tight())
    assert {verdict.name for verdict in run.verdicts.values()} == {"INADMISSIBLE"}


def test_what_is_told_of_a_run_has_each_channel():
    run = qj.simulate(loop_of(LIMITED), X0, T1, bandwidth=1.0, settings=qj.tight())
    assert "channel 1: HELD" in str(run)
    assert "together" not in str(run)
    assert {"x[2]", "sigma[1]", "u[1]", "d[0]"} <= set(run.columns())
    for i, (sigma, rho) in enumerate(zip(SIGMAS, RHOS, strict=True)):
        np.testing.assert_allclose(run.sigma[:, i], sigma(run.ts, np.asarray(run.x).T), atol=1e-12)
        held = [tangent(GAIN, sigma(t, run.x[k]), rho(t)) for k, t in enumerate(run.ts[:-1]) if t / TAU % 1.0 < 1e-9]
        assert len(held) > 10
        assert np.isin(np.round(held, 6), np.round(np.asarray(run.u[:, i]), 6)).all()


class Bump(qj.AbstractDisturbance):
    """A push of a hundred thousandth of a second, of which nothing is said."""

    size: Float[Array, ""] = float_field()

    def __call__(self, t):
        """About 0.6137 s."""
        return self.size * jnp.exp(-(((t - 0.6137) / 1e-5) ** 2))

    @property
    def bound(self):
        """Its height."""
        return jnp.abs(self.size)

    @property
    def break_times(self):
        """None."""
        return jnp.zeros((0,))


def test_a_short_push_on_one_channel_is_not_stepped_over_in_a_long_hold():
    far = 1e5  # so far out that the push is nothing to the state, only to its channel's funnel
    calm, rest = qj.disturbances.Zero(), (qj.references.Constant(0.0), qj.references.Constant(far))
    control = qj.QuasiSlidingControl(SURFACES[0], qj.Funnel(1.0, 1.0, 0.5), gain=1e-3)
    loop = qj.MultivariableLoop(Apart(), rest, (calm, Bump(1e5)), (control, control), qj.Implementation(0.5))
    run = qj.simulate(loop, [0.1, far], 1.0, bandwidth=0.8)
    pushed = 1e5 * 1e-5 * math.sqrt(math.pi)
    assert {f"funnel[{i}]": run.verdicts[f"funnel[{i}]"].name for i in range(2)} == {
        "funnel[0]": "HELD",
        "funnel[1]": "VIOLATED",
    }
    assert float(run.metrics.channels["violation_time[1]"]) == pytest.approx(0.6137, abs=2e-5)
    assert float(run.x[-1, 1]) - far == pytest.approx(pushed, rel=1e-3)


WRONG = {
    "count": (lambda: loop_of(qj.Implementation(TAU, delay=(1e-3, 1e-3, 1e-3))), "`delay` of the implementation must"),
    "scalar": (
        lambda: dataclasses.replace(qj.paper.example1(), implementation=qj.Implementation((TAU, TAU))),
        "`sample_period` of the implementation must be one, no list, for a single input",
    ),
    "unmatched": (lambda: loop_of(qj.Implementation(TAU, unmatched=(qj.disturbances.Zero(),))), "`unmatched`"),
    "noise": (
        lambda: qj.simulate(loop_of(qj.Implementation(TAU, noise=qj.noises.Uniform([0.1]))), X0, T1, bandwidth=1.0),
        "`noise` must fit a plant with 3 states, but is for 1",
    ),
    "range": (lambda: qj.Implementation(TAU, input_range=((0.0, 1.0), (1.0, 0.0))), "low < high"),
    "ideal": (
        lambda: loop_of(None, (LAWS[0], Leaky(SURFACES[1], FUNNEL[1]))),
        "`implementation` must be given for a `Leaky`",
    ),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_named(name):
    make, says = WRONG[name]
    with pytest.raises(qj.InputError, match=says):
        make()

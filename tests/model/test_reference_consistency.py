"""A reference whose derivatives contradict each other is refused where it is solved; its break times are stepped to."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from scipy.integrate import solve_ivp

import qsmc_jax as qj
from qsmc_jax.base.module import float_field

FUNNEL = (4.0, 1.0, 0.05)


class Reference(qj.AbstractReference):
    """Any derivatives, and declared times."""

    function: object
    times: object = ()

    def derivatives(self, t, order):
        return self.function(t)[: order + 1]

    @property
    def break_times(self):
        return self.times


def mass(degree):
    """A mass with so many integrators."""

    class Mass(qj.AbstractPlant):
        order = degree

        def drift(self, t, x):
            return 0.0 * x[0]

        def gain(self, t, x):
            return 1.0

    return Mass()


def loop(reference, order=2):
    control = qj.QuasiSlidingControl(qj.SlidingSurface.binomial(2.0, order), qj.Funnel(*FUNNEL))
    return qj.ClosedLoop(mass(order), reference, qj.disturbances.Zero(), control)


def scenario(function, t1=10.0, order=2, times=()):
    return qj.Scenario(loop(Reference(function, times), order), [0.1] * order, t1)


def wave(t, slope=1.0, second=1.0, third=1.0):
    return jnp.sin(3 * t), slope * 3 * jnp.cos(3 * t), -second * 9 * jnp.sin(3 * t), -third * 27 * jnp.cos(3 * t)


WRONG = {
    "no derivative": (lambda t: (jnp.sin(t), 0.0, 0.0), 2, 1, "its value"),
    "factor forgotten": (lambda t: wave(t, slope=1.0 / 3.0), 2, 1, "its value"),
    "sign": (lambda t: wave(t, second=-1.0), 2, 2, "derivative 1"),
    "last one": (lambda t: wave(t, third=0.0), 3, 3, "derivative 2"),
    "a thousandth": (lambda t: wave(t, second=1.001), 2, 2, "derivative 1"),
    "in one piece only": (lambda t: (jnp.sin(t), jnp.where(t < 9.5, jnp.cos(t), 0.0), -jnp.sin(t)), 2, 1, "its value"),
    "ramp": (lambda t: (2.0 * t, 1.9, 0.0), 2, 1, "its value"),
}


@pytest.mark.parametrize(("function", "order", "k", "before"), WRONG.values(), ids=WRONG)
def test_derivatives_that_contradict_each_other_are_named(function, order, k, before):
    with pytest.raises(
        ValueError, match=f"Derivative {k} of `Reference` must be the derivative in time of {before}, but at t ="
    ):
        scenario(function, order=order)
    if k == order == 3:
        scenario(function, order=2)  # what is not used is not asked


def test_the_message_has_the_time_and_both_values():
    with pytest.raises(ValueError, match=r"at t = \S+ s it is 1.9 instead of 2. Mend .* `qj.references.Smooth\(fn\)`"):
        scenario(WRONG["ramp"][0])


def test_simulate_asks_too():
    with pytest.raises(ValueError, match="Derivative 1 of `Reference` must be"):
        qj.simulate(loop(Reference(WRONG["no derivative"][0])), [0.1, 0.1], 10.0)


def test_a_piece_between_break_times_is_asked_however_short_it_is():
    def function(t):
        return jnp.sin(t), jnp.where((t > 5.0) & (t < 5.00001), 0.0, jnp.cos(t)), -jnp.sin(t)

    with pytest.raises(ValueError, match=r"Derivative 1 .* at t = 5.00001 s it is 0 instead of 0.28366"):
        scenario(function, times=(5.0, 5.00001))


RIGHT = {
    "wave": wave,
    "numbers of Python": lambda t: (2.0 * t, 2.0, 0.0, 0.0),
    "rounded by other formulas": lambda t: (jnp.sin(t) * jnp.cos(t), jnp.cos(2 * t), -4 * jnp.sin(t) * jnp.cos(t)),
    "large offset": lambda t: (1e9 + 1e-3 * jnp.sin(t), 1e-3 * jnp.cos(t), -1e-3 * jnp.sin(t)),
    "growing": lambda t: (jnp.exp(2 * t), 2 * jnp.exp(2 * t), 4 * jnp.exp(2 * t)),
    "joined": lambda t: (
        jnp.where(t < 5, 0, (t - 5) ** 2),
        jnp.where(t < 5, 0, 2 * (t - 5)),
        jnp.where(t < 5, 0.0, 2.0),
    ),
    "constant": lambda t: (1.0, 0.0, 0.0),
    "a step": lambda t: (jnp.where(t < 5.0, 0.0, 1.0), 0.0 * t, 0.0 * t),  # its pieces agree; the solve finds the jump
}


@pytest.mark.parametrize("function", RIGHT.values(), ids=RIGHT)
def test_derivatives_that_agree_pass(function):
    scenario(function)


@jax.custom_vjp
def backward_only(t):
    return jnp.sin(t)


backward_only.defvjp(lambda t: (jnp.sin(t), t), lambda t, g: (g * jnp.cos(t),))


def test_what_can_not_be_differentiated_passes():
    scenario(lambda t: (backward_only(t), jnp.cos(t), -jnp.sin(t)))


class Scaled(qj.AbstractReference):
    """A sine with a factor on its derivative that ought to be one."""

    factor: Float[Array, ""] = float_field()

    def derivatives(self, t, order):
        return (jnp.sin(t), self.factor * jnp.cos(t), -jnp.sin(t))[: order + 1]


def test_the_nominal_scenario_of_a_study_is_asked_and_traced_numbers_pass():
    def study(low, high):
        return qj.Study(lambda draw: qj.Scenario(loop(Scaled(draw.uniform("f", low, high))), [0.1, 0.1], 5.0), 0.1)

    study(0.9, 1.1)
    with pytest.raises(ValueError, match="Derivative 1 of `Scaled` must be"):
        study(0.8, 1.0)


def test_plain_numbers_are_asked_inside_a_trace():
    with pytest.raises(ValueError, match="Derivative 1 of `Scaled` must be"):
        jax.jit(lambda x: qj.Scenario(loop(Scaled(0.5)), jnp.stack([x, x]), 5.0).x0)(0.1)


def test_a_loop_has_the_break_times_of_its_reference_too():
    assert qj.references.Constant(1.0).break_times.shape == (0,)
    assert list(np.concatenate(loop(Reference(wave, [1.0, np.inf])).breaks_by_part)) == [1.0, np.inf]


@pytest.mark.slow
def test_a_reference_whose_second_derivative_jumps_is_followed():
    """Against SciPy, started anew where the acceleration begins and ends."""
    a, start, end = 30.0, 3.0, 3.01

    def desired(t, lib=np):
        s = lib.clip(t - start, 0.0, end - start)
        after = lib.maximum(t - end, 0.0)
        is_on = (t >= start) & (t < end)
        return 0.5 * a * s**2 + a * s * after, a * s, lib.where(is_on, a, 0.0)

    def rate(t, x):
        value, slope, _ = desired(t)
        rho = FUNNEL[0] * np.exp(-FUNNEL[1] * t) + FUNNEL[2]
        sigma = 2.0 * (x[0] - value) + x[1] - slope
        return [x[1], -np.tan(0.5 * np.pi * sigma / rho)]

    x, peak = [0.1, 0.1], 0.0
    for t0, t1 in ((0.0, start), (start, end), (end, 6.0)):
        piece = solve_ivp(rate, (t0, t1), x, "LSODA", rtol=1e-11, atol=1e-13, dense_output=True)
        ts = np.linspace(t0, t1, 4001)
        (value, slope, _), y = desired(ts), piece.sol(ts)
        rho = FUNNEL[0] * np.exp(-FUNNEL[1] * ts) + FUNNEL[2]
        peak = max(peak, np.max(np.abs(2.0 * (y[0] - value) + y[1] - slope) / rho))
        x = piece.y[:, -1]
    reference = Reference(lambda t: desired(t, jnp), (start, end))
    run = qj.simulate(loop(reference), [0.1, 0.1], 6.0, ts=np.array([0.0, 6.0]))
    assert float(run.metrics.peak_time) > start  # the acceleration is what decides
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, rel=1e-5)

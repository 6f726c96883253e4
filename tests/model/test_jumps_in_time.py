"""Jumps in time are accepted, declared or not, and declared ones of a plant are met, however short."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float
from scipy.integrate import solve_ivp

import problems
import qsmc_jax as qj
from mistakes import Push
from qsmc_jax.base.module import float_field

SINE = qj.references.SumOfSines([0.3], [1.0])
WIDTH, HEIGHT, AT = 1e-3, 400.0, 2.0


def knots(t):
    return jnp.interp(t, jnp.array([0.0, 1.0]), jnp.array([0.0, 1.0]))


JUMPING = {
    "where": lambda t: jnp.where(t < 1.0, 0.0, 1.0),
    "inside jit": jax.jit(lambda t: jnp.where(2.0 * t >= 1.0, 0.0, 1.0)),
    "sign": lambda t: jnp.sign(jnp.sin(t)),
    "floor": jnp.floor,
    "sign bit": lambda t: jnp.where(jnp.signbit(t - 1.0), 0.0, 1.0),
    "copied sign": lambda t: jnp.copysign(1.0, t - 1.0),
    "remainder": lambda t: jnp.mod(t, 1.0),
    "to an integer": lambda t: jnp.asarray(jnp.asarray(t, int), float),
    "cond": lambda t: jax.lax.cond(t < 1.0, jnp.sin, jnp.cos, t),
    "inside a branch": lambda t: jax.lax.switch(0, [jnp.sin, lambda s: jnp.where(s < 1.0, 0.0, 1.0)], t),
    "interpolation": knots,
}
QUIET = {
    "sine": jnp.sin,
    "constant": lambda t: 1.0,
    "kink": lambda t: jnp.abs(t - 1.0),
    "clipped": lambda t: jnp.clip(t, 0.0, 1.0),
    "sinc": jnp.sinc,
    "softplus": jax.nn.softplus,
    "constants compared": lambda t: t * jnp.where(jnp.asarray(2.0) < 1.0, 0.0, 1.0),
    "nothing compared": lambda t: jnp.sum(jnp.where(t < jnp.zeros(0), 1.0, 0.0)),
    "elu": lambda t: jax.nn.elu(t - 1.0),
    "selu": lambda t: jax.nn.selu(t - 1.0),
    "leaky": lambda t: jax.nn.leaky_relu(t - 1.0),
    "log of sum": lambda t: jax.nn.logsumexp(jnp.stack([t, 1.0 - t])),
    "joined": lambda t: jnp.where(t < 1.0, t**2, 2.0 * t - 1.0),
}
IN_TIME = JUMPING | QUIET


class Drifting(qj.AbstractPlant):
    """Any function of time and state."""

    function: object
    order = 2

    def drift(self, t, x):
        return self.function(t, x)

    def gain(self, t, x):
        return 1.0


@pytest.mark.parametrize("function", IN_TIME.values(), ids=IN_TIME)
def test_any_function_of_time_is_accepted_whatever_is_declared(function):
    for times in ((), np.array([1.0])):
        assert float(Push(function, times)(0.25)) == float(function(0.25))
    Drifting(lambda t, x: x[0] + function(t))
    Drifting(lambda t, x: x[0] * function(t))


@pytest.mark.parametrize("times", [[1.0], (1.0,), 1.0, np.inf, np.array([1.0, np.inf])], ids=str)
def test_break_times_may_be_given_in_any_form(times):
    one = Push(JUMPING["where"], times)
    assert list((one + one).break_times) == 2 * list(np.atleast_1d(times))


class Stepped(qj.AbstractDisturbance):
    """A step of which the time can be drawn."""

    at: Float[Array, ""] = float_field()

    def __call__(self, t):
        return jnp.where(t < self.at, 0.0, 1.0)

    @property
    def bound(self):
        return 1.0

    @property
    def break_times(self):
        return [self.at]


def test_a_traced_time_can_be_declared():
    assert jax.jit(lambda at: jnp.sum(Stepped(at).break_times[0]))(2.0) == 2.0
    assert list(jax.vmap(lambda at: (2.0 * Stepped(at) + 1.0).break_times)(jnp.arange(3.0))[:, 0]) == [0.0, 1.0, 2.0]


class Branching(qj.AbstractPlant):
    """Python asks what a number is, which in a solve it can't know."""

    limit: Float[Array, ""] = float_field()
    order = 1

    def drift(self, t, x):
        return -x[0] if self.limit > 1.0 else x[0]

    def gain(self, t, x):
        return 1.0


def test_a_branch_on_a_number_of_the_plant_is_refused_whatever_the_number_is():
    for limit in (2.0, 0.5):
        with pytest.raises(ValueError, match="with `jnp.where` in place of a Python `if`"):
            Branching(limit)


class Kicked(qj.AbstractPlant):
    """An integrator that is pushed for a millisecond, and says so."""

    height: float
    unused: int = eqx.field(static=True, default=0)
    order = 1

    def drift(self, t, x):
        return jnp.where((t >= AT) & (t < AT + WIDTH), self.height, 0.0)

    def gain(self, t, x):
        return 1.0

    @property
    def break_times(self):
        return [*[jnp.inf] * self.unused, AT, AT + WIDTH]


def kicked(implementation=None, unused=0):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.5))
    return qj.ClosedLoop(Kicked(HEIGHT, unused), SINE, qj.disturbances.Zero(), control, implementation)


def rho(t):
    return 2.0 * np.exp(-t) + 0.5


@pytest.mark.parametrize("unused", [0, 200])
@pytest.mark.slow
def test_a_push_of_a_millisecond_that_a_plant_declares_is_met(unused):
    """Against SciPy, which is started anew at the push and after it; however many places for breaks are not used."""

    def rate(push):
        return lambda t, x: push - np.tan(0.5 * np.pi * (x - 0.3 * np.sin(t)) / rho(t))

    x, peak = [0.1], 0.0
    for start, end, push in ((0.0, AT, 0.0), (AT, AT + WIDTH, HEIGHT), (AT + WIDTH, 5.0, 0.0)):
        piece = solve_ivp(rate(push), (start, end), x, method="LSODA", rtol=1e-11, atol=1e-13, dense_output=True)
        ts = np.linspace(start, end, 20_001)
        peak = max(peak, np.max(np.abs(piece.sol(ts)[0] - 0.3 * np.sin(ts)) / rho(ts)))
        x = piece.y[:, -1]
    run = qj.simulate(kicked(unused=unused), [0.1], 5.0)
    assert int(run.metrics.steps) < 200  # it is not searched for
    assert peak > 0.5  # the push is what decides
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, rel=1e-5)
    assert float(run.metrics.peak_time) == pytest.approx(AT + WIDTH, abs=1e-6)


def test_a_sampled_loop_meets_it_too():
    """Between samples the input is constant, and the state is known in closed form."""
    period, x, peak = 0.01, 0.1, 0.0
    for k in range(500):
        start = k * period
        u = -np.tan(0.5 * np.pi * (x - 0.3 * np.sin(start)) / rho(start))
        ts = start + np.linspace(0.0, period, 2001)
        xs = x + u * (ts - start) + HEIGHT * (np.clip(ts, AT, AT + WIDTH) - np.clip(start, AT, AT + WIDTH))
        peak, x = max(peak, np.max(np.abs(xs - 0.3 * np.sin(ts)) / rho(ts))), xs[-1]
    run = qj.simulate(kicked(qj.Implementation(period)), [0.1], 5.0)
    assert peak > 0.5
    assert float(run.metrics.peak_ratio) == pytest.approx(peak, rel=1e-5)


@pytest.mark.parametrize("width", [1e-2, 1e-3, 1e-4])
def test_a_disturbance_that_is_on_for_a_part_of_a_hold_is_met(width):
    """From rest sigma rises by its area, and stays there until the next sample; no cell is short by itself."""
    size, start = 0.06, 0.53
    zero, push = qj.disturbances.Constant(0.0), qj.disturbances.Constant(size / width)
    pulse = qj.disturbances.Piecewise([start, start + width], (zero, push, zero))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.5))
    loop = qj.ClosedLoop(
        problems.chain(1)(), qj.references.Constant(0.0), pulse, control, qj.Implementation(sample_period=0.2)
    )
    run = qj.simulate(loop, [0.0], 0.6, ts=np.array([0.0, 0.6]))
    assert float(run.metrics.peak_ratio) == pytest.approx(size / rho(0.6), rel=1e-6)


@pytest.mark.parametrize("width", [1e-2, 1e-3, 1e-4])
def test_a_gain_fault_that_is_on_for_a_part_of_a_hold_is_met(width):
    """The input stands still, and for the width of the fault counts by its factor."""
    start, period, lost = 0.3, 0.2, 0.1
    fault = qj.GainFault(0.053, 0.053 + width, factor=1.0 - lost / width)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.5))
    plan = qj.Implementation(period, gain_fault=fault)
    loop = qj.ClosedLoop(problems.chain(1)(), qj.references.Constant(0.0), qj.disturbances.Zero(), control, plan)
    run = qj.simulate(loop, [start], period, ts=np.array([0.0, period]))
    u = -np.tan(0.5 * np.pi * start / rho(0.0))
    assert float(run.x[-1, 0]) == pytest.approx(start + u * (period - lost), rel=1e-6)

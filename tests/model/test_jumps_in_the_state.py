"""Drift and gain that jump in the state are refused, with the place and the height; what is continuous is accepted."""

import re

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.module import float_field

KNOTS, VALUES = jnp.array([0.0, 1.0, 2.0, 3.0]), jnp.array([0.0, 1.0, 0.0, 5.0])


class Plant(qj.AbstractPlant):
    """Any function as drift and as gain."""

    f: object
    g: object = lambda t, x: 1.0
    order = 2

    def drift(self, t, x):
        return self.f(t, x)

    def gain(self, t, x):
        return self.g(t, x)


def number(text):
    return r"(-?[0-9.e+-]+)" if text is None else text


def scenario(plant):
    """A run of a plant."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(4.0, 3.0, 0.05))
    loop = qj.ClosedLoop(plant, qj.references.Constant(0.0), qj.disturbances.Zero(), control)
    return qj.Scenario(loop, [0.5, 0.3], 1.0)


def asked(plant):
    """Has a plant asked whether it jumps, as the nominal run of a study is."""
    qj.Study(lambda draw: scenario(plant), bandwidth=0.1)


SAID = re.compile(
    rf"`(drift|gain)` of `Plant` must be continuous in the state, but jumps from {number(None)} to {number(None)} at "
    rf"t = {number(None)}, x = \({number(None)}, {number(None)}\)"
)


def refused(f, g=lambda t, x: 1.0):
    """Which method jumps, the values before and after, the time and the state, as the message says."""
    with pytest.raises(ValueError, match=r"Round it .* `qj.smoothed.sign\(v, width\)`") as error:
        asked(Plant(f, g))
    method, *rest = SAID.match(str(error.value)).groups()
    return method, [float(part) for part in rest]


# A function of one state, where it jumps, and from what to what; the jump nearest to zero where there are many.
JUMPS = {
    "sign": (jnp.sign, 0.0, -1.0, 1.0),
    "friction": (lambda v: -3.0 * jnp.sign(v), 0.0, 3.0, -3.0),
    "shifted": (lambda v: jnp.sign(v - 0.37), 0.37, -1.0, 1.0),
    "far away": (lambda v: jnp.where(v > -4321.5, 2.0, 1.0), -4321.5, 1.0, 2.0),
    "close to zero": (lambda v: jnp.where(v > 1e-4, 2.0, 1.0), 1e-4, 1.0, 2.0),
    "small": (lambda v: 1e-12 * jnp.sign(v), 0.0, -1e-12, 1e-12),
    "on a slope": (lambda v: 1e3 * v - 1e-3 * jnp.sign(v), 0.0, 1e-3, -1e-3),
    "a narrow band": (lambda v: jnp.where((v > 0.3) & (v < 0.3001), 1.0, 0.0), 0.3, 0.0, 1.0),
    "quantised": (lambda v: 0.01 * jnp.floor(v / 0.01), 0.0, -0.01, 0.0),
    "upwards": (lambda v: jnp.ceil(v - 0.3), 0.3, 0.0, 1.0),
    "rounded": (lambda v: jnp.round(v - 0.2), -0.3, -1.0, 0.0),
    "an integer": (lambda v: jnp.asarray(jnp.asarray(v - 0.5, int), float), -0.5, -1.0, 0.0),
    "remainder": (lambda v: jnp.mod(v - 0.5, 10.0), 0.5, 10.0, 0.0),
    "quotient": (lambda v: v / jnp.abs(v), 0.0, -1.0, 1.0),
    "shifted quotient": (lambda v: (v - 0.37) / jnp.abs(v - 0.37), 0.37, -1.0, 1.0),
    "root": (lambda v: v / jnp.sqrt(v**2), 0.0, -1.0, 1.0),
    "angle": (lambda v: jnp.arctan2(jnp.sin(v - 1.0), jnp.cos(v - 1.0)), 1.0 - np.pi, np.pi, -np.pi),
    "tangent": (lambda v: jnp.arctan(jnp.tan(v - 0.1)), 0.1 - np.pi / 2, np.pi / 2, -np.pi / 2),
    "sign bit": (lambda v: jnp.where(jnp.signbit(v - 2.0), 1.0, 0.0), 2.0, 1.0, 0.0),
    "copied sign": (lambda v: jnp.copysign(2.0, v), 0.0, -2.0, 2.0),
    "branch": (lambda v: jax.lax.cond(v > 1.0, lambda: 5.0, lambda: 4.0), 1.0, 4.0, 5.0),
    "inside a branch": (lambda v: jax.lax.cond(v > -1e6, jnp.sign, jnp.abs, v - 1.0), 1.0, -1.0, 1.0),
    "inside jit": (jax.jit(jnp.sign), 0.0, -1.0, 1.0),
    "checkpoint": (jax.checkpoint(jnp.sign), 0.0, -1.0, 1.0),
    "table": (lambda v: VALUES[jnp.searchsorted(KNOTS, v - 0.25)], 0.25, 0.0, 1.0),
    "dead band": (lambda v: jnp.where(jnp.abs(v) < 0.1, 0.0, v + 5.0), -0.1, 4.9, 0.0),
}


@pytest.mark.parametrize(("function", "at", "before", "after"), JUMPS.values(), ids=JUMPS)
def test_a_jump_in_the_state_is_refused_where_it_is_and_as_high_as_it_is(function, at, before, after):
    method, (*heights, _, position, velocity) = refused(lambda t, x: function(x[1]) + 0.0 * x[0])
    assert method == "drift"
    assert velocity == pytest.approx(at, rel=1e-5)
    assert heights == pytest.approx([before, after], rel=1e-3, abs=1e-6 * max(abs(before), abs(after)))


CONTINUOUS = {
    "clipped": lambda v: jnp.clip(v, -1.0, 1.0),
    "drag": lambda v: v * jnp.abs(v),
    "drag by sign": lambda v: v**2 * jnp.sign(v),
    "root by sign": lambda v: jnp.sqrt(jnp.abs(v)) * jnp.sign(v),
    "elu": jax.nn.elu,
    "selu": jax.nn.selu,
    "leaky": jax.nn.leaky_relu,
    "relu": jax.nn.relu,
    "softplus": jax.nn.softplus,
    "log of sum": lambda v: jax.nn.logsumexp(jnp.stack([v, 1.0 - v])),
    "interpolation": lambda v: jnp.interp(v, KNOTS, VALUES),
    "joined": lambda v: jnp.where(v > 1.0, v**2, 2.0 * v - 1.0),
    "joined at zero": lambda v: jnp.where(v > 0.0, 3.0 * v, 0.5 * v),
    "dead zone": lambda v: jnp.where(jnp.abs(v) < 0.1, 0.0, v - 0.1 * jnp.sign(v)),
    "steep": lambda v: jnp.where(jnp.abs(v) < 1e-9, v / 1e-9, jnp.sign(v)),
    "triangle": lambda v: jnp.abs(jnp.mod(v, 2.0) - 1.0),
    "wrapped angle": lambda v: jnp.sin(jnp.mod(v + jnp.pi, 2.0 * jnp.pi) - jnp.pi),
    "equal by rounding only": lambda v: jnp.where(v > 1.0, 0.1 * 3.0, 0.3),
    "removable": lambda v: jnp.sinc(v),
    "guarded": lambda v: jnp.where(jnp.abs(v) < 1e-3, 1.0 - v**2 / 6.0, jnp.sin(v) / jnp.where(v == 0.0, 1.0, v)),
    "pole": lambda v: 1.0 / v,
    "shifted pole": lambda v: 1.0 / (v - 0.37),
    "tangent": jnp.tan,
    "rational": lambda v: v / (1.0 + v**2),
    "smoothed sign": lambda v: qj.smoothed.sign(v, 1e-9),
    "smoothed gap": lambda v: qj.smoothed.dead_zone(v, 0.1, 1e-6),
}


@pytest.mark.parametrize("function", CONTINUOUS.values(), ids=CONTINUOUS)
@pytest.mark.slow
def test_what_is_continuous_in_the_state_is_accepted(function):
    asked(Plant(lambda t, x: function(x[1]) - x[0]))


def test_a_jump_is_found_along_any_axis_and_in_sums_of_states():
    assert refused(lambda t, x: jnp.sign(x[0] - 0.5) - x[1])[1][3] == 0.5
    _, (*_, position, velocity) = refused(lambda t, x: jnp.where(x[0] + 2.0 * x[1] > 1.234, 1.0, 0.0))
    assert position + 2.0 * velocity == pytest.approx(1.234, rel=1e-5)


def test_a_relay_in_the_gain_is_refused():
    method, (before, after, *_) = refused(lambda t, x: -x[0], lambda t, x: 2.0 + jnp.sign(x[0]))
    assert (method, before, after) == ("gain", 1.0, 3.0)


def test_jumps_in_time_are_accepted_also_where_the_state_enters():
    asked(
        Plant(lambda t, x: jnp.where(t < 5.0, -4.9, -9.8) * jnp.sin(x[0]), lambda t, x: 1.0 + jnp.floor(t) * x[0] ** 2)
    )


def test_a_jump_in_the_state_that_comes_with_time_is_refused():
    _, (_, _, t, position, _) = refused(lambda t, x: jnp.where((t > 5.0) & (x[0] > 0.3), 1.0, 0.0))
    assert t > 5.0
    assert position == pytest.approx(0.3)


class Joined(qj.AbstractPlant):
    """A spring with another stiffness when pulled, and a force of its own there."""

    force: Float[Array, ""] = float_field()
    order = 2

    def drift(self, t, x):
        return jnp.where(x[0] > 0.0, -2.0 * x[0] - self.force, -x[0])

    def gain(self, t, x):
        return 1.0


def test_the_numbers_of_a_plant_decide():
    for _ in range(2):
        asked(Joined(0.0))
        with pytest.raises(
            ValueError, match=r"`drift` of `Joined` .* jumps from 1e-10 to -0\.5 at t = 0, x = \(0, 0\)"
        ):
            asked(Joined(0.5))


def test_what_can_not_be_followed_passes():
    def called(t, x):
        return jnp.floor(x[0]) + jax.pure_callback(np.sign, jax.ShapeDtypeStruct((), float), x[1])

    asked(Plant(called))
    asked(Plant(lambda t, x: jax.lax.fori_loop(0, 3, lambda i, sum: sum + jnp.sign(x[0]), 0.0)))


def test_the_nominal_scenario_of_a_study_is_asked():
    def study(force):
        return qj.Study(lambda draw: scenario(Joined(draw.uniform("force", force - 0.1, force + 0.1))), bandwidth=0.1)

    study(0.0)
    with pytest.raises(ValueError, match="`drift` of `Joined` must be continuous"):
        study(0.5)

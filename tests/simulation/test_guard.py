"""What a step of the ideal loop may hide: never less than SciPy finds between the loop with it and without."""

import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.module import float_field
from qsmc_jax.enclosures.unseen import Nodes, Step
from qsmc_jax.simulation.engine import pose
from qsmc_jax.simulation.guard import hidden, hidden_in_cell

RTOL = 1e-6
WORTH = 1e3 * RTOL  # by how much s may move unseen: a thousand times the tolerance
NODES = Nodes((0.0, 0.5, 0.75, 1.0), few=(0.0, 0.5, 1.0))
RHO = 0.1  # half-width of the funnel, all but constant
FUNNEL = qj.Funnel(1e-9, 1e-9, RHO)
LENGTH, PLACE, WIDTH = 0.4, 0.1, 0.02


def bump(t):
    return jnp.exp(-(((t - PLACE) / WIDTH) ** 2))


class Bumping(qj.AbstractPlant):
    """f = a bump(t), g = b (1 + r bump(t)): of no kind that the library knows."""

    drift_bump: Float[Array, ""] = float_field(default=0.0)
    strength: Float[Array, ""] = float_field(default=1.0)
    gain_bump: Float[Array, ""] = float_field(default=0.0)
    order: ClassVar[int] = 1

    def drift(self, t, x):
        return self.drift_bump * bump(t)

    def gain(self, t, x):
        return self.strength * (1.0 + self.gain_bump * bump(t))


class Steady(qj.AbstractPlant):
    """x' = g u with a constant gain."""

    strength: Float[Array, ""] = float_field(default=1.0)
    order: ClassVar[int] = 1

    def drift(self, t, x):
        return jnp.zeros(())

    def gain(self, t, x):
        return self.strength


class Pushes(qj.AbstractDisturbance):
    """A bump of the given height."""

    height: Float[Array, ""] = float_field()

    def __call__(self, t):
        return self.height * bump(t)

    @property
    def bound(self):
        return jnp.abs(self.height)

    @property
    def break_times(self):
        return jnp.zeros((0,))


class Reference(qj.AbstractReference):
    """A bump, of whose derivatives JAX knows."""

    height: Float[Array, ""] = float_field()

    def derivatives(self, t, order):
        value = self.height * bump(t)
        return (value, -2.0 * (t - PLACE) / WIDTH**2 * value)[: order + 1]


class Leap(qj.AbstractReference):
    """A constant that changes at 0.1 s, unannounced."""

    height: Float[Array, ""] = float_field()

    def derivatives(self, t, order):
        return (jnp.where(t >= PLACE, self.height, 0.0), jnp.zeros(()))[: order + 1]


def problem_of(plant, disturbance=None, sign=1.0, reference=None):
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), FUNNEL, sign)
    disturbance, reference = disturbance or qj.disturbances.Zero(), reference or qj.references.Constant(0.0)
    loop = qj.ClosedLoop(plant, reference, disturbance, control)
    return pose(loop, (jnp.zeros(()),), 0.2, qj.SolverSettings(rtol=RTOL))


def hides(problem, s=0.0):
    """How far the funnel coordinate could move, by the guard, in a step in which it seems to stand still."""
    s = jnp.asarray(s)
    step = Step(jnp.asarray(0.0), jnp.asarray(LENGTH), NODES)
    us = (jnp.abs(jnp.sinh(s)),) * 2
    return float(hidden(problem, step, ((s,),) * 3, [us], [us], RTOL, 0.01)) * WORTH


def farthest(s0, gain, push):
    """The largest distance between two solutions of s' = cosh s (pi / 2 rho) (w - g sinh s), by SciPy: with what hides
    in gain and push, and with both as they are at the start."""
    ts = np.linspace(0.0, LENGTH, 2001)
    k = math.pi / (2.0 * RHO)

    def rate(t, y, at):
        return [math.cosh(y[0]) * k * (push(at(t)) - gain(at(t)) * math.sinh(y[0]))]

    with_it, without = (
        scipy.integrate.solve_ivp(
            rate, (0.0, LENGTH), [s0], "LSODA", ts, args=(at,), rtol=1e-10, atol=1e-13, max_step=0.25 * WIDTH
        ).y[0]
        for at in (lambda t: t, lambda t: 0.0)
    )
    return np.max(np.abs(with_it - without))


def plain(t):
    return math.exp(-(((t - PLACE) / WIDTH) ** 2))


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("height", [1e-3, -0.05])
@pytest.mark.parametrize("strength", [1e-4, 1.0, 50.0])
def test_a_push_moves_it_no_farther_than_is_said(strength, height, sign):
    pushed = farthest(0.0, lambda t: strength, lambda t: height * plain(t))
    for problem in (
        problem_of(Steady(sign * strength), Pushes(height), sign),
        problem_of(Bumping(height, sign * strength), sign=sign),
    ):
        said = hides(problem)
        assert pushed <= said
        # A push of three widths counts as one of the whole step.
        assert said <= 20.0 * pushed


@pytest.mark.parametrize("ripple", [0.3, -0.3])
def test_a_gain_that_swells_moves_it_by_as_much_as_the_input_counts(ripple):
    """At rest against a constant push, u = -w / g, which the swollen gain no longer balances."""
    s0, strength = -3.0, 1e-2
    problem = problem_of(Bumping(0.0, strength, ripple), qj.disturbances.Constant(strength * math.sinh(s0)))
    moved = farthest(s0, lambda t: strength * (1.0 + ripple * plain(t)), lambda t: strength * math.sinh(s0))
    assert moved <= hides(problem, s0) <= 20.0 * moved


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_gain_that_pushes_outwards_hides_the_growth_of_what_is_small(sign):
    """theta = pi sigma / (2 rho): sin(theta(t)) = sin(theta(0)) exp(k |g| t), and s is theta where both are small."""
    k, strength = math.pi / (2.0 * RHO), 0.3
    grown = math.log(math.sin(1e-6 * math.exp(k * strength * LENGTH)) / math.sin(1e-6))
    found = hides(problem_of(Steady(-sign * strength), sign=sign)) / WORTH
    assert found == pytest.approx(grown, rel=1e-5)
    assert hides(problem_of(Steady(sign * strength), sign=sign)) == 0.0


def test_a_gain_that_may_reverse_hides_growth_beside_whatever_else_hides():
    """In the dip the gain is -2 at its lowest; a push too small to count must not hide that."""
    k = math.pi / (2.0 * RHO)
    found = hides(problem_of(Bumping(0.0, 1.0, -3.0), Pushes(1e-12))) / WORTH
    assert found >= 2.0 * k * LENGTH * (1.0 - 1e-6)


def test_a_reference_that_moves_pushes_like_a_disturbance():
    """w has -x_des', whose largest value between the nodes is known in closed form."""
    height, strength = 1e-3, 1e-4
    moved = farthest(
        0.0, lambda t: strength, lambda t: 2.0 * height * (t - PLACE) / WIDTH**2 * plain(t) if t > 0.0 else 0.0
    )
    assert moved <= hides(problem_of(Steady(strength), reference=Reference(height)))


@pytest.mark.parametrize("height", [0.01, -0.02])
def test_a_reference_that_leaps_takes_the_sliding_variable_along(height):
    """s jumps by (pi / 2 rho) times the leap from s = 0, and more farther out."""
    said = hides(problem_of(Steady(1.0), reference=Leap(height)))
    assert said >= 0.999 * math.pi / (2.0 * RHO) * abs(height)


def test_an_open_cell_hides_what_pushes_in_it():
    """Between samples sigma' = d + g u: by the area of the bump and the change of the gain, in half-widths."""
    at = lambda t: (jnp.zeros(()),)  # noqa: E731
    step = Step(jnp.asarray(0.0), jnp.asarray(LENGTH), NODES)
    area = WIDTH * math.sqrt(math.pi)
    for plant, disturbance, u, moved in (
        (Steady(1.0), Pushes(0.05), 0.0, 0.05 * area),
        (Bumping(0.05), qj.disturbances.Zero(), 0.0, 0.05 * area),
        (Bumping(0.0, 1.0, 0.5), qj.disturbances.Zero(), -40.0, 40.0 * 0.5 * area),
    ):
        problem = problem_of(plant, disturbance)
        said = float(hidden_in_cell(problem, step, at, [jnp.asarray(abs(u))], RTOL, 0.01)) * WORTH
        assert moved / RHO <= said <= 20.0 * moved / RHO
    leap = problem_of(Steady(1.0), reference=Reference(0.03))
    said = float(hidden_in_cell(leap, step, at, [jnp.zeros(())], RTOL, 0.01)) * WORTH
    assert said >= 0.03 / RHO * (1.0 - 1e-6)

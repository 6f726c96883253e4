"""Loops with known answers, each with its source: what the tests of single runs and of batches are held against."""

import dataclasses
import functools as ft
import json
import math
import pathlib
from typing import Any, ClassVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

import qsmc_jax as qj
from qsmc_jax.base.module import float_field
from qsmc_jax.study.sampling import AbstractSampling

ORACLES = json.loads((pathlib.Path(__file__).parent / "data" / "oracles.json").read_text())


@dataclasses.dataclass(frozen=True)
class Problem:
    """A loop, a start and a horizon, and answers known from outside the code.

    Attributes:
        name: Short name.
        tags: What it is about.
        source: Where the answers come from.
        loop: The closed loop.
        x0: The start.
        t1: The horizon [s].
        bandwidth: The bandwidth of quasi-sliding mode.
        answers: The known numbers, by name.
    """

    name: str
    tags: tuple[str, ...]
    source: str
    loop: qj.ClosedLoop
    x0: tuple[float, ...]
    t1: float
    bandwidth: float
    answers: dict[str, Any]

    def __str__(self):
        return self.name

    def simulate(self, settings=None, ts=None):
        return qj.simulate(self.loop, self.x0, self.t1, bandwidth=self.bandwidth, ts=ts, settings=settings)


@ft.cache
def chain(n):
    """The class of a plant of order n: one class an order, so that loops that differ by numbers share a program."""

    class Chain(qj.AbstractPlant):
        """f = a (cos x_1 - x_n), g = b cos(w t) (1 + r sin x_n)."""

        drift_scale: Float[Array, ""] = float_field(default=0.0)
        gain_scale: Float[Array, ""] = float_field(default=1.0)
        gain_frequency: Float[Array, ""] = float_field(default=0.0)
        gain_ripple: Float[Array, ""] = float_field(default=0.0)
        order: ClassVar[int] = n

        def drift(self, t, x):
            return self.drift_scale * (jnp.cos(x[0]) - x[-1])

        def gain(self, t, x):
            return self.gain_scale * jnp.cos(self.gain_frequency * t) * (1.0 + self.gain_ripple * jnp.sin(x[-1]))

    return Chain


def scalar_loop(funnel, gain_sign=1.0, level=0.0, **plant):
    """A plant of order 1 regulated to 0 under a constant disturbance, written as sines so as to share one program."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), funnel, gain_sign)
    level = qj.disturbances.Sine(level, 0.0, math.pi / 2)
    return qj.ClosedLoop(chain(1)(**plant), qj.references.SumOfSines([0.0], [1.0]), level, control)


def _paper(number, make_loop):
    source = "tests/data/oracles.json"
    return [
        Problem(f"example{number}-from-{o['x0'][0]}", ("paper",), source, make_loop(), tuple(o["x0"]), o["T"], 0.1, o)
        for o in ORACLES[f"example{number}"]
    ]


def example1():
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(4.0, 3.0, 0.05))
    disturbance = qj.disturbances.Sine(0.5, 1.0)
    return qj.ClosedLoop(qj.plants.InvertedPendulum(), qj.references.SumOfSines([1.0], [1.0]), disturbance, control)


def example2():
    sine, pi = qj.disturbances.Sine, math.pi
    disturbance = qj.disturbances.Piecewise(
        [6.0, 9.0], (sine(0.5, pi / 2), sine(1.0, pi), sine(1.0, pi, pi / 2) + qj.disturbances.Constant(-1.0))
    )
    control = qj.QuasiSlidingControl(qj.SlidingSurface([6.0, 12.0, 8.0]), qj.Funnel(5.0, 3.0, 0.05))
    reference = qj.references.SumOfSines([1.0, 1.0], [1.0, 0.5], [0.0, pi / 2])
    return qj.ClosedLoop(qj.plants.FourthOrderExample(), reference, disturbance, control)


PAPER = [*_paper(1, example1), *_paper(2, example2)]

# A funnel constant to 1e-10 over the horizons here (C2, rho0 > bandwidth > rho_inf, forbids one of rho_inf alone).
WIDTH = 1.5
STILL = qj.Funnel(rho0=1.0, mu=1e-12, rho_inf=0.5)
STILL_BANDWIDTH = 0.75


def escape_time(z0, gain=1.0, width=WIDTH):
    """When a loop of order 1 with the wrong sign of a constant gain leaves a constant funnel, undisturbed [s].

    With theta = pi z / 2 and k = pi |g| / (2 rho): theta' = k tan(theta), so sin(theta) = sin(theta_0) exp(k t).
    """
    return -math.log(math.sin(math.pi * abs(z0) / 2)) / (math.pi * gain / (2 * width))


def wrong_sign(z0, gain):
    loop = scalar_loop(STILL, -1.0, gain_scale=gain)
    time = escape_time(z0, gain)
    source = "sin(theta) = sin(theta_0) exp(k t)"
    name = f"wrong sign from {z0}, gain {gain}"
    return Problem(name, ("violated",), source, loop, (z0 * WIDTH,), 20.0, STILL_BANDWIDTH, {"violation_time": time})


def turning_gain(z0, gain, frequency):
    """g = b cos(w t): sin(theta) = sin(theta_0) exp(-K sin(w t)), K = pi b / (2 rho w), greatest at w t = 3 pi / 2."""
    loop = scalar_loop(STILL, gain_scale=gain, gain_frequency=frequency)
    growth = math.pi * gain / (2 * WIDTH * frequency)
    peak = math.sin(math.pi * z0 / 2) * math.exp(growth)
    if peak > 1.0:
        outward = -math.log(math.sin(math.pi * z0 / 2)) / growth
        answers = {"violation_time": (math.pi + math.asin(outward)) / frequency}
    else:
        answers = {"peak_ratio": 2 / math.pi * math.asin(peak), "peak_time": 1.5 * math.pi / frequency}
    tag = "violated" if peak > 1.0 else "held"
    source, name = turning_gain.__doc__, f"gain {gain} cos {frequency} t from {z0}"
    return Problem(name, (tag,), source, loop, (z0 * WIDTH,), 5.0 / frequency, STILL_BANDWIDTH, answers)


def no_gain(level):
    """g = 0, constant d: sigma = d t meets rho(t) = 4 exp(-t) + 0.05."""
    loop = scalar_loop(qj.Funnel(4.0, 1.0, 0.05), level=level, gain_scale=0.0)
    time = scipy.optimize.brentq(lambda t: abs(level) * t - 4.0 * math.exp(-t) - 0.05, 0.0, 10.0, xtol=1e-14)
    answers = {"violation_time": time}
    return Problem(f"no gain, d = {level}", ("violated",), no_gain.__doc__, loop, (0.0,), 10.0, 0.1, answers)


def decay(z0, gain, t1):
    """sin(theta) = S exp(-k t), S = sin(theta_0): peak at the start, u = -tan(theta), |u| falls all the way."""
    loop = scalar_loop(STILL, gain_scale=gain)
    k, start = math.pi * gain / (2 * WIDTH), math.sin(math.pi * z0 / 2)
    end = start * math.exp(-k * t1)
    answers = {
        "peak_ratio": z0,
        "peak_time": 0.0,
        "peak_u": math.tan(math.pi * z0 / 2),
        "max_u": -math.tan(math.asin(end)),
        "min_u": -math.tan(math.pi * z0 / 2),
        "reach_time": math.log(start / math.sin(math.pi * STILL_BANDWIDTH / (2 * WIDTH))) / k,
        "energy_u": math.log((1 - end**2) / (1 - start**2)) / (2 * k),
        "total_variation_u": math.tan(math.pi * z0 / 2) - math.tan(math.asin(end)),
        "x1": 2 / math.pi * WIDTH * math.asin(end),
    }
    return Problem(f"decay from {z0}", ("held",), decay.__doc__, loop, (z0 * WIDTH,), t1, STILL_BANDWIDTH, answers)


def equilibrium(level, gain):
    """Constant d: z rises from 0 to (2/pi) atan(d/g), all but reached after many time constants, and |u| with it."""
    loop = scalar_loop(STILL, level=level, gain_scale=gain)
    ratio = 2 / math.pi * math.atan(abs(level) / gain)
    u = abs(level) / gain
    extremes = {"max_u": max(0.0, -level / gain), "min_u": min(0.0, -level / gain)}
    answers = {"peak_ratio": ratio, "peak_u": u, "total_variation_u": u, "x1": math.copysign(ratio * WIDTH, level)}
    return Problem(
        f"balance at d = {level}",
        ("held",),
        equilibrium.__doc__,
        loop,
        (0.0,),
        60.0,
        STILL_BANDWIDTH,
        answers | extremes,
    )


VIOLATED = [
    *(wrong_sign(z0, gain) for z0, gain in ((0.5, 1.0), (-0.9, 1.0), (1e-3, 2.0), (0.999, 0.5))),
    *(turning_gain(z0, 2.0, 1.0) for z0 in (0.2, 0.9)),
    *(no_gain(level) for level in (1.0, -0.3)),
]
HELD = [
    decay(0.9, 1.0, 3.0),
    decay(0.999, 2.0, 3.0),
    turning_gain(0.05, 2.0, 1.0),
    *(equilibrium(level, gain) for level, gain in ((0.5, 1.0), (-20.0, 0.7))),
]


class Grid(AbstractSampling):
    """Run i of N at (i + 1/2) / N in every coordinate: for studies whose runs lie on a line."""

    runs: int = eqx.field(static=True)

    is_independent: ClassVar[bool] = False
    why_not: ClassVar[str] = "A grid is not random."

    def points(self, seed, indices, dim):
        return np.repeat((np.asarray(indices)[:, None] + 0.5) / self.runs, dim, axis=1)


def dispersed_example1(draw):
    """Example 1 from random starts; the other numbers are the paper's unless one is substituted, or given a spread."""
    rho0 = _around(draw, "rho0", 4.0, widest=10.0)
    rho_inf = _around(draw, "rho_inf", draw.parameter("rho_inf", 0.05, bounds=(1e-5, 0.09)), widest=0.1)
    funnel = qj.Funnel(rho0, draw.parameter("mu", 3.0, bounds=(0.5, 10.0)), rho_inf)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([_around(draw, "c1", 2.0, widest=10.0)]), funnel)
    disturbance = qj.disturbances.Sine(_around(draw, "amplitude", 0.5, widest=10.0), 1.0)
    loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), qj.references.SumOfSines([1.0], [1.0]), disturbance, control)
    x0 = draw.uniform("x0", 0.1, 0.9, shape=(2,))
    return qj.Scenario(loop, x0, t1=draw.parameter("t1", 20.0, bounds=(0.1, 100.0)))


def _around(draw, name, centre, widest):
    spread = draw.parameter(f"{name}_spread", 0.0, bounds=(0.0, widest))
    return centre + spread * draw.uniform(f"{name}_offset", -1.0, 1.0)

"""Loops to which something short happens, and what SciPy says of them: it is started anew around it.

The right-hand side in NumPy is written again, in errors and the funnel coordinate s, u = -sinh s: no pole to step over.
"""

import dataclasses
import functools as ft
import math
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import scipy.integrate
from jaxtyping import Array, Float

import qsmc_jax as qj
import reference_sampled_loop as exact
from qsmc_jax.base.module import AbstractModule, float_field

GAUSSIAN, HALF_SINE, STEP, SECH = range(4)
# Where it happens: in the disturbance, in f, in f times x_1, in g, in the reference.
D, F, FX, G, REF = range(5)
OUT = 14.0  # |s| beyond which a run is taken to have left: an input of 6e5
# Where SciPy is started anew, in widths from the middle, and how finely it must step between.
MARKS = np.array([-40.0, -12.0, -5.0, -2.0, -0.5, 0.0, 0.5, 2.0, 5.0, 12.0, 40.0, 400.0])
STEPS = 12


class Feature(AbstractModule):
    """A smooth bump or step of any width: nothing but numbers, so that all share a program."""

    shape: Float[Array, ""] = float_field(default=0.0)
    at: Float[Array, ""] = float_field(default=1.0)
    width: Float[Array, ""] = float_field(default=1.0)
    height: Float[Array, ""] = float_field(default=0.0)

    def __call__(self, t):
        x = (t - self.at) / self.width
        shapes = jnp.exp(-(x**2)), jnp.sin(jnp.pi * jnp.clip(x + 0.5, 0.0, 1.0)), 0.5 + 0.5 * jnp.tanh(x), sech(x)
        return self.height * jnp.select([self.shape == k for k in range(4)], list(shapes))


def sech(x):
    """As it can be written without overflow, which its derivative would turn into NaN."""
    size = jnp.exp(-jnp.abs(x))
    return 2.0 * size / (1.0 + size**2)


class Push(qj.AbstractDisturbance):
    """A level and a feature."""

    level: Float[Array, ""] = float_field()
    feature: Feature

    def __call__(self, t):
        return self.level + self.feature(t)

    @property
    def bound(self):
        return jnp.abs(self.level) + jnp.abs(self.feature.height)

    @property
    def break_times(self):
        return []


class Turn(AbstractModule):
    """A reference: a sine and a gaussian or a smooth step."""

    size: Float[Array, ""] = float_field()
    feature: Feature

    def __call__(self, t):
        x = (t - self.feature.at) / self.feature.width
        bump = jnp.where(self.feature.shape == GAUSSIAN, jnp.exp(-(x**2)), 0.5 + 0.5 * jnp.tanh(x))
        return self.size * jnp.sin(t) + self.feature.height * bump


@ft.cache
def plant(n):
    """The class of a plant of order n."""

    class Eventful(qj.AbstractPlant):
        """f = a cos x_1 + b x_n + F(t) (p + q x_1), g = sign (1 - G(t))."""

        swing: Float[Array, ""] = float_field(default=0.0)
        push_out: Float[Array, ""] = float_field(default=0.0)
        sign: Float[Array, ""] = float_field(default=1.0)
        added: Float[Array, ""] = float_field(default=0.0)
        multiplied: Float[Array, ""] = float_field(default=0.0)
        force: Feature = Feature()
        dip: Feature = Feature()
        order: ClassVar[int] = n

        def drift(self, t, x):
            push = self.force(t) * (self.added + self.multiplied * x[0])
            return self.swing * jnp.cos(x[0]) + self.push_out * x[-1] + push

        def gain(self, t, x):
            return self.sign * (1.0 - self.dip(t))

    return Eventful


@ft.cache
def quiet_plant(n):
    """The same without what happens."""

    class Quiet(qj.AbstractPlant):
        """f = a cos x_1 + b x_n, g = sign."""

        swing: Float[Array, ""] = float_field(default=0.0)
        push_out: Float[Array, ""] = float_field(default=0.0)
        sign: Float[Array, ""] = float_field(default=1.0)
        order: ClassVar[int] = n

        def drift(self, t, x):
            return self.swing * jnp.cos(x[0]) + self.push_out * x[-1]

        def gain(self, t, x):
            return self.sign

    return Quiet


def surface(n):
    """Coefficients of (s + 2)^(n - 1)."""
    return [math.comb(n - 1, n - i) * 2.0 ** (n - i) for i in range(1, n)]


@dataclasses.dataclass(frozen=True)
class Case:
    """One loop, as numbers."""

    n: int = 1
    funnel: tuple = (4.0, 3.0, 0.05)
    x0: tuple = (0.5,)
    horizon: float = 20.0
    sign: float = 1.0
    level: float = 0.3
    swing: float = 0.0
    push_out: float = 0.0
    size: float = 0.0
    where: int = D
    shape: int = GAUSSIAN
    at: float = 7.03
    width: float = 0.01
    height: float = 0.0

    @property
    def is_turn(self):
        """Whether it happens in the reference; that is another program, so the place must be known."""
        return isinstance(self.where, int) and self.where == REF

    def loop(self, implementation=None):
        """The loop of the package, whose numbers may be traced; all but those of `ref` share a program."""
        feature = Feature(self.shape, self.at, self.width, self.height)
        if self.is_turn:
            system = quiet_plant(self.n)(self.swing, self.push_out, self.sign)
            reference = qj.references.Smooth(Turn(self.size, feature))
            push = qj.disturbances.Constant(self.level)
        else:
            share = {
                place: jnp.where(jnp.asarray(self.where) == k, 1.0, 0.0)
                for k, place in enumerate(("d", "f", "fx", "g"))
            }
            dip, pushing = (dataclasses.replace(feature, height=self.height * share[place]) for place in ("g", "d"))
            system = plant(self.n)(self.swing, self.push_out, self.sign, share["f"], share["fx"], feature, dip)
            reference = qj.references.SumOfSines([self.size], [1.0])
            push = Push(self.level, pushing)
        control = qj.QuasiSlidingControl(qj.SlidingSurface(surface(self.n)), qj.Funnel(*self.funnel), self.sign)
        return qj.ClosedLoop(system, reference, push, control, implementation)


def shaped(shape, x, order):
    """A shape and its first `order` derivatives by x; half-sine and sech only the value."""
    if shape == GAUSSIAN:
        value = np.exp(-(x**2))
        return [value, -2 * x * value, (4 * x**2 - 2) * value, (12 * x - 8 * x**3) * value][: order + 1]
    if shape == STEP:
        h = np.tanh(x)
        q = 1.0 - h**2
        return [0.5 + 0.5 * h, 0.5 * q, -h * q, (3 * h**2 - 1) * q][: order + 1]
    if shape == HALF_SINE:
        return [np.sin(np.pi * np.clip(x + 0.5, 0.0, 1.0))]
    size = np.exp(-np.abs(x))
    return [2.0 * size / (1.0 + size**2)]


def desired(case, t):
    """The reference of a case and its first n derivatives."""
    waves = [case.size * np.sin(t + k * math.pi / 2) for k in range(case.n + 1)]
    if case.where == REF:
        bump = shaped(case.shape, (t - case.at) / case.width, case.n)
        waves = [w + case.height * b / case.width**k for k, (w, b) in enumerate(zip(waves, bump, strict=True))]
    return waves


def errors(case, t, y):
    """The width of the funnel, sigma over it, and the n errors where (e, s) is y."""
    *e, s = y
    rho, z = case.funnel[0] * math.exp(-case.funnel[1] * t) + case.funnel[2], 2.0 / math.pi * math.atan(math.sinh(s))
    return rho, z, [*e, rho * z - sum(ci * ei for ci, ei in zip(surface(case.n), e, strict=True))]


def rate(case, t, y):
    """The derivative of (e, s)."""
    s = min(max(y[-1], -2.0 * OUT), 2.0 * OUT)  # a stage may lie anywhere
    rho, z, e = errors(case, t, [*y[:-1], s])
    falls, targets = -case.funnel[1] * (rho - case.funnel[2]), desired(case, t)
    x = [ei + di for ei, di in zip(e, targets, strict=False)]
    now = 0.0 if case.where == REF else case.height * shaped(case.shape, (t - case.at) / case.width, 0)[0]
    drift = case.swing * math.cos(x[0]) + case.push_out * x[-1]
    drift += now * {D: 1.0, F: 1.0, FX: x[0]}.get(case.where, 0.0)
    pushed_in = (1.0 - (now if case.where == G else 0.0)) * math.sinh(s)
    w = drift - targets[case.n] + case.level - pushed_in
    w += sum(ci * ei for ci, ei in zip(surface(case.n), e[1:], strict=True))
    return [*e[1:], math.cosh(s) * 0.5 * math.pi * (w - z * falls) / rho]


def start(case):
    """(e, s) at time 0."""
    e = [x - d for x, d in zip(case.x0, desired(case, 0.0), strict=False)]
    z = sum(ci * ei for ci, ei in zip((*surface(case.n), 1.0), e, strict=True)) / (case.funnel[0] + case.funnel[2])
    return [*e[:-1], math.asinh(math.tan(0.5 * math.pi * z))]


def scipys(case):
    """When the run leaves the funnel (inf if it does not), its peak of |sigma| / rho, and the last (e, s)."""
    y = start(case)
    peak = 2.0 / math.pi * math.atan(math.sinh(abs(y[-1])))
    marks = case.at + MARKS * case.width
    marks = [0.0, *marks[(marks > 0.0) & (marks < case.horizon)], case.horizon]
    for begin, end in zip(marks, marks[1:], strict=False):
        near = abs(0.5 * (begin + end) - case.at) < 41.0 * case.width
        longest = (end - begin) / STEPS if near else math.inf
        field = ft.partial(rate, case)
        run = scipy.integrate.LSODA(field, begin, y, end, max_step=longest, rtol=1e-9, atol=1e-11)
        while run.status == "running":
            run.step()
            peak = max(peak, 2.0 / math.pi * math.atan(math.sinh(min(abs(run.y[-1]), OUT))))
            if abs(run.y[-1]) > OUT:
                return run.t, 1.0, run.y
        assert run.status == "finished"
        y = run.y
    return math.inf, peak, y


def sampled_twin(case, period):
    """The same loop, sampled, for the integration event by event, which starts anew around what happens."""

    def at(place, t):
        return case.height * shaped(case.shape, (t - case.at) / case.width, 0)[0] if case.where == place else 0.0 * t

    return exact.SampledLoop(
        drift=lambda t, x: case.swing * np.cos(x[0]) + case.push_out * x[-1] + at(F, t) + at(FX, t) * x[0],
        gain=lambda t, x: case.sign * (1.0 - at(G, t)),
        disturbance=lambda t: case.level + at(D, t),
        desired=ft.partial(desired, case),
        c=tuple(surface(case.n)),
        **dict(zip(("rho0", "mu", "rho_inf"), case.funnel, strict=True)),
        sample_period=period,
        law=exact.tangent(case.sign),
        jumps=tuple(case.at + case.width * np.array([-6.0, -3.0, -1.5, -0.75, 0.0, 0.75, 1.5, 3.0, 6.0])),
    )


def integrated(d, s, start, end):
    """The funnel coordinate of the loop of a bare `Case` under a disturbance, from `start` to `end`."""

    def rate(t, y):
        rho, falls = 4.0 * math.exp(-3.0 * t) + 0.05, -12.0 * math.exp(-3.0 * t)
        z = 2.0 / math.pi * math.atan(math.sinh(y[0]))
        return [math.cosh(y[0]) * 0.5 * math.pi * (d(t) - math.sinh(y[0]) - z * falls) / rho]

    longest = min(0.2, 0.25 * (end - start))
    run = scipy.integrate.solve_ivp(rate, (start, end), [s], "LSODA", rtol=1e-9, atol=1e-11, max_step=longest)
    return run.y[0]


def scipys_peak(d, marks):
    """The peak of z where d is any function of time, for the loop of `Case`; SciPy is started anew at the marks."""
    peak, s = 0.0, math.asinh(math.tan(0.5 * math.pi * 0.5 / 4.05))
    inner = [t for t in np.sort(marks) if 0.0 < t < 20.0]
    for start, end in zip([0.0, *inner], [*inner, 20.0], strict=True):
        run = integrated(lambda t, a=start, b=end: d(min(max(t, a + 1e-11), b - 1e-11)), s, start, end)
        peak, s = max(peak, np.max(2.0 / np.pi * np.arctan(np.sinh(np.abs(run))))), run[-1]
    return peak


def at_ends(t1):
    """The ends of a run: as few times as there can be."""
    return np.array([0.0, t1])


def verdict_of(metrics):
    """The verdict on the funnel, its name."""
    return qj.Verdict(int(metrics.verdict)).name

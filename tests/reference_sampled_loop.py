"""A sampled loop in NumPy and SciPy, one run at a time: the truth that the vectorised engine is held against.

Nothing of the package is used. Between events, DOP853 integrates plant, actuator, high-pass filter and the integrals of
squares as one system. Suprema, crossings and variations are read off its dense output, and refined within its steps.
"""

import bisect
import collections
import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable

import numpy as np
import scipy.integrate
import scipy.optimize
from numpy.polynomial import chebyshev

RTOL, ATOL = 1e-11, 1e-13
TINY = 1e-13  # intervals this short, as a fraction of the time, are rounding in the time of an event: one Euler step
NODES = -np.cos(np.linspace(0.0, math.pi, 13))  # of Chebyshev, on [-1, 1], where each step of the solver is read
FIT = np.linalg.inv(chebyshev.chebvander(NODES, len(NODES) - 1))
EXTRAS = 5  # states after those of plant and actuator: two of the filter, integrals of its output^2, of u^2, of e^2

Run = collections.namedtuple("Run", "times commands trajectory metrics")  # times and commands: of the samples
Sample = collections.namedtuple("Sample", "k t period sigma rho desired")  # what a law is given
Metrics = collections.namedtuple(
    "Metrics",  # those of the steady phase are NaN if there is none
    "peak_ratio peak_excess violation_time recovery_time reach_time peak_u max_u min_u total_variation_u energy_u "
    "rms_error peak_errors excess_variation_u peak_rate_u reversal_rate high_frequency_ratio",
)


def tangent(gain_sign=1.0, beyond="saturate"):
    """The quasi-sliding-mode law, as a law without memory."""

    def law(sample, memory):
        sigma, rho = sample.sigma, sample.rho
        if beyond == "saturate":
            edge = (1.0 - 1e-9) * rho
            sigma = min(max(sigma, -edge), edge)
        if 0.5 * rho < abs(sigma) < rho:  # the cotangent of the distance to the edge loses no digits there
            distance = math.copysign(rho - abs(sigma), sigma)
            return -gain_sign / math.tan(0.5 * math.pi * distance / rho), memory
        return -gain_sign * math.tan(0.5 * math.pi * sigma / rho), memory

    return law


@dataclasses.dataclass(frozen=True)
class SampledLoop:
    """A plant of order n under a sampled controller. Functions of time take arrays too, and are right-continuous.

    `drift(t, x)`, `gain(t, x)` (x: a sequence of n), `disturbance(t)`, `fault(t)`: numbers; `desired(t)`: the reference
    and its first n derivatives; `unmatched`: none or n - 1 functions of time; `law(sample, memory)`: command, memory;
    `noise(k, t)`: n numbers; `jitter(k)`: by which fraction of the period sample k is late; `jumps`: when any of them
    jumps; `lag`: time constant of a first-order actuator, and its largest `rate`; `oscillator`: frequency, damping
    of a second-order one; `zone`: half-width of the dead zone behind it.
    """

    drift: Callable
    gain: Callable
    disturbance: Callable
    desired: Callable
    c: tuple
    rho0: float
    mu: float
    rho_inf: float
    sample_period: float
    cutoff: float = 15.0
    law: Callable = dataclasses.field(default_factory=tangent)
    memory: tuple = ()
    jitter: Callable = lambda k: 0.0
    delay: float = 0.0
    measurement_delay: float = 0.0
    saturation: float = math.inf
    rate_limit: float = math.inf
    measurement_resolution: Iterable = itertools.repeat(0.0)
    input_resolution: float = 0.0
    noise: Callable = lambda k, t: itertools.repeat(0.0)
    lag: float = 0.0
    rate: float = math.inf
    zone: float = 0.0
    oscillator: tuple[float, float] | None = None
    fault: Callable = lambda t: 1.0
    unmatched: tuple = ()
    jumps: tuple = ()

    @property
    def order(self):
        return len(self.c) + 1

    @property
    def lags(self):
        """Number of states of the actuator."""
        return 2 if self.oscillator else 1 if self.lag > 0.0 else 0

    def rho(self, t):
        return self.rho0 * np.exp(-self.mu * t) + self.rho_inf

    def errors(self, t, x):
        return [xi - di for xi, di in zip(x, self.desired(t), strict=False)]

    def sigma(self, t, x):
        return self.surface(self.errors(t, x))

    def surface(self, e):
        return sum(ci * ei for ci, ei in zip((*self.c, 1.0), e, strict=True))

    def plant_rates(self, t, x, u):
        unmatched = [signal(t) for signal in self.unmatched] or [0.0] * len(self.c)
        chain = [xi + di for xi, di in zip(x[1:], unmatched, strict=True)]
        return [*chain, self.drift(t, x) + self.fault(t) * self.gain(t, x) * u + self.disturbance(t)]

    def equivalent_input(self, t, x):
        """-w / g, where sigma' = w + g u, the fault being part of g and unmatched disturbances of w; 0 where g is."""
        rates = self.plant_rates(t, x, 0.0)
        w = self.surface([ri - di for ri, di in zip(rates, self.desired(t)[1:], strict=True)])
        w, g = np.broadcast_arrays(w, self.fault(t) * self.gain(t, x))
        return np.divide(-w, g, out=np.zeros(w.shape), where=g != 0.0)

    def beyond(self, v):
        """What the dead zone leaves of the actuator's position."""
        return np.where(np.abs(v) <= self.zone, 0.0, v - np.sign(v) * self.zone)

    def command(self, k, t, x, last, memory):
        """The command of sample k at time t, which reads the state x, and the law's memory."""
        noise, steps = self.noise(k, t), self.measurement_resolution
        x = [_rounded(xi + ni, step) for xi, ni, step in zip(x, noise, steps, strict=False)]
        sample = Sample(k, t, self.sample_period, self.sigma(t, x), self.rho(t), self.desired(t))
        u, memory = self.law(sample, memory)
        u = min(max(_rounded(u, self.input_resolution), -self.saturation), self.saturation)
        reach = self.rate_limit * self.sample_period
        return min(max(u, last - reach), last + reach), memory

    def rates(self, t, y, command):
        """Of the plant's states, the actuator's, the filter's, and of the integrals."""
        x, actuator, (z, z_rate, *_) = y[: self.order], y[self.order : -EXTRAS], y[-EXTRAS:]
        v = actuator[0] if self.lags else command
        u, moved = self.beyond(v), [np.clip((command - v) / self.lag, -self.rate, self.rate)] if self.lag > 0.0 else []
        if self.oscillator:
            frequency, damping = self.oscillator
            moved = [actuator[1], frequency**2 * (command - v) - 2.0 * damping * frequency * actuator[1]]
        passed = u - math.sqrt(2.0) * self.cutoff * z_rate - self.cutoff**2 * z
        return [*self.plant_rates(t, x, u), *moved, z_rate, passed, passed**2, u**2, (x[0] - self.desired(t)[0]) ** 2]


def _rounded(value, step):
    return np.round(value / step) * step if step > 0.0 else value


class Trajectory:
    """Dense output, right-continuous: the solver's interpolants, step by step, and the command of each."""

    def __init__(self, loop):
        self.loop, self.steps, self.commands = loop, [], []

    def at(self, t):
        """The n states and the input at time t, or at times within one step."""
        i = max(bisect.bisect(self.steps, np.min(t), key=lambda step: step.t_min) - 1, 0)
        y, n = self.steps[i](t), self.loop.order
        return y[:n], self.loop.beyond(y[n] if self.loop.lags else 0.0 * t + self.commands[i])

    def size(self, t):
        return abs(self.loop.sigma(t, self.at(t)[0]))

    def nodes(self):
        """Times (steps, nodes), and the n states and the input there; a step's last node is just before its end."""
        begins, ends = np.array([(step.t_min, step.t_max) for step in self.steps]).T[:, :, None]
        t = 0.5 * (begins + ends) + 0.5 * (ends - begins) * NODES
        t[:, :1], t[:, -1:] = begins, np.nextafter(ends, -math.inf)
        xs, us = zip(*[self.at(row) for row in t], strict=True)
        return t, np.stack(xs, axis=1), np.stack(us)


def simulate(loop, x0, horizon, bandwidth):
    """One run over [0, horizon], with samples before the horizon; `bandwidth` sets the steady phase and reach_time."""
    late = ((k + loop.jitter(k)) * loop.sample_period for k in itertools.count())
    times = np.array([*itertools.takewhile(lambda t: t < (1.0 - TINY) * horizon, late)])
    arrivals, readings = times + loop.delay, np.maximum(times - loop.measurement_delay, 0.0)
    excess = bandwidth - loop.rho_inf
    t_r = max(math.log(loop.rho0 / excess) / loop.mu, 0.0) if excess > 0.0 else math.inf
    events = np.unique([0.0, horizon, *times, *arrivals, *readings, *loop.jumps, t_r])
    events = events[(events >= 0.0) & (events <= horizon)]
    y = np.array([*x0, *[0.0] * (loop.lags + EXTRAS)], float)
    trajectory, states, commands, last, memory = Trajectory(loop), {0.0: y}, [], 0.0, loop.memory
    for begin, end in itertools.pairwise(events):
        k, arrived = len(commands), np.searchsorted(arrivals, begin, side="right")
        if begin in times[k : k + 1]:
            last, memory = loop.command(k, begin, states[readings[k]][: loop.order], last, memory)
            commands.append(last)
        held = commands[arrived - 1] if arrived else 0.0
        states[end] = _advance(trajectory, states[begin], begin, end, held)
    run = Run(times, np.array(commands), trajectory, None)
    return run._replace(metrics=_metrics(run, states.get(t_r), states[horizon], t_r, horizon, bandwidth))


def _advance(trajectory, y, begin, end, command):
    """From event to event under one command; nothing at or after `end` is looked at."""
    latest = np.nextafter(end, -math.inf)

    def field(t, y):
        return trajectory.loop.rates(min(t, latest), y, command)

    if end - begin <= TINY * end:
        return y + (end - begin) * np.array(field(begin, y))
    found = scipy.integrate.solve_ivp(field, (begin, end), y, "DOP853", dense_output=True, rtol=RTOL, atol=ATOL)
    if not found.success:
        raise RuntimeError(found.message)
    trajectory.steps += found.sol.interpolants
    trajectory.commands += [command] * len(found.sol.interpolants)
    return found.y[:, -1]


def _metrics(run, steady, last, t_r, horizon, bandwidth):
    times, commands, trajectory, _ = run
    loop, size, (t, x, u) = trajectory.loop, trajectory.size, trajectory.nodes()
    sigma, rho, path = np.abs(loop.sigma(t, x)), loop.rho(t), turning_path(u)
    violation, recovery = crossings(t, sigma - rho, lambda s: size(s) - loop.rho(s))
    whole = {
        "peak_ratio": peak(t, sigma / rho, lambda s: size(s) / loop.rho(s)),
        "peak_excess": peak(t, sigma - rho, lambda s: size(s) - loop.rho(s)),
        "violation_time": violation,
        "recovery_time": recovery,
        "reach_time": crossings(t, sigma - bandwidth, lambda s: size(s) - bandwidth)[1],
        "peak_u": np.max(np.abs(path)),
        "max_u": np.max(path),
        "min_u": np.min(path),
        "total_variation_u": variation(path),
        "energy_u": last[-2],
        "rms_error": math.sqrt(last[-1] / horizon),
    }
    after = dict.fromkeys(Metrics._fields, math.nan) | {"peak_errors": (math.nan,) * loop.order}
    late = t[:, 0] >= t_r
    if steady is not None and late.any():
        t, x, u = t[late], x[:, late], u[late]
        counted, before = commands[times >= t_r], np.concatenate([[0.0], commands[:-1]])[times >= t_r]
        powers = last - steady
        after |= {
            "peak_errors": tuple(np.max(np.abs(turning_path(e))) for e in loop.errors(t, x)),
            "excess_variation_u": variation(turning_path(u)) - variation(turning_path(loop.equivalent_input(t, x))),
            "peak_rate_u": np.max(np.abs(counted - before), initial=0.0) / loop.sample_period,
            "reversal_rate": reversals(counted) / (horizon - t_r),
            "high_frequency_ratio": powers[-3] / powers[-2] if powers[-2] > 0.0 else math.nan,
        }
    return Metrics(**(after | whole))


def turning_path(values):
    """The values at the ends and turning points of every step, in order; they are given at the nodes (steps, nodes)."""
    path = []
    for row in values:
        fit = FIT @ row
        slope = chebyshev.chebtrim(chebyshev.chebder(fit), 1e-14 * np.max(np.abs(fit)))
        roots = chebyshev.chebroots(slope) if np.ptp(row) > 0.0 else np.zeros(0)
        turns = np.sort(roots.real[(abs(roots.imag) < 1e-9) & (abs(roots.real) < 1.0)])
        path += [row[0], *chebyshev.chebval(turns, fit), row[-1]]
    return np.array(path)


def variation(path):
    return np.sum(np.abs(np.diff(path)))


def peak(t, values, function):
    """The supremum of a function that is given at the nodes, refined in the ten steps where it is highest there."""
    return max(_top(t[i], values[i], function)[1] for i in np.argsort(np.max(values, axis=1))[-10:])


def _top(t, values, function):
    """Time and height of the highest point of one step."""
    j = int(np.argmax(values))
    bounds = t[max(j - 1, 0)], t[min(j + 1, len(t) - 1)]
    found = scipy.optimize.minimize_scalar(lambda s: -function(s), bounds=bounds, options={"xatol": 1e-12})
    return max((t[j], values[j]), (found.x, -found.fun), key=lambda point: point[1])


def crossings(t, values, function):
    """The first and the last time a function is not negative: inf and 0 if never; last inf if it is so at the end."""
    # A step that is nearly there at the nodes may get there between them.
    tops, spans = np.max(values, axis=1), np.ptp(values, axis=1)
    near = np.flatnonzero((tops < 0.0) & (tops + spans >= 0.0))
    points = [*zip(t.ravel(), values.ravel(), strict=True), *(_top(t[i], values[i], function) for i in near)]
    ts, vs = np.array(sorted(points)).T
    up = np.flatnonzero(vs >= 0.0)
    if not len(up):
        return math.inf, 0.0
    first, last = up[0], up[-1]
    begin = 0.0 if first == 0 else _root(function, ts[first - 1], ts[first])
    return begin, math.inf if last == len(ts) - 1 else _root(function, ts[last], ts[last + 1])


def _root(function, a, b):
    """Where it changes sign; `b` if it does so within rounding of one of them."""
    return scipy.optimize.brentq(function, a, b, xtol=1e-14) if function(a) * function(b) < 0.0 else b


def reversals(commands):
    """How often a sequence turns back by more than 1 % of its range so far; its first move sets the direction."""
    low = high = extreme = commands[0] if len(commands) else 0.0
    direction, count = 0.0, 0
    for u in commands[1:]:
        low, high = min(low, u), max(high, u)
        if direction * (u - extreme) >= 0.0:  # also before the first move
            direction, extreme = direction or np.sign(u - extreme), u
        elif direction * (extreme - u) > 0.01 * (high - low):
            direction, extreme, count = -direction, u, count + 1
    return count

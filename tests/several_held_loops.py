"""Sampled loops with several inputs in NumPy and SciPy, one run at a time: nothing of the package is used."""

import dataclasses
import math
from collections.abc import Callable

import numpy as np
import scipy.integrate

RTOL, ATOL = 1e-11, 1e-13
POINTS = np.linspace(0.0, 1.0, 41)  # where each stretch between events is read


def tangent(gain, sigma, rho):
    """The scaled quasi-sliding-mode law, which holds its value at the edge beyond it."""
    edge = (1.0 - 1e-9) * rho
    return -gain / rho * math.tan(0.5 * math.pi * min(max(sigma, -edge), edge) / rho)


@dataclasses.dataclass
class Held:
    """One channel: its sliding variable and funnel, and what its computer and its actuator do.

    `sigma(t, x)` and `rho(t)` are numbers, or arrays for arrays; `law(sigma, rho, memory)` gives command and memory.
    """

    sigma: Callable
    rho: Callable
    law: Callable
    period: float
    memory: float = 0.0
    delay: float = 0.0
    saturation: float = math.inf
    rate_limit: float = math.inf
    resolution: float = 0.0
    lag: float = 0.0
    fault: Callable = lambda t: 1.0

    def sent(self, t, x, last):
        """The command of a sample that reads x."""
        u, self.memory = self.law(self.sigma(t, x), self.rho(t), self.memory)
        u = np.round(u / self.resolution) * self.resolution if self.resolution > 0.0 else u
        reach = self.rate_limit * self.period
        return min(max(min(max(u, -self.saturation), self.saturation), last - reach), last + reach)


def simulate(rates, channels, x0, horizon, jumps=(), measured=lambda x, t: x):
    """The state at the end, and sup |sigma|/rho, the integral of u^2 and when it first was outside, for each channel.

    `rates(t, x, u)` are those of the plant, `measured(x, t)` is what is read of its state at time t.
    """
    n, m = len(x0), len(channels)
    samples = [(k * one.period, i) for i, one in enumerate(channels) for k in range(math.ceil(horizon / one.period))]
    arrivals = {(round((t + channels[i].delay) * 1e12), i): (t, i) for t, i in samples}
    times = {round(t * 1e12) for t in (0.0, horizon, *jumps)} | {round(t * 1e12) for t, _ in samples}
    times = sorted(t for t in times | {t for t, _ in arrivals} if t <= round(horizon * 1e12))
    due, commands, last, held = {(round(t * 1e12), i) for t, i in samples}, {}, [0.0] * m, [0.0] * m
    y, peaks, first, energy = np.array([*x0, *[0.0] * m], float), np.zeros(m), np.full(m, math.inf), np.zeros(m)
    for begin, end in zip(times, times[1:], strict=False):
        t0, t1 = begin * 1e-12, end * 1e-12
        for i, one in enumerate(channels):
            if (begin, i) in due:
                last[i] = commands[round((t0 + one.delay) * 1e12), i] = one.sent(t0, measured(y[:n], t0), last[i])
            held[i] = commands.get((begin, i), held[i])
        faults = [one.fault(0.5 * (t0 + t1)) for one in channels]

        def field(t, y, held=tuple(held), faults=faults):
            us = [y[n + i] if one.lag > 0.0 else held[i] for i, one in enumerate(channels)]
            moved = [(held[i] - y[n + i]) / one.lag if one.lag > 0.0 else 0.0 for i, one in enumerate(channels)]
            return [*rates(t, y[:n], np.multiply(us, faults)), *moved]

        found = scipy.integrate.solve_ivp(field, (t0, t1), y, "DOP853", dense_output=True, rtol=RTOL, atol=ATOL)
        ts = t0 + (t1 - t0) * POINTS
        path = found.sol(ts)
        for i, one in enumerate(channels):
            z = np.abs(one.sigma(ts, path[:n])) / one.rho(ts)
            peaks[i] = max(peaks[i], z.max())
            if first[i] == math.inf and z.max() >= 1.0:
                first[i] = np.interp(1.0, z[: z.argmax() + 1], ts[: z.argmax() + 1]) if z[0] < 1.0 else t0
            u = path[n + i] if one.lag > 0.0 else np.full_like(ts, held[i])
            energy[i] += np.trapezoid(u**2, ts)
        y = found.y[:, -1]
    return y[:n], peaks, energy, first

"""A two-link arm in continuous time under limited laws, laws of one's own and observers: against SciPy and studies."""

import dataclasses
import runpy
from typing import ClassVar

import jax.numpy as jnp
import numpy as np
import pytest
import scipy.integrate
from jaxtyping import Array, Float

import places
import qsmc_jax as qj
from arm_by_hand import SIGMAS, WIDTHS, by_hand
from qsmc_jax.base.module import float_field

STUDY = runpy.run_path(str(places.STUDIES / "two_link_arm.py"))["study"]
NOMINAL, HORIZON, OMEGA = STUDY.nominal, 2.0, 300.0
RHOS = [lambda t, r0=r0, mu=mu, r=r: r0 * np.exp(-mu * t) + r for r0, mu, r in WIDTHS]


class Held(qj.AbstractControl):
    """Proportional to the sliding variable, with a guess of the weight: of the output and of the desired one."""

    surface: qj.SlidingSurface
    funnel: qj.AbstractFunnel
    k: Float[Array, ""] = float_field(default=60.0)
    weight: Float[Array, ""] = float_field(default=20.0)
    gain_sign: Float[Array, ""] = float_field(default=1.0)

    positive: ClassVar[tuple[str, ...]] = ("k",)

    def first_memory(self):
        """None."""
        return ()

    def command(self, sample, memory):
        """Both parts."""
        return self.weight * jnp.cos(sample.output[0]) + sample.desired[2] - self.k * sample.sigma, ()


def limited(law, most):
    """The law between limits."""
    return qj.controllers.Saturated(law, (-most, most))


def tangents(t, sigmas, limits):
    """The limited quasi-sliding laws by hand."""
    found = []
    for sigma, rho, most in zip(sigmas, RHOS, limits, strict=True):
        z = sigma / rho(t)
        u = -10.0 / rho(t) * np.tan(0.5 * np.pi * np.where(np.abs(z) < 1.0, z, 0.0))
        found.append(np.clip(np.where(np.abs(z) < 1.0, u, -np.copysign(np.inf, z)), -most, most))
    return np.array(found)


def by_sigmas(limits):
    """Limited laws of the errors themselves."""
    return lambda t, y: tangents(t, [sigma(t, y[:4]) for sigma in SIGMAS], limits)


def by_estimates(limits):
    """Limited laws of the first joint's errors, and of what is estimated of the second's."""
    return lambda t, y: tangents(t, [SIGMAS[0](t, y[:4]), 3.0 * y[4] + y[5]], limits)


def own(t, y):
    """A guess of the weight on the first joint, and on the second a smaller one."""
    feed = np.array([20.0 * np.cos(y[0]) - 0.5 * np.sin(t), 5.0 * np.cos(y[1]) - 0.676 * np.cos(1.3 * t)])
    return feed - np.array([60.0, 30.0])[:, None].reshape((2,) + (1,) * (np.ndim(y) - 1)) * np.array(
        [sigma(t, y[:4]) for sigma in SIGMAS]
    )


FIRST, SECOND = NOMINAL.loop.controls
# The laws, the same by hand, and which channel leaves its funnel.
CASES = {
    "limited": ((limited(FIRST, 60.0), limited(SECOND, 22.0)), by_sigmas((60.0, 22.0)), None),
    "too weak": ((limited(FIRST, 90.0), limited(SECOND, 12.0)), by_sigmas((90.0, 12.0)), 1),
    "own": (
        tuple(Held(law.surface, law.funnel, *each) for law, each in ((FIRST, (60.0, 20.0)), (SECOND, (30.0, 5.0)))),
        own,
        None,
    ),
    "observed": (
        (limited(FIRST, 60.0), limited(qj.controllers.HighGainObserver(SECOND, OMEGA), 22.0)),
        by_estimates((60.0, 22.0)),
        None,
    ),
}


def solved(u, is_observed):
    """Times, states, and the first time at which a channel is outside, by SciPy."""
    rates = by_hand(NOMINAL.loop.plant, NOMINAL.loop.disturbances)

    def rate(t, y):
        moved = rates(t, y[:4], u(t, y))
        if not is_observed:
            return moved
        off = y[1] - 0.4 * np.cos(1.3 * t) - y[4]
        return [*moved, y[5] + 2.0 * OMEGA * off, OMEGA**2 * off]

    edge = lambda t, y: 1.0 - max(abs(s(t, y[:4])) / r(t) for s, r in zip(SIGMAS, RHOS, strict=True))  # noqa: E731
    edge.terminal, x0 = True, np.asarray(NOMINAL.x0, float)
    y0 = [*x0, x0[1] - 0.4, 0.0] if is_observed else x0
    options = {"rtol": 1e-10, "atol": 1e-12, "max_step": 1e-2, "dense_output": True, "events": edge}
    found = scipy.integrate.solve_ivp(rate, (0.0, HORIZON), y0, "DOP853", **options)
    ts = np.linspace(0.0, found.t[-1], 40_001)
    return ts, found.sol(ts)


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_an_arm_under_other_laws_is_what_scipy_makes_of_it(name):
    laws, u, left = CASES[name]
    ts, y = solved(u, name == "observed")
    loop = dataclasses.replace(NOMINAL.loop, controls=laws)
    settings = qj.SolverSettings(1e-8, 1e-10)
    run = qj.simulate(loop, NOMINAL.x0, HORIZON, bandwidth=STUDY.bandwidth, settings=settings)
    f, us = run.metrics.channels, u(ts, y)
    if left is None:
        assert run.verdict.name == "HELD"
        states = [i for i in range(run.x.shape[1]) if i != 4]  # there an observer keeps whether it has measured yet
        np.testing.assert_allclose(run.x[-1, states], y[:, -1], rtol=1e-6, atol=1e-7)
    else:
        assert float(f[f"violation_time[{left}]"]) == pytest.approx(ts[-1], abs=1e-6)
        assert run.verdict.name == run.verdicts[f"funnel[{left}]"].name == "VIOLATED"
        assert run.verdicts[f"funnel[{1 - left}]"].name == "UNDECIDED"
    for i in () if left is not None else range(2):
        ratio = np.abs(SIGMAS[i](ts, y[:4]) / RHOS[i](ts)).max()
        assert float(f[f"peak_ratio[{i}]"]) == pytest.approx(ratio, abs=1e-6)
        assert float(f[f"peak_u[{i}]"]) == pytest.approx(np.abs(us[i]).max(), rel=1e-5)
    if name in ("limited", "observed"):  # one meets its limit
        assert (np.abs(us) == np.array([[law.input_range[1]] for law in laws])).any()

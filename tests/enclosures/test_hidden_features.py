"""Random short features anywhere in a loop: no run is HELD that SciPy, made to resolve them, sees leave its funnel."""

import dataclasses
import functools as ft
import math

import jax.numpy as jnp
import numpy as np
import pytest

import eventful
import qsmc_jax as qj
from eventful import FX, GAUSSIAN, HALF_SINE, REF, SECH, STEP, Case, D, F, G

T1 = 20.0
# Of z = |sigma| / rho; of the time of leaving [s].
PEAK, TIME = 1e-3, 1e-3
SAMPLE = 10  # runs besides the violated and the extreme ones that SciPy solves too


def in_time(n, draw):
    """A feature in the disturbance, the drift, or the gain."""
    width = draw.log_uniform("width", 1e-5 * T1, 0.3 * T1)
    where = draw.choice("where", [D, F, FX, G])
    shape = draw.choice("shape", [GAUSSIAN, HALF_SINE, STEP, SECH])
    # What stays is weaker: an explicit method would have to follow it at its limit of stability.
    push = jnp.clip(draw.log_uniform("area", 3e-3, 3.0) / width, 0.3, jnp.where(shape == STEP, 10.0, 300.0))
    height = draw.sign("way") * jnp.where(where == G, draw.log_uniform("depth", 0.3, 30.0), push)
    return dict(shape=shape, where=where, width=width, height=height)


def in_reference(n, draw):
    """One in the reference, of a size that an input can follow."""
    width = draw.log_uniform("width", 1e-4 * T1, 0.3 * T1)
    # More would keep an explicit method at its limit of stability for 1e5 steps.
    height = jnp.minimum(draw.log_uniform("effort", 0.1, 20.0) * width**n, 1.0)
    return dict(shape=draw.choice("shape", [GAUSSIAN, STEP]), where=REF, width=width, height=draw.sign("way") * height)


def case(n, feature, draw):
    sign = draw.sign("sign")
    funnel = (4.0, draw.uniform("mu", 0.5, 3.0), draw.log_uniform("rho_inf", 0.02, 0.5))
    x0 = draw.uniform("x0", -0.1, 0.1, shape=(n,))
    numbers = dict(level=draw.uniform("level", -1.0, 1.0), size=draw.uniform("size", 0.0, 0.5))
    numbers |= dict(swing=draw.uniform("swing", 0.0, 2.0), push_out=draw.uniform("push_out", -1.0, 1.0))
    return Case(n, funnel, x0, T1, sign, at=draw.uniform("at", 0.0, T1), **numbers, **feature(n, draw))


@ft.cache
def study(n, feature):
    def scenario(draw):
        one = case(n, feature, draw)
        return qj.Scenario(one.loop(), x0=one.x0, t1=T1)

    return qj.Study(scenario, bandwidth=1.0)


class Drawn:
    """What a row of a table says was drawn, in place of a draw."""

    def __init__(self, row):
        self.row = row

    def __getattr__(self, kind):
        def value(name, *args, shape=()):
            if shape:
                return tuple(float(self.row[f"{name}[{i}]"]) for i in range(shape[0]))
            return float(self.row[name])

        return value


def numbers_of(n, feature, row):
    """The case of a row, in plain numbers."""
    one = case(n, feature, Drawn(row))
    plain = {"shape": int(one.shape), "where": int(one.where), "width": float(one.width), "height": float(one.height)}
    return dataclasses.replace(one, **plain)


def check(n, feature, method, runs, seed=0):
    """Verdicts, peaks and times of all runs that are violated or extreme, and some others, against SciPy's."""
    settings = qj.SolverSettings(method=method)
    table = qj.monte_carlo(study(n, feature), runs, seed, settings=settings, block=64 * math.ceil(runs / 128))
    verdicts, peaks = np.asarray(table["verdict"]), np.asarray(table["peak_ratio"])
    is_violated = verdicts == int(qj.Verdict.VIOLATED)
    is_decided = np.isin(verdicts, [int(qj.Verdict.HELD), int(qj.Verdict.VIOLATED)])
    is_admissible = verdicts != int(qj.Verdict.INADMISSIBLE)  # a reference that turns at once may start outside
    assert is_decided.sum() > 0.99 * is_admissible.sum()
    assert is_admissible.mean() > 0.95
    assert 0.03 * runs < is_violated.sum() < 0.8 * runs or feature is in_reference  # else nothing is put to the test
    extreme = np.argsort(np.where(is_violated | ~is_decided, 0.0, -peaks))[: max(SAMPLE, runs // 20)]
    others = np.random.default_rng(seed).choice(runs, max(SAMPLE, runs // 20), replace=False)
    for i in sorted({*np.flatnonzero(is_violated), *extreme, *others} & {*np.flatnonzero(is_decided)}):
        one = numbers_of(n, feature, {name: table[name][i] for name in table.names})
        left, peak, _ = eventful.scipys(one)
        assert is_violated[i] == math.isfinite(left), one
        if is_violated[i]:
            assert float(table["violation_time"][i]) == pytest.approx(left, abs=TIME), one
        else:
            assert peaks[i] == pytest.approx(peak, abs=PEAK), one


@pytest.mark.slow
def test_nothing_narrow_hides():
    check(1, in_time, "tsit5", 128)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("n", "runs", "feature", "method"),
    [
        (1, 256, in_time, "tsit5"),
        (1, 256, in_time, "rodas5p"),
        (1, 256, in_reference, "tsit5"),
        (2, 128, in_time, "tsit5"),
        (3, 64, in_time, "rodas5p"),
    ],
)
def test_nothing_narrow_hides_in_hundreds(n, runs, feature, method):
    check(n, feature, method, runs, seed=n)

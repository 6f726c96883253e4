"""The solver's methods on problems with known solutions: order, stiffness, dense output, derivatives; for any field."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from qsmc_jax.solvers.rosenbrock import RODAS4, RODAS5P, Rosenbrock
from qsmc_jax.solvers.tsit5 import Tsit5

METHODS = {"tsit5": Tsit5(), "rodas4": Rosenbrock(RODAS4), "rodas5p": Rosenbrock(RODAS5P)}
ORDERS = {"tsit5": 5, "rodas4": 4, "rodas5p": 5}
ROSENBROCK = pytest.mark.parametrize("name", ["rodas4", "rodas5p"])
EVERY = pytest.mark.parametrize("name", METHODS)
QUICK = [pytest.param(name, marks=pytest.mark.slow) if name == "rodas4" else name for name in METHODS]


def rotating(t, y, args):
    """y = (cos t^2, sin t^2 / (1 + t)): neither autonomous nor linear in its arguments."""
    a, b = y
    return -2.0 * t * b * (1.0 + t), 2.0 * t * a / (1.0 + t) - b / (1.0 + t) * (a * a + (b * (1.0 + t)) ** 2)


def truth(t):
    return np.array([np.cos(t**2), np.sin(t**2) / (1.0 + t)])


def prothero_robinson(t, y, stiffness):
    """y = sin t, attracted at the rate `stiffness`."""
    return (-stiffness * (y[0] - jnp.sin(t)) + jnp.cos(t),)


def solve(method, field, y0, t1, steps, args=None, ts=None):
    saveat = dfx.SaveAt(t1=True) if ts is None else dfx.SaveAt(ts=ts)
    y0 = tuple(map(jnp.asarray, y0))
    return dfx.diffeqsolve(
        dfx.ODETerm(field), method, 0.0, t1, t1 / steps, y0, args=args, saveat=saveat, max_steps=steps + 1
    ).ys


def errors(name, counts, ts=None):
    for steps in counts:
        ys = np.stack(solve(METHODS[name], rotating, (1.0, 0.0), 1.5, steps, ts=ts))
        yield np.max(np.abs(ys - truth(np.array([1.5]) if ts is None else ts)))


@EVERY
@pytest.mark.slow
def test_order_is_as_stated(name):
    coarse, fine = errors(name, (60, 120))
    assert np.log2(coarse / fine) == pytest.approx(ORDERS[name], abs=0.35)
    assert METHODS[name].order(None) == ORDERS[name]


@EVERY
@pytest.mark.slow
def test_dense_output_is_of_order_four(name):
    coarse, fine = errors(name, (60, 120), ts=np.linspace(0.0, 1.5, 977))
    assert np.log2(coarse / fine) > (2.7 if name == "rodas4" else 3.7)  # between the ends; RODAS's own is a cubic


@ROSENBROCK
@pytest.mark.parametrize("stiffness", [1e3, 1e6, 1e9])
def test_stiff_solution_is_followed_in_steps_as_long_as_it_allows(name, stiffness):
    (y1,) = solve(METHODS[name], prothero_robinson, (0.0,), 2.0, 20, args=stiffness)
    assert abs(float(y1[0]) - np.sin(2.0)) < 1e-5


@ROSENBROCK
def test_fast_transient_is_damped_in_one_step(name):
    """L-stable: with h lambda = 1e8 what was off is gone after a step."""
    (y1,) = solve(METHODS[name], prothero_robinson, (1.0,), 0.1, 1, args=1e9)
    assert abs(float(y1[0]) - np.sin(0.1)) < 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", QUICK)
def test_forward_and_reverse_mode_agree(name):
    def end(y0):
        return solve(METHODS[name], rotating, (1.0, y0), 1.5, 40)[1][0]

    def end_forward(y0):
        return dfx.diffeqsolve(
            dfx.ODETerm(rotating),
            METHODS[name],
            0.0,
            1.5,
            1.5 / 40,
            (jnp.asarray(1.0), y0),
            adjoint=dfx.ForwardMode(),
            max_steps=41,
        ).ys[1][0]

    reverse, forward = jax.grad(end)(0.0), jax.jacfwd(end_forward)(jnp.asarray(0.0))
    difference = (end(1e-5) - end(-1e-5)) / 2e-5
    assert float(reverse) == pytest.approx(float(forward), rel=1e-9)
    assert float(reverse) == pytest.approx(float(difference), rel=1e-6)


@EVERY
@pytest.mark.slow
def test_batch_is_a_loop(name):
    starts = np.linspace(0.5, 1.5, 5)
    batch = jax.vmap(lambda y0: jnp.stack(solve(METHODS[name], rotating, (y0, 0.0), 1.0, 16)))(starts)
    single = [np.stack(solve(METHODS[name], rotating, (y0, 0.0), 1.0, 16)) for y0 in starts]
    np.testing.assert_allclose(batch, single, rtol=1e-13)

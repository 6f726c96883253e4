"""Gradients through one run, by reverse mode, against central differences of tight solves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import problems
import qsmc_jax as qj
from qsmc_jax.simulation.engine import pose, solve

GAINS = {"rho_inf": 0.1, "mu": 1.0}
DEFAULT, TIGHT, TIGHTEST = 1e-6, 1e-10, 1e-13
# The gradient is that of the steps taken: some ten times the tolerance off; the difference itself is good to 1e-8.
ATOL = {DEFAULT: 2e-5, TIGHT: 1e-8}
STEP = 1e-4


def peak(gains, gain_sign, rtol, adjoint="reverse"):
    """sup |sigma|/rho of a loop of order 1 that follows sin t under d = sin(3 t) / 2, and the verdict."""
    control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(1.0, gains["mu"], gains["rho_inf"]), gain_sign)
    plant, reference = problems.chain(1)(drift_scale=1.0), qj.references.SumOfSines([1.0], [1.0])
    loop = qj.ClosedLoop(plant, reference, qj.disturbances.Sine(0.5, 3.0), control)
    settings = qj.SolverSettings(rtol, adjoint=adjoint)
    figures, _ = solve(pose(loop, 0.2, settings), (jnp.asarray(0.1),), jnp.asarray(4.0), settings)
    return figures.peak_ratio, (figures.verdict, figures.peak_time)


@pytest.fixture(scope="module")
def program():
    return jax.jit(jax.value_and_grad(peak, has_aux=True))


@pytest.mark.parametrize("rtol", [DEFAULT, TIGHT])
@pytest.mark.parametrize("gain", GAINS)
def test_gradient_is_the_central_difference(program, gain, rtol):
    (_, (verdict, peak_time)), gradient = program(GAINS, 1.0, rtol)
    up, down = (program({**GAINS, gain: GAINS[gain] + step}, 1.0, TIGHTEST)[0][0] for step in (STEP, -STEP))
    assert verdict == qj.Verdict.HELD
    assert 0.1 < peak_time < 3.9  # inside: both gains have a say
    assert float(gradient[gain]) == pytest.approx(float(up - down) / (2 * STEP), abs=ATOL[rtol], rel=0)


def test_gradient_of_a_violated_run_is_finite(program):
    (value, (verdict, _)), gradient = program(GAINS, -1.0, DEFAULT)
    assert verdict == qj.Verdict.VIOLATED
    assert value == 1.0
    assert np.all(np.isfinite(list(gradient.values())))


@pytest.mark.parametrize("gain", GAINS)
def test_forward_mode_gives_the_same_gradient(program, gain):
    (_, _), reverse = program(GAINS, 1.0, TIGHT)
    direction = {name: float(name == gain) for name in GAINS}

    @jax.jit
    def forward(gains, rtol):
        return jax.jvp(lambda g: peak(g, 1.0, rtol, "forward")[0], (gains,), (direction,))[1]

    assert float(forward(GAINS, TIGHT)) == pytest.approx(float(reverse[gain]), abs=ATOL[TIGHT], rel=0)

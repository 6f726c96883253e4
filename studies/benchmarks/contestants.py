"""The paper's examples as users would write them elsewhere: each returns sup |sigma|/rho of each run as it sees it.

All take starts (runs, n), amplitudes of the disturbance (runs,), the final half-width and a tolerance, and solve to
t = 20 s in physical coordinates.
"""

import functools as ft
import math
import re
import shutil
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.integrate

HORIZON = 20.0
GRID = np.linspace(0.0, HORIZON, 2001)
GAIN = 1.0 / (0.01 * 9.8**2)


Motion = Callable[..., tuple[Any, ...]]


def example1(xp: Any, t: Any, x: Any, amplitude: Any, rho_inf: Any) -> tuple[Any, ...]:
    """The derivatives of both states, and sigma / rho."""
    x1, x2 = x
    ratio = (2.0 * (x1 - xp.sin(t)) + x2 - xp.cos(t)) / (4.0 * xp.exp(-3.0 * t) + rho_inf)
    u = -xp.tan(0.5 * math.pi * ratio)
    return x2, -xp.sin(x1) - x2 + xp.sin(x2) + GAIN * u + amplitude * xp.sin(t), ratio


def example2(xp: Any, t: Any, x: Any, amplitude: Any, rho_inf: Any) -> tuple[Any, ...]:
    """The derivatives of the four states, and sigma / rho; the disturbance of the paper times the amplitude."""
    x1, x2, x3, x4 = x
    sin, cos, slow_sin, slow_cos = xp.sin(t), xp.cos(t), xp.sin(0.5 * t), xp.cos(0.5 * t)
    errors = x1 - sin - slow_cos, x2 - cos + 0.5 * slow_sin, x3 + sin + 0.25 * slow_cos, x4 + cos - 0.125 * slow_sin
    sigma = 6.0 * errors[0] + 12.0 * errors[1] + 8.0 * errors[2] + errors[3]
    ratio = sigma / (5.0 * xp.exp(-3.0 * t) + rho_inf)
    late = xp.where(t < 9.0, xp.sin(math.pi * t), xp.cos(math.pi * t) - 1.0)
    d = amplitude * xp.where(t < 6.0, 0.5 * xp.sin(0.5 * math.pi * t), late)
    u = -xp.tan(0.5 * math.pi * ratio)
    return x2, x3, x4, x3 * xp.sin(2.0 * x2) + x1 * xp.cos(x4) + (2.0 - xp.sin(x4)) * u + d, ratio


def scipy_loop(motion: Motion, method: str) -> Callable[..., np.ndarray]:
    """`solve_ivp` run by run, the peak read off a grid of 2001 points."""

    def solve(x0: np.ndarray, amplitudes: np.ndarray, rho_inf: float, tolerance: float) -> np.ndarray:
        def peak(start: np.ndarray, amplitude: float) -> float:
            def field(t: float, x: np.ndarray) -> list[float]:
                return list(motion(math_as_numpy, t, x, amplitude, rho_inf)[:-1])

            run = scipy.integrate.solve_ivp(
                field, (0.0, HORIZON), start, method, t_eval=GRID, rtol=tolerance, atol=tolerance / 100
            )
            return float(np.max(np.abs(motion(np, run.t, run.y, amplitude, rho_inf)[-1])))

        return np.array([peak(start, amplitude) for start, amplitude in zip(x0, amplitudes, strict=True)])

    return solve


class math_as_numpy:  # noqa: N801  # stands in for a module
    """Scalar functions, which SciPy's loop calls far quicker than NumPy's."""

    sin, cos, exp, tan = math.sin, math.cos, math.exp, math.tan

    @staticmethod
    def where(condition: bool, a: float, b: float) -> float:
        """The one or the other."""
        return a if condition else b


@ft.partial(jax.jit, static_argnums=(0, 1))
def _diffrax_batch(
    motion: Motion,
    solver: Callable[[], dfx.AbstractSolver],
    x0: jax.Array,
    amplitudes: jax.Array,
    rho_inf: float,
    tolerance: float,
) -> jax.Array:
    def peak(start: jax.Array, amplitude: jax.Array) -> jax.Array:
        def field(t: Any, x: Any, _: Any) -> jax.Array:
            return jnp.stack(motion(jnp, t, x, amplitude, rho_inf)[:-1])

        controller = dfx.PIDController(rtol=tolerance, atol=tolerance / 100)
        run = dfx.diffeqsolve(
            dfx.ODETerm(field),
            solver(),
            0.0,
            HORIZON,
            0.01,
            start,
            saveat=dfx.SaveAt(ts=jnp.asarray(GRID)),
            stepsize_controller=controller,
            max_steps=100_000,
            throw=False,
        )
        return jnp.max(jnp.abs(motion(jnp, jnp.asarray(GRID), jnp.asarray(run.ys).T, amplitude, rho_inf)[-1]))

    return jax.vmap(peak)(x0, amplitudes)


def plain_diffrax(motion: Motion, solver: Callable[[], dfx.AbstractSolver]) -> Callable[..., np.ndarray]:
    """`jit(vmap(diffeqsolve))` with a stacked state, the peak read off a grid of 2001 points."""

    def solve(x0: np.ndarray, amplitudes: np.ndarray, rho_inf: float, tolerance: float) -> np.ndarray:
        with jax.enable_x64(True):
            return np.asarray(
                _diffrax_batch(motion, solver, x0, amplitudes, np.float64(rho_inf), np.float64(tolerance))
            )

    return solve


def numpy_rk4(motion: Motion) -> Callable[..., np.ndarray]:
    """All runs as NumPy arrays, fixed steps of RK4 as long as the tolerance's fourth root allows, the peak at steps."""

    def solve(x0: np.ndarray, amplitudes: np.ndarray, rho_inf: float, tolerance: float) -> np.ndarray:
        def field(t: float, x: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            *rates, ratio = motion(np, t, x, amplitudes, rho_inf)
            return np.stack(rates), ratio

        x, steps = x0.T.copy(), math.ceil(HORIZON / (0.1 * tolerance**0.25))
        h, peak = HORIZON / steps, np.zeros(len(x0))
        with np.errstate(all="ignore"):
            for i in range(steps):
                t = i * h
                k1, ratio = field(t, x)
                k2, _ = field(t + h / 2, x + h / 2 * k1)
                k3, _ = field(t + h / 2, x + h / 2 * k2)
                k4, _ = field(t + h, x + h * k3)
                peak = np.maximum(peak, np.abs(ratio))
                x = x + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return peak

    return solve


def numba_tsit5() -> Callable[..., np.ndarray] | None:  # noqa: C901  # one loop, as its users write it
    """Example 1 by adaptive Tsit5, run by run over all cores, the peak at the ends of steps; None without numba."""
    try:
        import numba  # pyright: ignore[reportMissingImports]  # of the extra `bench`
    except ImportError:
        return None
    tableau = dfx.Tsit5.tableau
    a, c = np.zeros((6, 6)), np.asarray(tableau.c)
    for i, row in enumerate(tableau.a_lower):
        a[i, : len(row)] = row
    error_weights = np.asarray(tableau.b_error)

    @numba.njit(fastmath=False)
    def motion(t: float, x1: float, x2: float, amplitude: float, rho_inf: float) -> tuple[float, float, float]:
        ratio = (2.0 * (x1 - math.sin(t)) + x2 - math.cos(t)) / (4.0 * math.exp(-3.0 * t) + rho_inf)
        u = -math.tan(0.5 * math.pi * ratio)
        return x2, -math.sin(x1) - x2 + math.sin(x2) + GAIN * u + amplitude * math.sin(t), ratio

    @numba.njit(parallel=True)
    def solve(x0: np.ndarray, amplitudes: np.ndarray, rho_inf: float, tolerance: float) -> np.ndarray:
        peaks = np.zeros(len(x0))
        for run in numba.prange(len(x0)):
            t, h, x1, x2, amplitude = 0.0, 0.01, x0[run, 0], x0[run, 1], amplitudes[run]
            k = np.zeros((7, 2))
            k[0, 0], k[0, 1], ratio = motion(t, x1, x2, amplitude, rho_inf)
            peak = abs(ratio)
            for _ in range(1_000_000):
                if t >= HORIZON:
                    break
                h = min(h, HORIZON - t)
                y1, y2 = x1, x2
                for i in range(6):
                    y1, y2 = x1, x2
                    for j in range(i + 1):
                        y1 += h * a[i, j] * k[j, 0]
                        y2 += h * a[i, j] * k[j, 1]
                    k[i + 1, 0], k[i + 1, 1], ratio = motion(t + c[i] * h, y1, y2, amplitude, rho_inf)
                e1 = e2 = 0.0
                for i in range(7):
                    e1 += h * error_weights[i] * k[i, 0]
                    e2 += h * error_weights[i] * k[i, 1]
                e1 /= tolerance / 100 + tolerance * max(abs(x1), abs(y1))
                e2 /= tolerance / 100 + tolerance * max(abs(x2), abs(y2))
                error = math.sqrt(0.5 * (e1 * e1 + e2 * e2)) + 1e-10
                if error <= 1.0:
                    t, x1, x2, k[0, 0], k[0, 1] = t + h, y1, y2, k[6, 0], k[6, 1]
                    peak = max(peak, abs(ratio))
                h *= min(10.0, max(0.2, 0.9 * error**-0.2))
            peaks[run] = peak
        return peaks

    return solve


class CompiledTsit5:
    """Example 1 in hand-written C++ (tsit5.cpp): runs in vector registers, no supremum; for speed alone."""

    def __init__(self):
        """Compiles, if there is a compiler."""
        source = Path(__file__).with_name("tsit5.cpp")
        self.program = Path(tempfile.mkdtemp()) / "tsit5"
        flags = ["-Ofast", "-march=native", "-fopenmp-simd", "-mprefer-vector-width=512"]
        compiler = shutil.which("g++")
        self.is_there = (
            bool(compiler)
            and not subprocess.run(
                [str(compiler), *flags, str(source), "-o", str(self.program), "-lmvec", "-lm", "-pthread"],
                capture_output=True,
            ).returncode
        )

    def seconds(self, runs: int, threads: int, tolerance: float) -> float:
        """Time of so many runs [s], the best of four in one call."""
        done = subprocess.run(
            [str(self.program), str(runs), str(threads), str(tolerance)], capture_output=True, text=True, check=True
        )
        return min(float(found) for found in re.findall(r" ([0-9.]+)s ", done.stdout))

"""Methods of descent, from one start: SciPy's SLSQP, any optax method, any optimistix minimiser."""

import dataclasses
from typing import Any, TypeAlias

import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix as optx
from jaxtyping import Float
from scipy import optimize, special

from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.tuning.batch import Batch

Method: TypeAlias = str | optax.GradientTransformation | optx.AbstractMinimiser
METHODS = ("slsqp", "adam", "bfgs")

# Weight of a passed constraint against the relative objective, for methods that know no constraints.
_PENALTY = 10.0
# How far inside its bounds an unbounded method may start: its coordinate is infinite at a bound.
_INSIDE = 1e-3


@dataclasses.dataclass
class Slope:
    """Objective and constraints along a descent, relative to the objective at its start; the last point is kept.

    Attributes:
        batch: The training runs.
        smoothing: Width of the smooth maximum.
        start: Number of the start.
        scale: What the objective is divided by; 0 for what it is at the first point, over the runs that have it.
    """

    batch: Batch
    smoothing: float
    start: int
    scale: float
    _last: tuple[bytes, np.ndarray, np.ndarray] | None = None

    def at(self, v: Float[np.ndarray, " names"]) -> tuple[np.ndarray, np.ndarray]:
        """Relative objective, excesses and what lost runs lack, (1 + constraints + 1), with their derivatives."""
        key = np.asarray(v, np.float64).tobytes()
        if self._last is None or self._last[0] != key:
            _, values, slopes = self.batch.differentiate(np.asarray(v), self.smoothing, self.start)
            self.scale = self.scale or abs(float(values[0])) or 1.0
            unit = np.array([self.scale, *np.ones(len(values) - 1)])
            values = values / unit
            values[1:-1] += self.batch.inside
            self._last = (key, values, slopes / unit[:, None])
        return self._last[1], self._last[2]

    def penalised(self, v: Float[np.ndarray, " names"]) -> tuple[float, np.ndarray]:
        """The objective with each passed constraint added, linearly and squared."""
        values, slopes = self.at(v)
        over = np.maximum(values[1:], 0.0)
        value = values[0] + _PENALTY * float(np.sum(over + over**2))
        return float(value), slopes[0] + _PENALTY * ((over > 0.0) * (1.0 + 2.0 * over)) @ slopes[1:]


def descend(slope: Slope, v0: Float[np.ndarray, " names"], method: Method, steps: int, tolerance: float) -> None:
    """Goes down from `v0`, once no run is lost there; what it meets is in the history of the batch.

    Where runs are lost the objective is not known: what they lost is made small first, and if that ends with runs still
    lost, so does the descent.

    Args:
        slope: Objective and constraints.
        v0: The start, in the unit cube.
        method: "slsqp", "adam", "bfgs", an optax transformation or an optimistix minimiser.
        steps: Steps at most.
        tolerance: Relative change of the objective below which it stops.
    """
    v0 = _keeping_runs(slope, v0, steps)
    if slope.at(v0)[0][-1] > 0.0:
        return
    if method == "slsqp":
        _by_slsqp(slope, v0, steps, tolerance)
    elif method == "bfgs" or isinstance(method, optx.AbstractMinimiser):
        minimiser = optx.BFGS(tolerance, tolerance) if isinstance(method, str) else method
        _by_optimistix(slope, v0, minimiser, steps)  # pyright: ignore[reportArgumentType]
    else:
        _by_optax(slope, v0, optax.adam(0.1) if isinstance(method, str) else method, steps, tolerance)


def _keeping_runs(slope: Slope, v0: np.ndarray, steps: int) -> np.ndarray:
    """The first point down the loss of the lost runs at which none is lost, or the one at which they lose least."""

    def is_enough(intermediate_result: optimize.OptimizeResult) -> None:
        if intermediate_result.fun <= 0.0:
            raise StopIteration

    def loss(v: np.ndarray) -> tuple[float, np.ndarray]:
        values, slopes = slope.at(v)
        return float(values[-1]), slopes[-1]

    if loss(v0)[0] <= 0.0:
        return v0
    bounds, options = [(0.0, 1.0)] * len(v0), {"maxiter": steps, "maxfun": 2 * steps}
    found = optimize.minimize(loss, v0, jac=True, method="L-BFGS-B", bounds=bounds, callback=is_enough, options=options)
    return np.clip(found.x, 0.0, 1.0)


def _by_slsqp(slope: Slope, v0: np.ndarray, steps: int, tolerance: float) -> None:
    """Sequential quadratic programming: constraints and bounds as they are, and no run lost."""
    constraints = {
        "type": "ineq",
        "fun": lambda v: -slope.at(v)[0][1:],
        "jac": lambda v: -slope.at(v)[1][1:],
    }
    optimize.minimize(
        lambda v: slope.at(v)[0][0],
        v0,
        jac=lambda v: slope.at(v)[1][0],
        method="SLSQP",
        bounds=[(0.0, 1.0)] * len(v0),
        constraints=[constraints],
        options={"maxiter": steps, "ftol": tolerance},
    )


def _by_optax(slope: Slope, v0: np.ndarray, method: optax.GradientTransformation, steps: int, tolerance: float) -> None:
    """In the coordinate logit v, which keeps the bounds; stops when the best of 20 steps is no better than before."""
    y = special.logit(np.clip(v0, _INSIDE, 1.0 - _INSIDE))
    values: list[float] = []
    with in_64_bits(), jax.numpy_dtype_promotion("standard"):
        state = method.init(jnp.asarray(y))
        for _ in range(steps):
            value, gradient = _in_logit(slope, y)
            values.append(float(value))
            if len(values) > 40 and min(values[-20:]) > min(values[:-20]) - tolerance:
                return
            update, state = method.update(jnp.asarray(gradient), state, jnp.asarray(y))
            y = np.asarray(optax.apply_updates(jnp.asarray(y), update))


def _by_optimistix(slope: Slope, v0: np.ndarray, method: optx.AbstractMinimiser, steps: int) -> None:
    """In the same coordinate; the runs are called back from the compiled minimiser."""
    y0 = special.logit(np.clip(v0, _INSIDE, 1.0 - _INSIDE))
    shapes = jax.ShapeDtypeStruct((), np.float64), jax.ShapeDtypeStruct(y0.shape, np.float64)

    @jax.custom_jvp
    def value(y: jax.Array) -> jax.Array:
        return jax.pure_callback(lambda y: _in_logit(slope, np.asarray(y)), shapes, y)[0]

    @value.defjvp
    def _(primals: Any, tangents: Any) -> tuple[jax.Array, jax.Array]:
        out, gradient = jax.pure_callback(lambda y: _in_logit(slope, np.asarray(y)), shapes, primals[0])
        return out, gradient @ tangents[0]

    with in_64_bits():
        optx.minimise(lambda y, _: value(y), method, jnp.asarray(y0), max_steps=steps, throw=False)


def _in_logit(slope: Slope, y: np.ndarray) -> tuple[np.float64, np.ndarray]:
    """The penalised objective and its derivative by the logit of the coordinates."""
    v = special.expit(y)
    value, gradient = slope.penalised(v)
    return np.float64(value), gradient * v * (1.0 - v)

r"""How far several channels together are from their funnels: $V = \frac{1}{\pi}\sum_i \ln(1 + \tan^2(\pi z_i / 2))$.

Along a run of several channels, $\dot\sigma = w + B u$, with $v_i = \tan(\pi z_i / 2) / \rho_i$ and $u = u_0 - S v$,
$\dot V = v \cdot (w + B u_0 - \dot m - \dot\rho z) - v \cdot B S v$. Where V peaks after the start it does not fall:
there $|v| \le M = |w + B u_0 - \dot m - \dot\rho z| / \lambda$ with the least eigenvalue $\lambda$ of the symmetric
part of $B S$, and V is no larger than it can be for such a v. No run of the true loop passes that bound. Of other laws
than the quasi-sliding one nothing of the kind is known.
"""

import functools as ft

import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.numerics import pytrees
from qsmc_jax.numerics.gudermann import ratio
from qsmc_jax.numerics.hermite import Cubic, Quartic, cubics
from qsmc_jax.simulation.ideal.step import Step, as_scalars
from qsmc_jax.simulation.problem import JointProblem


class RunningBarrier(AbstractModule):
    """The peak of V so far: its height, its time [s] and the coordinates there; and V at time 0."""

    height: RealScalarLike
    time: RealScalarLike
    y: Scalars
    first: RealScalarLike


def first_barrier(problem: JointProblem, y0: Scalars) -> RunningBarrier:
    """What is known at time 0."""
    value = _value(_coordinates(problem, y0))
    return RunningBarrier(value, jnp.zeros(()), as_scalars(y0), value)


def add_barrier(problem: JointProblem, running: RunningBarrier, step: Step) -> RunningBarrier:
    """The same after one more step."""
    h, ends = step.t1 - step.t0, ((step.y0, step.dy0), (step.y1, step.dy1))
    points = [tuple(_coordinates(problem, each) for each in end) for end in ends]
    values, rates = [_value(s) for s, _ in points], [h * _rate(*end) for end in points]
    path = Quartic(Cubic(*values, *rates), _value(_coordinates(problem, step.middle)))
    theta, height = problem.barrier(path.highest())
    y = tuple(cubic(theta) for cubic in cubics(h, step.y0, step.y1, step.dy0, step.dy1))
    found = RunningBarrier(height, step.t0 + theta * h, y, running.first)
    return pytrees.where(height > running.height, found, running)


def barrier_bound(problem: JointProblem, running: RunningBarrier) -> Float[Array, ""]:
    """What V can be at its peak; `inf` where the inputs' symmetric part is not positive definite there.

    NaN if a law is another than the quasi-sliding one.
    """
    loop, t = problem.loop, running.time
    if not loop.is_quasi_sliding:
        return jnp.full((), jnp.nan)
    free, rows = loop.drive(t, running.y[: loop.states])
    pushes, widths, offsets = [], [], []
    for law, w, s in zip(loop.sliding_laws, free, _coordinates(problem, running.y), strict=True):
        rho, rho_rate = law.funnel.width_and_rate(t)
        pushes.append(w - law.funnel.centre_and_rate(t)[1] - rho_rate * ratio(s))
        widths.append(jnp.asarray(rho))
        offsets.append(jnp.asarray(law.offset))
    push = jnp.stack(pushes) + jnp.stack([jnp.stack(row) for row in rows]) @ jnp.stack(offsets)
    least = jnp.linalg.eigvalsh(loop.acting(t, rows))[0]
    largest = jnp.linalg.norm(push) / jnp.where(least > 0.0, least, 1.0)
    at_peak = jnp.where(least > 0.0, _most(largest, jnp.stack(widths)), jnp.inf)
    return jnp.maximum(running.first, at_peak)


def _most(size: Float[Array, ""], widths: Float[Array, " m"]) -> Float[Array, ""]:
    r"""The largest $\frac{1}{\pi} \sum \ln(1 + \rho_i^2 v_i^2)$ for $|v|$ = `size`.

    With $q_i = v_i^2$ it is concave: each $q_i$ is what a common level is above $1 / \rho_i^2$, if it is above at all.
    """
    floors = jnp.sort(widths**-2)
    level = jnp.min((size**2 + jnp.cumsum(floors)) / jnp.arange(1.0, len(widths) + 1.0))
    return jnp.sum(jnp.log(jnp.maximum(level / floors, 1.0))) / jnp.pi


def _coordinates(problem: JointProblem, y: Scalars) -> Scalars:
    """The funnel coordinates of all channels, or their rates."""
    return tuple(y[problem.loop.states :])


def _value(coordinates: Scalars) -> RealScalarLike:
    r"""$V = \frac{2}{\pi} \sum \ln \cosh s_i$, which does not overflow."""
    sizes = (jnp.abs(s) for s in coordinates)
    return (2.0 / jnp.pi) * sum(size + jnp.log1p(jnp.exp(-2.0 * size)) - jnp.log(2.0) for size in sizes)


def _rate(coordinates: Scalars, rates: Scalars) -> RealScalarLike:
    """Its derivative, given those of the coordinates."""
    turns = (jnp.tanh(s) * rate for s, rate in zip(coordinates, rates, strict=True))
    return (2.0 / jnp.pi) * ft.reduce(jnp.add, turns)

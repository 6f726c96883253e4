"""Metrics of runs and their derivatives by the names of a study: blocks over threads, like the runs themselves."""

import dataclasses
import functools as ft
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.metrics.standard import Metrics
from qsmc_jax.simulation.settings import CHECKPOINTS, SolverSettings
from qsmc_jax.study.batches import BatchSolver, thread_count
from qsmc_jax.study.one_run import run
from qsmc_jax.study.sampling import Random
from qsmc_jax.study.study import Study


@dataclasses.dataclass(frozen=True)
class Tangents:
    """Metrics of some runs and their derivatives, one row a run.

    Attributes:
        values: Metrics, (runs, metrics); NaN where a metric is not known.
        jacobian: Their derivatives by the names, (runs, metrics, names); 0 where a metric or its derivative is not
            known, so that no mean is spoilt.
        is_known: Where metric and derivative are both known, (runs, metrics).
        verdict: The runs' verdicts on the funnel.
        outcome: How their solves ended.
    """

    values: Float[np.ndarray, "runs metrics"]
    jacobian: Float[np.ndarray, "runs metrics names"]
    is_known: np.ndarray
    verdict: np.ndarray
    outcome: np.ndarray


def differentiate(
    study: Study,
    indices: np.ndarray,
    seed: int,
    *,
    names: tuple[str, ...],
    metrics: tuple[str, ...],
    settings: SolverSettings,
    block: int,
    threads: int | None = None,
) -> Tangents:
    """Solves independent runs and differentiates their metrics by numbers of the study.

    The supremum's derivative is that of the value at its place, which is right wherever the place is unique. Memory in
    forward mode is that of the runs times twice the names; in reverse mode some 3 MB a run solved at the same time.
    The gradient of a run with more steps than reverse mode can keep is not known, rather than wrong.

    Args:
        study: The study, at the values at which to differentiate.
        indices: Indices of the runs.
        seed: Seed of the study.
        names: Parameters of the study, each one number.
        metrics: Columns of the table of runs, each a number with a derivative.
        settings: Method, tolerances, and the mode: `adjoint="forward"` for a few names, `"reverse"` for many.
        block: Runs solved together, a multiple of 64.
        threads: Blocks solved at the same time; None for one a core of a CPU.

    Returns:
        The metrics and derivatives, on the host.
    """
    solver = BatchSolver(study, settings, block)
    program = solver.compile_block(_Block(solver.choices(solver.nominal_method), names, metrics))
    chunks = [indices[i : i + block] for i in range(0, len(indices), block)]

    def solve(chunk: np.ndarray) -> list[np.ndarray]:
        result = solver.call(program, Random().points(seed, chunk, study.dimension))
        return [np.asarray(part)[: len(chunk)] for part in result]

    with ThreadPoolExecutor(thread_count(threads)) as pool:
        values, jacobian, verdict, outcome, steps = map(np.concatenate, zip(*pool.map(solve, chunks), strict=True))
    is_known = np.isfinite(values) & np.isfinite(jacobian).all(axis=2)
    if settings.adjoint == "reverse" and study.nominal.loop.implementation is None:
        is_known &= (steps <= CHECKPOINTS)[:, None]
    return Tangents(values, np.where(is_known[:, :, None], jacobian, 0.0), is_known, verdict, outcome)


@dataclasses.dataclass(frozen=True)
class Along:
    """Solves runs together, each with the slope of one metric along a direction of the unit cube.

    A gradient is a lane for each of its entries, and a run without one a lane along nothing: so one program of a fixed
    size serves all. Made twice of equal settings it is equal, so that nothing is compiled twice.

    Attributes:
        choices: What is static in the settings.
        metric: A column of the table of runs, a number with a derivative.
    """

    choices: tuple[tuple[str, Any], ...]
    metric: str

    def __call__(
        self,
        scenario: Any,
        points: Float[Array, "lanes dim"],
        values: Mapping[str, Array],
        bandwidth: Float[Array, "..."],
        rtol: Float[Array, ""],
        atol: Float[Array, ""],
        directions: Float[Array, "lanes dim"],
    ) -> tuple[dict[str, Array], Metrics, Float[Array, " lanes"]]:
        settings = SolverSettings(rtol, atol, **dict(self.choices))

        def along(point: Float[Array, " dim"], direction: Float[Array, " dim"]) -> Any:
            def solve(point: Float[Array, " dim"]) -> Any:
                drawn, made = run(scenario, settings, bandwidth, values, point)
                return made.columns()[self.metric], (drawn, made)

            _, slope, (drawn, made) = jax.jvp(solve, (point,), (direction,), has_aux=True)
            return drawn, made, slope

        return jax.vmap(along)(points, directions)


@dataclasses.dataclass(frozen=True)
class _Block:
    """Differentiates runs together; made twice of equal settings it is equal, so that nothing is compiled twice."""

    choices: tuple[tuple[str, Any], ...]
    names: tuple[str, ...]
    metrics: tuple[str, ...]

    def __call__(
        self,
        scenario: Any,
        points: Float[Array, "lanes dim"],
        values: Mapping[str, Array],
        bandwidth: Float[Array, "..."],
        rtol: Float[Array, ""],
        atol: Float[Array, ""],
    ) -> tuple[Array, Array, Array, Array, Array]:
        settings = SolverSettings(rtol, atol, **dict(self.choices))
        at = jnp.stack([values[name] for name in self.names])

        def metrics(
            at: Float[Array, " names"], point: Float[Array, " dim"]
        ) -> tuple[Array, tuple[Array, Array, Array, Array]]:
            tuned = {name: at[i] for i, name in enumerate(self.names)}
            _, made = run(scenario, settings, bandwidth, {**values, **tuned}, point)
            columns = made.columns()
            chosen = jnp.stack([columns[metric] for metric in self.metrics])
            return chosen, (chosen, made.verdict, made.outcome, made.steps)

        mode = _forward if settings.adjoint == "forward" else _reverse
        jacobian, (chosen, verdict, outcome, steps) = mode(metrics, at, points)
        return chosen, jacobian, verdict, outcome, steps


def _reverse(metrics: Callable[..., Any], at: Float[Array, " names"], points: Float[Array, "lanes dim"]) -> Any:
    return jax.vmap(ft.partial(jax.jacrev(metrics, has_aux=True), at))(points)


def _forward(metrics: Callable[..., Any], at: Float[Array, " names"], points: Float[Array, "lanes dim"]) -> Any:
    """A lane for each run and name: all numbers then have one shape, which XLA compiles to a third of the time.

    Tangents beside a run's own numbers, as `jacfwd` has them, make it work out the latter anew for each.
    """

    def along(point: Float[Array, " dim"], direction: Float[Array, " names"]) -> tuple[Array, Any]:
        _, slopes, rest = jax.jvp(lambda at: metrics(at, point), (at,), (direction,), has_aux=True)
        return slopes, rest

    count, names = len(points), len(at)
    directions = jnp.tile(jnp.eye(names), (count, 1))
    slopes, rest = jax.vmap(along)(jnp.repeat(points, names, axis=0), directions)
    jacobian = jnp.swapaxes(slopes.reshape(count, names, -1), 1, 2)
    return jacobian, jax.tree.map(lambda leaf: leaf[::names], rest)

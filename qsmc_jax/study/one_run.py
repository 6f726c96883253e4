"""One run of a scenario as pure functions of its point of the unit cube: what batches vmap and replays compile."""

import functools as ft
from collections.abc import Callable, Mapping
from typing import Any

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.precision import entry_point
from qsmc_jax.metrics.standard import Metrics
from qsmc_jax.simulation.engine import pose, solve
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.signals import SolvedRun, solve_along
from qsmc_jax.simulation.stiffness import stiffness
from qsmc_jax.study.contents import Made
from qsmc_jax.study.draw import Draw

Values = Mapping[str, Array]


def run(
    scenario: Made,
    settings: SolverSettings,
    bandwidth: Float[Array, "..."],
    values: Values,
    point: Float[Array, " dim"],
) -> tuple[dict[str, Array], Metrics]:
    """The values of a run's names, and those of its metrics that its study asks for: XLA works out no others."""
    draw = Draw(point, values)
    made = scenario(draw)
    x0 = made.loop.start(made.x0)
    problem = pose(made.loop.whole, x0, bandwidth, settings, scenario.contents, scenario.measures)
    metrics, _ = solve(problem, x0, jnp.asarray(made.t1), settings, is_drawn_well=draw.is_valid)
    return {name: jnp.asarray(value) for name, value in draw.recorded.items()}, metrics.only(scenario.standard)


def run_along(
    scenario: Made,
    settings: SolverSettings,
    bandwidth: Float[Array, "..."],
    ts: Float[Array, " times"],
    values: Values,
    point: Float[Array, " dim"],
) -> tuple[dict[str, Array], SolvedRun]:
    """The values of a run's names, its metrics and its signals at the times."""
    draw = Draw(point, values)
    made = scenario(draw)
    known = draw.is_valid, scenario.contents, scenario.measures
    solved = solve_along(made.loop, made.x0, jnp.asarray(made.t1), bandwidth, ts, settings, *known)
    return {name: jnp.asarray(value) for name, value in draw.recorded.items()}, solved


def stiffness_at(scenario: Made, values: Values, point: Float[Array, " dim"]) -> Float[Array, ""]:
    """How stiff a run will be; see simulation/stiffness.py."""
    made = scenario(Draw(point, values))
    return jnp.asarray(stiffness(made.loop, made.x0, jnp.asarray(made.t1), scenario.contents))


@ft.lru_cache(maxsize=64)
def program(function: Callable[..., Any], scenario: Made) -> Callable[..., Any]:
    """One of the functions above for a single run, compiled once for each scenario, whatever the numbers are.

    A scenario may make functions anew in every call, a plant with a `lambda` in it: since it is called inside the
    program, that compiles nothing. What the scenario is made of must be what it was when the study was made.
    """
    scenario.require_unchanged()
    return entry_point(eqx.filter_jit(ft.partial(function, scenario)))

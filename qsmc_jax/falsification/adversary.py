"""A study under the worst disturbance that its own may become: within its bound, constant or switching."""

import dataclasses
from collections.abc import Callable
from typing import Any

import jax.numpy as jnp

from qsmc_jax.model.disturbances import AbstractDisturbance, Constant, Telegraph
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.study.draw import Draw
from qsmc_jax.study.study import Scenario, Study

# What the names of an adversary's numbers begin with.
PREFIX = "adversary"
# The places of switches in the unit cube are cubes of what is drawn: most of what a funnel sees happens early.
_EARLY = 3


def against(study: Study, switches: int | None) -> Study:
    r"""The study whose disturbance, where it enters, is a level between $\pm$ its bound that may switch.

    Its bound is that of the study's own disturbance in the same run, whatever else that draws. By the maximum principle
    a worst disturbance of a loop that is affine in it lies on its bound and switches, if at all.

    Args:
        study: The study.
        switches: How many times the disturbance may switch, 0 for a constant; None leaves the study as it is.
    """
    if switches is None:
        return study
    given = {"values": study.values, "metrics": study.metrics, "requirements": study.requirements}
    return Study(_Attacked(study.scenario, switches), study.bandwidth, **given)


@dataclasses.dataclass(frozen=True)
class _Attacked:
    """The scenario of a study with an adversary in place of its disturbances; equal where it does the same."""

    scenario: Callable[[Draw], Scenario]
    switches: int

    def __call__(self, draw: Draw) -> Scenario:
        made = self.scenario(draw)
        if isinstance(made.loop, MultivariableLoop):
            worst = (self._worst(draw, f"{PREFIX}.{i}", d, made.t1) for i, d in enumerate(made.loop.disturbances))
            loop = dataclasses.replace(made.loop, disturbances=tuple(worst))
        else:
            loop = dataclasses.replace(made.loop, disturbance=self._worst(draw, PREFIX, made.loop.disturbance, made.t1))
        return dataclasses.replace(made, loop=loop)

    def _worst(self, draw: Draw, name: str, own: AbstractDisturbance, t1: Any) -> AbstractDisturbance:
        bound = draw.record(f"{name}.bound", own.bound)
        if not self.switches:
            return Constant(bound * draw.uniform(f"{name}.level", -1.0, 1.0))
        levels = draw.uniform(f"{name}.level", -1.0, 1.0, shape=(self.switches + 1,))
        parts = draw.uniform(f"{name}.switch", 0.0, 1.0, shape=(self.switches,))
        times = [t1 * parts[0] ** _EARLY]
        for i in range(1, self.switches):
            times.append(times[-1] + (t1 - times[-1]) * parts[i] ** _EARLY)
        return Telegraph(draw.record(f"{name}.time", jnp.stack(times)), bound * levels)


def without_disturbance(made: Scenario) -> list[Any]:
    """What a scenario is made of but for its disturbances, in a list that can be compared."""
    several = isinstance(made.loop, MultivariableLoop)
    name, none = ("disturbances", ()) if several else ("disturbance", None)
    fields = {field.name: getattr(made.loop, field.name) for field in dataclasses.fields(made.loop)}
    return [made.x0, made.t1, {**fields, name: none}]


def bound_of(made: Scenario) -> float:
    """The bound of the disturbance of a scenario; of several the sum."""
    loop = made.loop
    own = loop.disturbances if isinstance(loop, MultivariableLoop) else (loop.disturbance,)
    return float(sum(float(each.bound) for each in own))

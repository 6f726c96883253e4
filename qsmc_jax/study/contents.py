"""What a study computes, by hashes: noticed is whatever changes it, be it in a file of data or an imported module."""

import dataclasses
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import numpy as np

from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.metrics.check import Sizes, kind_of, program_of
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.simulation.contents import Contents, functions_of
from qsmc_jax.study.draw import Draw
from qsmc_jax.study.specs import dimension
from qsmc_jax.tracing.digest import digest


def contents(scenario: Callable[[Any], Any], measures: tuple[AbstractMeasure, ...] = ()) -> Contents:
    """A hash of the program of each part of a scenario, and of the numbers in it, wherever they come from.

    Args:
        scenario: The scenario. Two with the same contents give the same rows.
        measures: Metrics and requirements of the study, each of which is a part.
    """
    draw = Draw()
    with in_64_bits():
        nominal = scenario(draw)
    own = ((f"{kind_of(each)} `{each.name}`", _measure(each, nominal.loop.sizes)) for each in measures)
    return (("scenario", _scenario(scenario, dimension(draw.specs))), *functions_of(nominal.loop), *own)


@dataclasses.dataclass(frozen=True)
class Made:
    """A scenario and what it is made of; programs belong to both.

    Attributes:
        scenario: The scenario.
        contents: Its contents when its study was made.
        measures: Metrics and requirements of the study.
        standard: Names of the standard metrics that it asks for.
    """

    scenario: Callable[[Any], Any]
    contents: Contents
    measures: tuple[AbstractMeasure, ...] = ()
    standard: tuple[str, ...] = ()

    def __call__(self, draw: Any) -> Any:
        """What the scenario returns."""
        return self.scenario(draw)

    def require_unchanged(self) -> None:
        """Raises if the scenario, with all that it reads from outside, such as a global, is not what it was.

        Raises:
            InputError: It has changed: programs that are compiled from now on would be of another loop.
        """
        changed = [
            part for part, hashed in contents(self.scenario, self.measures) if (part, hashed) not in self.contents
        ]
        if changed:
            raise InputError(
                f"Argument `scenario` must compute the same in every call, but its {changed[-1]} has changed since the "
                "study was made. Numbers that it reads from outside belong to the study: make it anew, "
                "`qj.Study(scenario, ...)`, after changing one, or draw them by `draw.parameter`."
            )


def _measure(measure: AbstractMeasure, sizes: Sizes) -> str:
    """Its programs, its windows, and how its parts are joined."""
    first, *others = (program_of(measure, part, sizes) for part in measure.parts)
    windows = [(type(part).__name__, part.after, part.before) for part in measure.parts]
    return digest(first, others, windows, [record.unit for record in measure.records], measure.form)


def _scenario(scenario: Callable[[Any], Any], dim: int) -> str:
    point = jax.ShapeDtypeStruct((dim,), np.float64)
    structures: list[Any] = []

    def program(point: Any) -> Any:
        arrays, rest = eqx.partition(scenario(Draw(point, {})), eqx.is_array_like)
        structures.append(rest)
        return arrays

    with in_64_bits():
        traced = jax.make_jaxpr(program)(point)
    return digest(traced, jax.tree.leaves(structures[0]), str(jax.tree.structure(structures[0])))

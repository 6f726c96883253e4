"""Named numbers of a scenario: a pure function from the unit cube.

A scenario is a plain function `scenario(draw)`. Each distribution takes its coordinates of the unit cube, in order of
appearance, through its inverse CDF; a parameter takes none. So every kind of study is a choice of a point and of the
names to substitute, and any run can be done again from these two.
"""

import dataclasses
import functools as ft
import math
from collections.abc import Callable, Sequence
from typing import Any

import jax
import numpy as np
from jaxtyping import Array

from qsmc_jax.base.checks import is_traced
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.study.distributions import AbstractDistributions
from qsmc_jax.study.joint import AbstractJoint
from qsmc_jax.study.specs import RECORDED, DrawSpec, dimension, require_fixed, require_inside
from qsmc_jax.tracing.traceable import traceable


class Draw(AbstractDistributions, AbstractJoint):
    """What a scenario is given: draws the numbers of one run by their names.

    Each method returns a float64 number, or an array of the given `shape`, and makes it a column of the result table.
    A number takes one coordinate of the unit cube, in order of appearance, which the inverse CDF of its distribution
    takes to its value: so designs, sensitivity and searches know all distributions alike. Arguments may depend on
    numbers drawn before, unless it says that they must be fixed; derivatives go through them and the value.

    Examples:
        As an annotation it lets an editor complete the methods; by itself it shows what a point of the cube becomes:

        >>> import qsmc_jax as qj
        >>> def scenario(draw: qj.Draw) -> qj.Scenario:
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)
        >>> scenario(qj.Draw([0.5, 0.25])).x0.tolist()
        [0.5, 0.30000000000000004]
    """

    def parameter(self, name: str, default: RealScalarLike, *, bounds: tuple[RealScalarLike, RealScalarLike]) -> Any:
        """A named number that is fixed at `default` unless something substitutes it; takes no coordinate.

        Args:
            name: The name, a column of the result.
            default: Its value.
            bounds: Smallest and largest value: what may be substituted, and where `qj.tune` searches.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([]).parameter("mu", 3.0, bounds=(0.5, 10.0)))
            3.0
        """
        low, high = self._interval(name, "bounds[0]", bounds[0], "bounds[1]", bounds[1])
        require_fixed(f"default` of `{name}", default)
        default = self._number(name, "default", default)
        value = self._values.get(name, default)
        # A value that is data was compared with fixed bounds before the run.
        if is_traced(low, high) or not is_traced(value):
            inside = ft.partial(require_inside, f"default` of `{name}", default, (low, high))
            self._check((low <= value) & (value <= high), inside)
        return self._keep(name, "parameter", default, (low, high), size=0)

    def record(self, name: str, value: Any) -> Any:
        """Makes a number that the scenario works out from others a column; returns it.

        Args:
            name: The name, a column of the result.
            value: The number, or an array.

        Examples:
            >>> import qsmc_jax as qj
            >>> draw = qj.Draw([0.5])
            >>> float(draw.record("weight", 9.81 * draw.uniform("mass", 1.0, 3.0)))
            19.62
        """
        return self._keep(name, RECORDED, as_float64(value), (-math.inf, math.inf), size=0)


def discover(scenario: Callable[[Any], Any]) -> tuple[tuple[DrawSpec, ...], Any]:
    """Finds the names of a scenario.

    It is called once with NumPy numbers, at the nominal point (parameters at their defaults, distributions at their
    medians), and once traced, to see which bounds depend on other names.

    Args:
        scenario: A function of a `Draw`, traceable by JAX; which names it draws must not depend on their values.

    Returns:
        The names in order of appearance, and what the scenario returned at the nominal point.
    """
    with in_64_bits():
        draw = Draw()
        result = scenario(draw)
        with traceable("Argument `scenario`", "the numbers it draws"):
            dependent = _dependent_names(scenario, draw.specs)
    loose = {"bounds": (-math.inf, math.inf), "levels": ()}
    return tuple(dataclasses.replace(s, **loose) if s.name in dependent else s for s in draw.specs), result


def _dependent_names(scenario: Callable[[Any], Any], specs: Sequence[DrawSpec]) -> set[str]:
    """Names whose bounds depend on the values of others: what a traced call finds traced."""
    draws = []

    def trace(point: Array, values: dict[str, Array]) -> None:
        draws.append(Draw(point, values))
        scenario(draws[-1])

    point = jax.ShapeDtypeStruct((dimension(specs),), np.float64)
    values = {s.name: jax.ShapeDtypeStruct((), np.float64) for s in specs if s.kind == "parameter"}
    jax.eval_shape(trace, point, values)
    return draws[0].dependent

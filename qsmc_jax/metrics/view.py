"""A step of a solve as metrics look at it: at the nodes of a quadrature rule."""

import dataclasses
import functools as ft
import math

import jax
import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.metrics.signals import AbstractStep, Signals

# Gauss-Lobatto rule with five nodes on [0, 1], exact for polynomials of degree 7.
_INNER = 0.5 * (1.0 - math.sqrt(3.0 / 7.0))
NODES = (0.0, _INNER, 0.5, 1.0 - _INNER, 1.0)
WEIGHTS = (1.0 / 20.0, 49.0 / 180.0, 16.0 / 45.0, 49.0 / 180.0, 1.0 / 20.0)


@dataclasses.dataclass(frozen=True)
class View:
    """A step as a metric looks at it.

    Attributes:
        step: The step.
    """

    step: AbstractStep

    @ft.cached_property
    def nodes(self) -> Signals:
        """The signals at `NODES`, each with the nodes as its first axis."""
        return self.step.once(jax.vmap(self.step.at)(jnp.array(NODES)))

    @ft.cached_property
    def rates(self) -> Signals:
        """Their derivatives by the place in the step."""
        rate = jax.vmap(lambda place: jax.jvp(self.step.at, (place,), (jnp.ones(()),))[1])
        return self.step.once(rate(jnp.array(NODES)))

    @property
    def length(self) -> RealScalarLike:
        """Its length [s]."""
        return self.step.t1 - self.step.t0

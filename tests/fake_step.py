"""A step of a solve for tests of what is kept of it."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp

import qsmc_jax as qj
from qsmc_jax.metrics.signals import AbstractStep


class UnitStep(AbstractStep):
    """A step from 0 to 1 s in which x[0] is a function of the place and the data, and all else is 0."""

    data: Any = 0.0
    course: Callable[..., Any] = eqx.field(static=True, default=lambda theta, data: theta)

    @property
    def t0(self):
        return jnp.zeros(())

    @property
    def t1(self):
        return jnp.ones(())

    def once(self, tree):
        return tree

    def at(self, theta):
        zero = jnp.zeros(())
        return qj.metrics.Signals(zero, (self.course(theta, self.data),), (zero,), (zero,), *(zero,) * 7)

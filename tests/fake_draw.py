"""A stand-in for the study layer's draw, so that models can be tested without it."""

import math

import numpy as np

from qsmc_jax.base.types import DrawLike


class FakeDraw(DrawLike):
    """A seeded source of named numbers that records what it was asked."""

    def __init__(self, seed=0):
        self.rng = np.random.default_rng(seed)
        self.names = []

    def _named(self, name, value):
        self.names.append(name)
        return value

    def uniform(self, name, low, high, *, shape=()):
        return self._named(name, low + (high - low) * self.rng.uniform(size=shape))

    def log_uniform(self, name, low, high, *, shape=()):
        return self._named(name, np.exp(self.rng.uniform(math.log(low), math.log(high), shape)))

    def record(self, name, value):
        return self._named(name, value)

    def exponential(self, name, mean, *, shape=()):
        return self._named(name, self.rng.exponential(mean, shape))

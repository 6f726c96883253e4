"""A way to have XLA compute a value once, however many use it."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool

from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike


class Barrier(AbstractModule):
    """Divides by one. In a loop, XLA for CPUs repeats cheap arithmetic for each number kept, but not a quotient.

    The compiler must not know that it is one. Without barriers a step of a solver takes twice as long.

    Attributes:
        one: The number 1.0, in a way that only shows when the program runs.
    """

    one: RealScalarLike

    def __call__(self, tree: Any) -> Any:
        """The same numbers, exactly."""
        return jax.tree.map(lambda leaf: leaf / self.one, tree)

    def claim(self, claim: BoolScalarLike) -> Bool[Array, ""]:
        """The same claim."""
        return self(jnp.where(claim, 1.0, 0.0)) > 0.5

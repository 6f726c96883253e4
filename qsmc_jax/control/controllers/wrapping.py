"""What a law that is made of another has from it."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.control.control import AbstractControl
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.surface import SlidingSurface


class AbstractWrappingControl(AbstractControl):
    """A controller around another one, whose surface, funnel and sign it has.

    Attributes:
        law: The other one.
    """

    law: eqx.AbstractVar[AbstractControl]

    @property
    def surface(self) -> SlidingSurface:
        """That of the law."""
        return self.law.surface

    @property
    def funnel(self) -> AbstractFunnel:
        """That of the law."""
        return self.law.funnel

    @property
    def gain_sign(self) -> Float[Array | np.ndarray, ""]:
        """That of the law."""
        return self.law.gain_sign

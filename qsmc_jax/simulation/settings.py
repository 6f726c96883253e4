"""How a loop is solved: method, tolerances, step limit, coordinates. The only place with such numbers."""

import dataclasses
from typing import Any, Literal, get_args

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_count, require_positive
from qsmc_jax.base.module import AbstractModule, as_float64, float_field
from qsmc_jax.base.types import RealScalarLike

# Largest absolute tolerance of the funnel coordinate: at the limit of stability of an explicit method, where it solves
# stiff loops at loose tolerances, steps come out some ten times worse than estimated.
_LOOSEST_IN_FUNNEL = 3e-5

# How far absolute tolerances are lowered for a run that is still close to rest.
_SMALLEST_SCALE = 1e-12
# How well time is resolved, relative to it: some units in its last place.
INSTANT = 64.0 * float(np.finfo(float).eps)

# States of an ideal run that reverse mode keeps. Of a run with more steps it solves parts again, in another program: it
# may round otherwise, take other steps, and so differentiate another run (3 % off in the median run of Example 2).
CHECKPOINTS = 4096

Method = Literal["auto", "other", "tsit5", "rodas4", "rodas5p"]
CoordinatesName = Literal["funnel", "physical"]
Adjoint = Literal["reverse", "forward"]


class SolverSettings(AbstractModule):
    """Settings of a solve. Tolerances are data (another value does not recompile), the rest is static.

    A loop with an implementation is always solved by one explicit method of order 3, between samples: of the settings
    it takes `rtol` (of the sliding variable, relative to the funnel and itself), `max_steps`, `adjoint` and
    `vectorise`.

    Attributes:
        rtol: Relative tolerance [-] of each integrated coordinate, in (0, 1).
        atol: Absolute tolerance, positive; `None` stands for `rtol / 100`.
        max_steps: Steps, kept or not, after which a run is given up as UNDECIDED; at least 1.
        method: `"tsit5"` (explicit, order 5), `"rodas5p"` (linearly implicit, order 5, for stiff loops) or `"rodas4"`
            (an older one of order 4); `"auto"` takes the first or the second by the stiffness of each run, and the
            first in a program that is being traced; `"other"` the one of the two that `"auto"` does not take, for an
            independent check.
        coordinates: `"funnel"` integrates the loop in the funnel coordinate, which has no pole to step over;
            `"physical"` integrates the states as they are and rejects every step with a stage outside the funnel: an
            independent cross-check.
        adjoint: The mode of differentiation that the solve is made for: `"reverse"` (one result, any number of
            parameters) or `"forward"` (`jvp`, `jacfwd`; the quicker one for a few parameters). In reverse
            mode the gradient of an ideal run of more than 4096 steps is wrong, see `CHECKPOINTS`: use forward mode.
        vectorise: Whether sine, cosine, tangent and arctangent in the loop, your plant's included, are replaced on CPUs
            by ones that XLA vectorises; they differ in the last place.

    Raises:
        InputError: A tolerance is not positive, rtol is not below 1, or a name is unknown.

    Examples:
        >>> import qsmc_jax as qj
        >>> settings = qj.SolverSettings(rtol=1e-4)
        >>> float(settings.atol), settings.method, settings.replace(method="rodas5p").method
        (1e-06, 'auto', 'rodas5p')
    """

    rtol: Float[Array, ""] = float_field()
    atol: Float[Array, ""] = float_field()
    max_steps: int = eqx.field(static=True)
    method: Method = eqx.field(static=True)
    coordinates: CoordinatesName = eqx.field(static=True)
    adjoint: Adjoint = eqx.field(static=True)
    vectorise: bool = eqx.field(static=True)

    def __init__(
        self,
        rtol: RealScalarLike = 1e-6,
        atol: RealScalarLike | None = None,
        max_steps: int = 100_000,
        method: Method = "auto",
        coordinates: CoordinatesName = "funnel",
        adjoint: Adjoint = "reverse",
        vectorise: bool = True,
    ):
        self.rtol = as_float64(rtol)
        self.atol = as_float64(self.rtol / 100.0 if atol is None else atol)
        self.max_steps = max_steps
        self.method = method
        self.coordinates = coordinates
        self.adjoint = adjoint
        self.vectorise = vectorise

    def __check_init__(self):
        require_positive("rtol", self.rtol)
        require_positive("atol", self.atol)
        require(is_traced(self.rtol) or bool(self.rtol < 1), f"Argument `rtol` must be below 1, but is {self.rtol}.")
        require_count("max_steps", self.max_steps)
        for name, value, known in (
            ("method", self.method, get_args(Method)),
            ("coordinates", self.coordinates, get_args(CoordinatesName)),
            ("adjoint", self.adjoint, get_args(Adjoint)),
        ):
            require(value in known, f"Argument `{name}` must be one of {list(known)}, but is {value!r}.")

    def replace(self, **changes: Any) -> "SolverSettings":
        """The same settings but for the given ones.

        Args:
            **changes: Arguments of the constructor, by name.
        """
        return dataclasses.replace(self, **changes)

    @property
    def choices(self) -> tuple[tuple[str, Any], ...]:
        """Name and value of what is static: another choice is another program."""
        static = [field.name for field in dataclasses.fields(self) if field.metadata.get("static")]
        return tuple((name, getattr(self, name)) for name in static)

    @property
    def funnel_atol(self) -> RealScalarLike:
        """Absolute tolerance of the funnel coordinate, which is dimensionless: `rtol / 10`, but no more than 3e-5.

        An error in it is one of as much in sigma/rho at the funnel's centre, and relative to u at its edge.
        """
        return jnp.minimum(0.1 * self.rtol, _LOOSEST_IN_FUNNEL)


def absolute_tolerance(usual: RealScalarLike, largest: RealScalarLike, moved: RealScalarLike) -> RealScalarLike:
    """An absolute tolerance, lowered while a run is still close to rest: nothing may hide in it.

    An unstable plant makes of a tiny deviation a large one, whose time and height depend on the first digits of it. But
    it stays above what the coordinate moves in an instant: else no step could cross a jump that ends a rest.

    Args:
        usual: The tolerance of a run that is not close to rest.
        largest: The largest |sigma|/rho, or |s|, so far.
        moved: What the coordinate moves in an instant.
    """
    return jnp.maximum(jnp.clip(10.0 * largest, _SMALLEST_SCALE, 1.0) * usual, jnp.minimum(usual, moved))


def tight() -> SolverSettings:
    """The preset for reference values: rtol 1e-8, some 2.5 times the steps of the default.

    Examples:
        >>> import qsmc_jax as qj
        >>> float(qj.tight().rtol)
        1e-08
    """
    return SolverSettings(rtol=1e-8, max_steps=1_000_000)

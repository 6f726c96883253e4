"""The closed loop as pure functions: plant, reference, disturbance and control, at one instant."""

from typing import NamedTuple

import jax

from qsmc_jax.base.checks import require
from qsmc_jax.base.module import AbstractModule
from qsmc_jax.base.types import RealScalarLike, State
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.model.disturbances import AbstractDisturbance
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.model.references import AbstractReference


class Balance(NamedTuple):
    r"""What drives the sliding variable, $\dot\sigma = w + g u$, paper eq. (9).

    Attributes:
        residual: $w = f - x_{des}^{(n)} + d + \sum_j c_j e^{(j)}$.
        gain: $g$.
        disturbance: $d$.
    """

    residual: RealScalarLike
    gain: RealScalarLike
    disturbance: RealScalarLike


class ClosedLoop(AbstractModule):
    r"""A plant under quasi-sliding-mode control: $\dot x_n = f + g u + d$ with $u$ from `control`.

    Attributes:
        plant: The plant, of order n.
        reference: The desired output $x_{des}(t)$, at least n times differentiable.
        disturbance: The matched disturbance $d(t)$.
        control: The control law with its surface (n - 1 coefficients) and funnel.

    Raises:
        ValueError: The surface does not have n - 1 coefficients, or the plant's drift or gain is not one number.

    Source: paper, eqs. (1), (2), (4).
    """

    plant: AbstractPlant
    reference: AbstractReference
    disturbance: AbstractDisturbance
    control: QuasiSlidingControl

    def __check_init__(self):
        order, has = self.plant.order, self.control.surface.order
        require(
            order == has,
            f"Argument `c` of the sliding surface must have {order - 1} coefficients for a plant of order {order}, but "
            f"has {has - 1}. `SlidingSurface.binomial(a, {order})` makes a fitting one.",
        )
        for method in ("drift", "gain"):
            _require_scalar(self.plant, method)

    @property
    def order(self) -> int:
        """The order n of the plant."""
        return self.plant.order

    def desired(self, t: RealScalarLike) -> tuple[RealScalarLike, ...]:
        """The desired output and its first n derivatives at time t [s]: n + 1 scalars."""
        return self.reference.derivatives(t, self.order)

    def state(self, errors: State, desired: State) -> tuple[RealScalarLike, ...]:
        r"""The state $x_{i+1} = x_{des}^{(i)} + e^{(i)}$; `desired` is `self.desired(t)`, which callers have."""
        return tuple(ei + di for ei, di in zip(errors, desired, strict=False))

    def errors(self, t: RealScalarLike, x: State) -> tuple[RealScalarLike, ...]:
        r"""The errors $e^{(i)} = x_{i+1} - x_{des}^{(i)}$, i = 0..n-1."""
        return tuple(xi - di for xi, di in zip(x, self.desired(t), strict=False))

    def sliding_variable(self, t: RealScalarLike, x: State) -> RealScalarLike:
        r"""The sliding variable $\sigma$, paper eq. (2)."""
        return self.control.surface(self.errors(t, x))

    def input(self, t: RealScalarLike, x: State) -> RealScalarLike:
        """The control input u, paper eq. (4); NaN outside the funnel, where the law is not defined."""
        return self.control(self.sliding_variable(t, x), self.control.funnel(t))

    def balance(self, t: RealScalarLike, errors: State, desired: State) -> Balance:
        """The terms of the sliding variable's derivative; `desired` is `self.desired(t)`, which callers have."""
        d, x = self.disturbance(t), self.state(errors, desired)
        residual = self.plant.drift(t, x) - desired[self.order] + d + self.control.surface((*errors[1:], 0.0))
        return Balance(residual, self.plant.gain(t, x), d)

    def vector_field(self, t: RealScalarLike, x: State) -> tuple[RealScalarLike, ...]:
        """The state's derivative in physical coordinates, paper eq. (1) under eq. (4); NaN outside the funnel."""
        plant = self.plant
        last = plant.drift(t, x) + plant.gain(t, x) * self.input(t, x) + self.disturbance(t)
        return (*x[1:], last)


def _require_scalar(plant: AbstractPlant, method: str) -> None:
    """Raises unless a method of the plant returns one number for a state of its order."""
    number = jax.ShapeDtypeStruct((), float)
    with jax.enable_x64(True):
        result = jax.eval_shape(getattr(plant, method), number, (number,) * plant.order)
    shape = getattr(result, "shape", None)
    found = type(result).__name__ if shape is None else f"shape {shape}"
    require(
        shape == (),
        f"`{method}` of `{type(plant).__name__}` must return one number, but returns {found}. "
        f"Index the state: x[0] ... x[{plant.order - 1}].",
    )

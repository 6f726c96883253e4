"""What a disturbance is, a bounded function of time that may say where it is not smooth; and how they combine."""

import abc
import functools as ft
from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require, require_finite
from qsmc_jax.base.module import AbstractModule, float_field, require_fields
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.model.kinks import as_times
from qsmc_jax.tracing.traceable import once_per_structure, require_number, trace


class AbstractDisturbance(AbstractModule):
    r"""A matched disturbance $d(t)$, a deterministic function of time with a provable bound.

    Randomness sits in the parameters, drawn before the run, never in the call: so a run can be solved again, at any
    tolerance. Disturbances add, and scale by a number: `2.0 * Sine(1.0, 3.0) - 1.0` is one.

    Examples:
        A ramp that ends at 1 s, as you may write it:

        >>> import jax.numpy as jnp
        >>> import qsmc_jax as qj
        >>> class Ramp(qj.AbstractDisturbance):
        ...     def __call__(self, t):
        ...         return jnp.minimum(t, 1.0)
        ...     @property
        ...     def bound(self):
        ...         return 1.0
        ...     @property
        ...     def break_times(self):
        ...         return jnp.array([1.0])
        >>> float(Ramp()(0.5)), float((2.0 * Ramp()).bound)
        (0.5, 2.0)

    Source: paper, eq. (1) and Assumption 2, $|d(t)| < \bar d$.
    """

    # NumPy scalars would otherwise try to multiply by the object entry by entry, and never ask `__rmul__`.
    __array_ufunc__: ClassVar[None] = None

    hint: ClassVar[str] = "Use one of `qj.disturbances`, or derive from `qj.AbstractDisturbance`."

    def __check_init__(self):
        require_fields(self)
        _require_disturbance(self)

    @abc.abstractmethod
    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        """The disturbance at time `t` [s], a scalar in units of the last state per second.

        At a jump it holds the value that follows (continuous from the right).
        """

    @property
    @abc.abstractmethod
    def bound(self) -> RealScalarLike:
        r"""A number $\bar d$ with $|d(t)| \le \bar d$ for all t >= 0, provable from the parameters.

        The computed d(t) may pass it by rounding. In units of the last state per second.
        """

    @property
    @abc.abstractmethod
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] at which the disturbance or one of its derivatives jumps, in any order; the solver steps to them.

        A hint that saves steps: what is not declared is found by the solver. Their number is fixed when traced; unused
        places hold `inf`. `no_breaks()` for none.
        """

    def __add__(self, other: "AbstractDisturbance | RealScalarLike") -> "AbstractDisturbance":
        return Sum((self, other if isinstance(other, AbstractDisturbance) else Constant(other)))

    def __radd__(self, other: RealScalarLike) -> "AbstractDisturbance":
        return self + other

    def __neg__(self) -> "AbstractDisturbance":
        return Scaled(-1.0, self)

    def __sub__(self, other: "AbstractDisturbance | RealScalarLike") -> "AbstractDisturbance":
        return self + -other

    def __mul__(self, scale: RealScalarLike) -> "AbstractDisturbance":
        return Scaled(scale, self)

    def __rmul__(self, scale: RealScalarLike) -> "AbstractDisturbance":
        return Scaled(scale, self)


@once_per_structure
def _require_disturbance(disturbance: AbstractDisturbance) -> None:
    """Raises unless it can be traced, with its break times, and is one number."""
    name = f"`{type(disturbance).__name__}`, a disturbance,"
    _, (value, _) = trace(
        name, "a time", disturbance, lambda d, t: (d(t), as_times(d.break_times)), jax.ShapeDtypeStruct((), float)
    )
    require_number(name, value)


def no_breaks() -> Float[Array, " breaks"]:
    """The break times of a disturbance that declares none.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.disturbances.no_breaks().shape
        (0,)
    """
    return jnp.zeros((0,))


class Constant(AbstractDisturbance):
    r"""A constant, $d(t) = v$.

    Attributes:
        value: The constant v.

    Examples:
        >>> import qsmc_jax as qj
        >>> load = qj.disturbances.Constant(-0.5)
        >>> float(load(3.0)), float(load.bound)
        (-0.5, 0.5)
    """

    value: Float[Array, ""] = float_field()

    def __check_init__(self):
        require_finite("value", self.value)

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        return jnp.asarray(self.value)

    @property
    def bound(self) -> RealScalarLike:
        return jnp.abs(self.value)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return no_breaks()


class Sum(AbstractDisturbance):
    r"""A sum of disturbances, $d(t) = \sum_i d_i(t)$, $\bar d = \sum_i \bar d_i$; `a + b` builds it.

    Attributes:
        terms: The disturbances $d_i$, one or more.

    Examples:
        >>> import qsmc_jax as qj
        >>> d = qj.disturbances.Constant(1.0) + qj.disturbances.Sine(0.5, 2.0)
        >>> type(d).__name__, float(d(0.0)), float(d.bound)
        ('Sum', 1.0, 1.5)
    """

    terms: tuple[AbstractDisturbance, ...] = eqx.field(converter=tuple)

    def __check_init__(self):
        require_disturbances("terms", self.terms)

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        return sum(term(t) for term in self.terms)

    @property
    def bound(self) -> RealScalarLike:
        return sum(term.bound for term in self.terms)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return jnp.concatenate([as_times(term.break_times) for term in self.terms])


class Scaled(AbstractDisturbance):
    r"""A multiple of a disturbance, $d(t) = s\, d_1(t)$, $\bar d = |s|\, \bar d_1$; `s * a` builds it.

    Attributes:
        scale: The factor s [-].
        disturbance: The disturbance $d_1$.

    Examples:
        >>> import qsmc_jax as qj
        >>> d = -3.0 * qj.disturbances.Constant(2.0)
        >>> type(d).__name__, float(d(0.0)), float(d.bound)
        ('Scaled', -6.0, 6.0)
    """

    scale: Float[Array, ""] = float_field()
    disturbance: AbstractDisturbance

    def __check_init__(self):
        require_finite("scale", self.scale)
        require_disturbances("disturbance", (self.disturbance,))

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        return self.scale * self.disturbance(t)

    @property
    def bound(self) -> RealScalarLike:
        return jnp.abs(self.scale) * self.disturbance.bound

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return as_times(self.disturbance.break_times)


def require_disturbances(name: str, values: tuple[object, ...]) -> None:
    """Raises unless `values` holds disturbances, at least one."""
    strangers = [type(value).__name__ for value in values if not isinstance(value, AbstractDisturbance)]
    require(
        len(values) > 0 and not strangers,
        f"Argument `{name}` must hold disturbances, at least one, but has {strangers or 'none'}. "
        "Wrap a number as `disturbances.Constant(number)`.",
    )


def largest_bound(disturbances: tuple[AbstractDisturbance, ...]) -> RealScalarLike:
    """The largest of the bounds."""
    return ft.reduce(jnp.maximum, [disturbance.bound for disturbance in disturbances])

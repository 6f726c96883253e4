"""References from a differential equation: a model that is followed, a master system."""

import abc
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require, require_finite, require_shape
from qsmc_jax.base.module import AbstractModule, require_fields
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.model.kinks import as_times
from qsmc_jax.model.state_space import derivatives_along, is_list_of
from qsmc_jax.tracing.traceable import described, once_per_structure, require_number, trace


class AbstractReferenceModel(AbstractModule):
    r"""A reference $x_{des} = h_m(t, x_m)$ that a model $\dot x_m = f_m(t, x_m)$ makes: the model's states run beside.

    Subclass it with a class attribute `states`, a field `start` (where the model starts, which may be drawn) and the
    two methods; write them with `jax.numpy`. It takes the place of a reference in a `ClosedLoop`. Derivatives of the
    output come by derivatives along $f_m$, which must be smooth: n times differentiable for a plant of order n. In runs
    the states of the model follow those of the plant in `x`; a start `x0` is the plant's alone.

    Examples:
        An oscillator of van der Pol, to be followed by a plant of order 2:

        >>> import qsmc_jax as qj
        >>> class Master(qj.AbstractReferenceModel):
        ...     start: tuple = (1.0, 0.0)
        ...     states = 2
        ...     def vector_field(self, t, x):
        ...         return x[1], (1.0 - x[0] ** 2) * x[1] - x[0]
        ...     def output(self, t, x):
        ...         return x[0]
        >>> [float(each) for each in Master().derivatives(0.0, (1.0, 0.5), 2)]
        [1.0, 0.5, -1.0]
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), Master(), qj.disturbances.Zero(), control)
        >>> run = qj.simulate(loop, [0.5, 0.5], t1=2.0)
        >>> run.verdict.name, run.x.shape, run.loop.states
        ('HELD', (2001, 4), 4)
    """

    hint: ClassVar[str] = "Derive from `qj.AbstractReferenceModel`."

    states: eqx.AbstractClassVar[int]
    start: eqx.AbstractVar[Any]

    def __check_init__(self):
        require_fields(self)
        owner = f"start` of `{type(self).__name__}"
        require_shape(owner, jnp.asarray(self.start), (self.states,), "one number for each of its `states`")
        require_finite(owner, self.start)
        _require_model(self)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        """Times [s] at which a method jumps or kinks as a function of time; see `AbstractReference.break_times`."""
        return jnp.zeros((0,))

    @abc.abstractmethod
    def vector_field(self, t: RealScalarLike, x: State) -> Scalars:
        """The rates of the model's states.

        Args:
            t: Time [s].
            x: Its state, a tuple of `states` scalars.

        Returns:
            As many scalars.
        """

    @abc.abstractmethod
    def output(self, t: RealScalarLike, x: State) -> RealScalarLike:
        """What the plant's output should be, in its units.

        Args:
            t: Time [s].
            x: State of the model, a tuple of `states` scalars.
        """

    def derivatives(self, t: RealScalarLike, x: State, order: int) -> Scalars:
        """The output and its derivatives in time along a run of the model, `order + 1` scalars.

        Args:
            t: Time [s].
            x: State of the model, a tuple of `states` scalars.
            order: Highest derivative wanted, not negative; fixed when traced.
        """
        return derivatives_along(self.output, self.vector_field, t, x, order + 1)


@once_per_structure
def _require_model(model: AbstractReferenceModel) -> None:
    """Raises unless the methods can be traced and return what they should."""
    owner, number = f"`{type(model).__name__}`", jax.ShapeDtypeStruct((), float)
    takes, state = f"a time and a state of {model.states} numbers", (number,) * model.states
    name = f"`vector_field` of {owner}"
    _, rates = trace(name, takes, model, lambda model, t, *x: model.vector_field(t, x), number, *state)
    fits = is_list_of(rates, model.states)
    require(fits, f"{name} must return {model.states} numbers, one a state, but returns {described(rates)}.")
    name = f"`output` of {owner}"
    _, output = trace(name, takes, model, lambda model, t, *x: model.output(t, x), number, *state)
    require_number(name, output, f"Index the state: x[0] ... x[{model.states - 1}].")
    trace(f"`break_times` of {owner}", "nothing", model, lambda model: as_times(model.break_times))

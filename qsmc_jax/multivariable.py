"""The closed loop of a plant with several inputs: a law, a reference and a disturbance for each channel."""

from typing import Any, ClassVar

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_kind
from qsmc_jax.base.module import AbstractModule, require_fields
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike, Scalars, State
from qsmc_jax.channel import Channel
from qsmc_jax.control.control import AbstractControl
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.disturbances import AbstractDisturbance
from qsmc_jax.model.kinks import as_times
from qsmc_jax.model.reference_model import AbstractReferenceModel
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.model.state_space import AbstractStateSpace


class MultivariableLoop(AbstractModule):
    r"""A plant with m inputs and outputs under m laws, each of which sees its own sliding variable only.

    With the decoupling matrix $B_{ij}$, by which input j drives the sliding variable of channel i, the loop is
    $\dot\sigma = w + B u$. Under the scaled laws, $u_i = -\operatorname{sgn}_i K_i \tan(\pi z_i / 2) / \rho_i$, and if
    $B \operatorname{diag}(\operatorname{sgn}_i K_i)$ has a positive definite symmetric part, with the least eigenvalue
    $\lambda$, every $|z_i|$ stays below 1: $V = \frac{1}{\pi} \sum \ln(1 + \tan^2(\pi z_i / 2))$ falls wherever $v_i =
    \tan(\pi z_i / 2) / \rho_i$ has $|v| > (|w| + |\dot\rho|) / \lambda$. Each run is held against that bound
    (`peak_barrier` and `barrier_bound`). Laws that are not scaled have that proof with K rho in the place of
    K, so if all funnels are as wide; and Theorem 1 each if B is diagonal. Of other laws, limited ones, your own, with
    memories that have rates, nothing of the kind is known: `barrier_bound` is NaN, and runs are judged as they come.

    Attributes:
        plant: The plant, with m relative degrees.
        references: The desired outputs, m of them, each at least as often differentiable as its relative degree.
        disturbances: The disturbances, m of them, which enter where the plant has them.
        controls: The laws, m of them, of any kinds that a `ClosedLoop` may have, each with a surface for its relative
            degree, and a funnel. In the ideal loop what they keep follows the plant's states in `x`, law by law.
        implementation: How the controllers are implemented; None for the ideal loop. Each channel has a computer of its
            own: where it says so, a number of an `Implementation` is one for all of them or one for each.

    Raises:
        InputError: There are not as many of each as inputs; or a surface, or a reference, does not fit its channel; or
            a law that switches, or has a memory without rates, has no implementation.

    Examples:
        Two masses on one spring, each with a force:

        >>> import qsmc_jax as qj
        >>> class Masses(qj.AbstractStateSpace):
        ...     states, relative_degrees = 4, (2, 2)
        ...     def vector_field(self, t, x, d):
        ...         pull = x[2] - x[0]
        ...         return x[1], pull + d[0], x[3], -pull + d[1]
        ...     def input_matrix(self, t, x):
        ...         return (0.0, 0.0), (1.0, 0.2), (0.0, 0.0), (0.2, 1.0)
        ...     def output(self, t, x):
        ...         return x[0], x[2]
        >>> law = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(4.0, 3.0, 0.05), is_scaled=True)
        >>> rest, calm = qj.references.Constant(0.0), qj.disturbances.Zero()
        >>> loop = qj.MultivariableLoop(Masses(), (rest, rest), (calm, calm), (law, law))
        >>> qj.simulate(loop, [0.5, 0.0, -0.2, 0.0], 10.0).verdict.name
        'HELD'
    """

    hint: ClassVar[str] = "Make one: `qj.MultivariableLoop(plant, references, disturbances, controls)`."

    plant: AbstractStateSpace
    references: tuple[AbstractReference, ...]
    disturbances: tuple[AbstractDisturbance, ...]
    controls: tuple[AbstractControl, ...]
    implementation: Implementation | None = None

    def __check_init__(self):
        require_fields(self)
        m, owner = len(self.plant.relative_degrees), type(self.plant).__name__
        require(m > 1, f"Argument `plant` must have several inputs, but `{owner}` has one: make a `qj.ClosedLoop`.")
        kinds = {"references": AbstractReference, "disturbances": AbstractDisturbance, "controls": AbstractControl}
        for name, kind in kinds.items():
            given = getattr(self, name)
            is_tuple = isinstance(given, tuple) and len(given) == m
            found = f"{len(given)} entries" if isinstance(given, tuple) else f"a `{type(given).__name__}`"
            require(is_tuple, f"Argument `{name}` must be a tuple with one for each of the {m} inputs, but is {found}.")
            is_model = any(isinstance(each, AbstractReferenceModel) for each in given)
            require(
                not is_model,
                f"Argument `{name}` must have no reference model, which is for loops with one input: write its output "
                "as a `qj.references.Smooth`, or record it (`qj.references.Recorded`).",
            )
            for i, each in enumerate(given):
                require_kind(f"{name}[{i}]", each, kind, kind.hint)
        _ = self.channels  # each checks its surface, its reference and its law

    @property
    def channels(self) -> tuple[ClosedLoop, ...]:
        """Each channel as a loop with one input; see `Channel` for its state."""
        m = len(self.controls)
        made = [None] * m if self.implementation is None else self.implementation.of_channels(m)
        plants = map(self._plant, range(m))
        return tuple(map(ClosedLoop, plants, self.references, self.disturbances, self.controls, made))

    def _plant(self, channel: int) -> Channel:
        # Held inputs are known without the laws: the others' are left out here, and added by whoever holds them.
        laws, references = (self.controls, self.references) if self.implementation is None else ((), ())
        return Channel(self.plant, laws, references, self.disturbances, channel)

    @property
    def sliding_laws(self) -> tuple[QuasiSlidingControl, ...]:
        """The laws that are the quasi-sliding one."""
        return tuple(law for law in self.controls if isinstance(law, QuasiSlidingControl))

    @property
    def is_quasi_sliding(self) -> bool:
        """Whether all laws are the quasi-sliding one: of others Lyapunov's inequality says nothing."""
        return len(self.sliding_laws) == len(self.controls)

    @property
    def whole(self) -> "MultivariableLoop":
        """The loop itself: what its laws keep is part of its state. See `ClosedLoop`."""
        return self

    @property
    def bodies(self) -> tuple[AbstractStateSpace, ...]:
        """What has states: the plant."""
        return (self.plant,)

    def start(self, x0: Any) -> Scalars:
        """The start of all its states, from that of the plant's.

        Args:
            x0: The start of the plant, N numbers.
        """
        return self._plant(0).start(tuple(x0[i] for i in range(self.plant.states)))

    @property
    def states(self) -> int:
        """The number of states: those of the plant, and of laws in continuous time."""
        first = self._plant(0)
        return first.states - len(first.laws)

    @property
    def order(self) -> int:
        """The number of errors of all channels together."""
        return sum(self.plant.relative_degrees)

    @property
    def sizes(self) -> tuple[int, tuple[int, ...]]:
        """Numbers of states, and of errors of each channel."""
        return self.states, self.plant.relative_degrees

    def widths(self, bandwidth: Any) -> Scalars:
        """The bandwidth of each channel; twice where each funnel ends if none is given.

        Args:
            bandwidth: Bandwidth of quasi-sliding mode, in units of the sliding variables: one for all, or m of them.
        """
        if bandwidth is None:
            return tuple(2.0 * law.funnel.bandwidths[0] for law in self.controls)
        m = len(self.controls)
        if np.ndim(bandwidth) == 0:
            return (bandwidth,) * m
        require(
            np.shape(bandwidth) == (m,),
            f"Argument `bandwidth` must be one number, or one for each of the {m} channels, but has shape "
            f"{np.shape(bandwidth)}.",
        )
        return tuple(bandwidth[i] for i in range(m))

    @property
    def axis(self) -> str:
        """What a state is numbered by."""
        return "state"

    @property
    def breaks_by_part(self) -> list[Array]:
        """Times [s] at which the right-hand side jumps or kinks, for each of the loop's parts."""
        parts = [*self.references, *self.disturbances, *(control.funnel for control in self.controls)]
        made = [each.implementation for each in self.channels if each.implementation is not None]
        return [as_times(part.break_times) for part in (self.plant, *parts, *made)]

    def decoupling(self, t: RealScalarLike, x: State) -> tuple[Scalars, ...]:
        """The rows of the decoupling matrix B: what a unit of each input adds to each sliding variable's rate.

        Args:
            t: Time [s].
            x: State, of which the plant's N scalars matter.
        """
        m, degrees, x = range(len(self.controls)), self.plant.relative_degrees, tuple(x[: self.plant.states])
        return tuple(tuple(self.plant.gains(t, x, i, j)[degrees[i] - 1] for j in m) for i in m)

    def drive(self, t: RealScalarLike, x: State) -> tuple[Scalars, tuple[Scalars, ...]]:
        r"""What drives the sliding variables, $\dot\sigma = w + B u$: w, m scalars, and the rows of B.

        Args:
            t: Time [s].
            x: State, of which the plant's N scalars matter.
        """
        x = tuple(x[: self.plant.states])
        free, pushes = self.plant.vector_field(t, x, tuple(each(t) for each in self.disturbances)), []
        for i, (law, reference) in enumerate(zip(self.controls, self.references, strict=True)):
            _, moving = self.plant.outputs_in_motion(t, x, free, 1.0, i)
            desired = reference.derivatives(t, self.plant.relative_degrees[i])
            pushes.append(law.surface(tuple(a - b for a, b in zip(moving, desired[1:], strict=True))))
        return tuple(pushes), self.decoupling(t, x)

    def acting(self, t: RealScalarLike, rows: tuple[Scalars, ...]) -> Float[Array, "m m"]:
        r"""The symmetric part of $B S$, where the laws are $u = u_0 - S v$ with $v_i = \tan(\pi z_i / 2) / \rho_i$.

        Args:
            t: Time [s].
            rows: The rows of B.
        """
        strengths = [jnp.asarray(law.gain_sign * law.gain_at(t) * law.funnel(t)) for law in self.sliding_laws]
        scaled = jnp.stack([jnp.stack(row) for row in rows]) * jnp.stack(strengths)[None, :]
        return 0.5 * (scaled + scaled.T)


def require_decoupling(loop: MultivariableLoop, x0: Float[np.ndarray, " n"]) -> None:
    """Raises unless the inputs drive the sliding variables as the laws need it where a run starts; traced ones pass.

    Of other laws than the quasi-sliding one nobody knows what they need.

    Args:
        loop: The loop.
        x0: The start, N numbers.

    Raises:
        InputError: The symmetric part of the decoupling matrix, with the laws' signs and gains, is not definite.
    """
    if is_traced(loop, x0) or not loop.is_quasi_sliding:
        return
    matrix, values = _definiteness(loop, x0)
    require(
        bool(values[0] > 0.0 or values[-1] < 0.0),
        f"The decoupling matrix of `{type(loop.plant).__name__}` must have a definite symmetric part at the start, but "
        f"with the laws' signs and gains it has eigenvalues {values[0]:.4g} ... {values[-1]:.4g}: "
        f"{np.asarray(matrix).round(6).tolist()}. Pair each output with the input that drives it most, or change a "
        "`gain_sign`.",
    )


@entry_point
def _definiteness(loop: MultivariableLoop, x0: Float[np.ndarray, " n"]) -> tuple[Any, Array]:
    rows = loop.decoupling(jnp.zeros(()), tuple(x0[i] for i in range(loop.plant.states)))
    return rows, jnp.linalg.eigvalsh(loop.acting(jnp.zeros(()), rows))

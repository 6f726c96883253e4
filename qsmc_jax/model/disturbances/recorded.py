"""A disturbance that was recorded."""

from jaxtyping import Array, Float

from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.model.disturbances.disturbance import AbstractDisturbance
from qsmc_jax.model.kinks import as_times
from qsmc_jax.model.recording import Recording


class Recorded(AbstractDisturbance):
    r"""A recorded disturbance, $d(t)$ as its recording has it; $\bar d$ is its largest absolute value.

    The solver steps to every sample, where it jumps or kinks, so that none is missed: a run takes at least as many
    steps as there are samples in it.

    Attributes:
        recording: The recording. A horizon beyond its end is refused, unless it holds its last sample.

    Examples:
        >>> import qsmc_jax as qj
        >>> gust = qj.disturbances.Recorded(qj.Recording([0.0, 1.0, 2.0], [0.5, -1.0, 0.0], kind="hold"))
        >>> [float(gust(t)) for t in (0.5, 1.0)], float((2.0 * gust).bound)
        ([0.5, -1.0], 2.0)
    """

    recording: Recording

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        return self.recording(t)

    @property
    def bound(self) -> RealScalarLike:
        return self.recording.bound

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return as_times(self.recording.times)

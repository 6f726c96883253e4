"""One run in full: `simulate` and the `Trajectory` it returns."""

from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Real

from qsmc_jax.base.checks import is_traced, require_finite, require_kind, require_positive, require_shape, show
from qsmc_jax.base.module import AbstractModule, as_float64
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.control.funnel import AbstractFunnel
from qsmc_jax.control.funnels.rates import require_own_rates
from qsmc_jax.display.notebook import as_dataset, as_frame, as_html
from qsmc_jax.display.short_repr import short_repr
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.claims import claims_of, verdict_column
from qsmc_jax.metrics.metric import AbstractMeasure
from qsmc_jax.metrics.standard import Metrics
from qsmc_jax.metrics.verdict import Verdict
from qsmc_jax.model.consistency import require_consistent
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.model.recording import require_recorded
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.model.state_jumps import require_no_state_jumps
from qsmc_jax.model.state_space import AbstractStateSpace, require_relative_degree
from qsmc_jax.multivariable import MultivariableLoop, require_decoupling
from qsmc_jax.simulation.contents import brought
from qsmc_jax.simulation.finite import require_finite_functions
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.probed import said_of_probed
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.signals import SolvedRun, grid_of, solve_along
from qsmc_jax.simulation.stiffness import with_method
from qsmc_jax.simulation.trajectory_plots import plot_funnel, plot_phase_plane, plot_trajectory

# Signals that have a column for each of several channels.
_OF_CHANNELS = ("sigma", "rho", "u", "d")


class Trajectory(AbstractModule):
    """All signals of one run on a time grid, its metrics, and how it ended. NumPy float64; NaN after its end.

    Attributes:
        ts: Times [s].
        x: States, one row a time, in the plant's coordinates.
        desired: Desired output and its first n - 1 derivatives, one row a time; with several inputs one channel after
            the other.
        e: Errors e^(0) ... e^(n-1), one row a time, likewise.
        sigma: Sliding variable; with several inputs, as the next three, one column a channel.
        rho: Funnel half-width.
        u: Control input.
        d: Disturbance.
        metrics: Metrics of the run, accumulated inside the solve (not read off the grid).
        loop: The loop that was solved.
        bandwidth: Bandwidth of quasi-sliding mode, in units of the sliding variable.
        error_bounds: What |sigma| < bandwidth implies for each error in the end.
        settling_time: t_s [s], from which on the funnel guarantees that the errors keep these bounds.
        measures: Metrics and requirements of its study, whose values are in `metrics.own`.

    Examples:
        >>> import qsmc_jax as qj
        >>> run = qj.simulate(qj.paper.example1(), [0.9, 0.9], t1=2.0, bandwidth=0.1)
        >>> run.x.shape, round(run.reaching_time, 3), run.outcome.name
        ((2001, 2), 1.461, 'COMPLETED')
    """

    ts: Float[Array | np.ndarray, " times"]
    x: Float[Array | np.ndarray, "times states"]
    desired: Float[Array | np.ndarray, "times n"]
    e: Float[Array | np.ndarray, "times n"]
    sigma: Float[Array | np.ndarray, "times ..."]
    rho: Float[Array | np.ndarray, "times ..."]
    u: Float[Array | np.ndarray, "times ..."]
    d: Float[Array | np.ndarray, "times ..."]
    metrics: Metrics
    loop: ClosedLoop | MultivariableLoop
    bandwidth: Any
    error_bounds: Float[Array | np.ndarray, " n"]
    settling_time: RealScalarLike
    measures: tuple[AbstractMeasure, ...] = eqx.field(static=True, default=())

    @property
    def outcome(self) -> Outcome:
        """How the solve ended."""
        return Outcome(int(self.metrics.outcome))

    @property
    def verdict(self) -> Verdict:
        """Verdict on the funnel claim; those on all are `verdicts`."""
        return Verdict(int(self.metrics.verdict))

    @property
    def verdicts(self) -> dict[str, Verdict]:
        """The verdicts on all claims, by their names: the three of Theorem 1, and the requirements of its study."""
        known = self.metrics.named()
        return {claim: Verdict(int(known[verdict_column(claim)])) for claim in claims_of(known)}

    @property
    def reaching_time(self) -> float:
        """t_r [s], from which on the funnel, or each of several, lies inside the bandwidth."""
        return reaching_time(self.loop, self.bandwidth)

    @property
    def edges(self) -> tuple[Float[np.ndarray, "times ..."], Float[np.ndarray, "times ..."]]:
        """The lower and the upper edge of the funnel at the times, in units of the sliding variable."""
        centres = [np.asarray(_centres(each.control.funnel, self.ts)) for each in self.loop.channels]
        centre = centres[0] if self.rho.ndim == 1 else np.stack(centres, axis=1)
        return np.asarray(centre - self.rho), np.asarray(centre + self.rho)

    def plot(self, ax: Any = None) -> Any:
        """The paper's four pictures, in matplotlib: output, errors, input, sliding variable in its funnel.

        Args:
            ax: Four matplotlib `Axes` to draw in, in reading order; None for a new figure.

        Returns:
            The axes, (4,); `axes[0].figure.savefig(path)` writes them to a file.
        """
        return plot_trajectory(self, ax=ax)

    def plot_phase_plane(self, ax: Any = None) -> Any:
        """The paper's Figure 1, for a plant of order 2: the errors' path between the moving surfaces, in matplotlib.

        Args:
            ax: Matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        return plot_phase_plane(self, ax)

    def plot_funnel(self, ax: Any = None) -> Any:
        """The sliding variable in its funnel, in matplotlib.

        Args:
            ax: Matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        return plot_funnel(self, ax)

    def columns(self) -> dict[str, np.ndarray]:
        """The signals as columns over the column `t`: `x[0]`, `desired[0]`, `e[0]`, ..., `sigma`, `rho`, `u`, `d`.

        With several inputs the last ones are `sigma[0]` and so on, one for each channel.
        """
        signals: dict[str, np.ndarray] = {"t": np.asarray(self.ts)}
        for name in ("x", "desired", "e", *_OF_CHANNELS):
            values = np.asarray(getattr(self, name))
            parts = {name: values} if values.ndim == 1 else {f"{name}[{i}]": row for i, row in enumerate(values.T)}
            signals.update(parts)
        return signals

    def to_pandas(self) -> Any:
        """The signals as a `pandas.DataFrame` over t [s]; needs the extra `notebook`."""
        return as_frame(self.columns(), "t")

    def to_xarray(self) -> Any:
        """The signals as an `xarray.Dataset` over t [s], state, derivative, channel; needs the extra `notebook`."""
        error = "derivative" if len(self.loop.channels) == 1 else "error"
        wide = {name: (("t", error), np.asarray(getattr(self, name))) for name in ("desired", "e")}
        wide["x"] = ("t", self.loop.axis), np.asarray(self.x)
        axes = ("t", "channel")[: self.sigma.ndim]
        flat = {name: (axes, np.asarray(getattr(self, name))) for name in _OF_CHANNELS}
        coordinates = {"t": ("t", np.asarray(self.ts), {"units": "s"}), error: np.arange(self.loop.order)}
        attributes = {"verdict": self.verdict.name, "bandwidth": np.asarray(self.bandwidth).tolist()}
        return as_dataset({**wide, **flat}, coordinates, attributes)

    def _repr_html_(self) -> str:
        return as_html(str(self), self.plot_funnel)

    __repr__ = short_repr

    def __str__(self) -> str:
        f, peak = self.metrics, float(self.metrics.peak_ratio)
        several = len(self.loop.channels) > 1
        shown = {claim: verdict for claim, verdict in self.verdicts.items() if not (several and claim.endswith("]"))}
        claims = ", ".join(f"{claim} {verdict.name}" for claim, verdict in shown.items())
        told = f"  {self.outcome.name}: {self.outcome.advice}"
        if self.outcome in (Outcome.STARTED_OUTSIDE, Outcome.BAD_PARAMETERS):
            return f"Trajectory that was not begun: {claims}\n{told}"
        return "\n".join(
            (
                f"Trajectory to t = {float(f.end_time):.6g} s in {int(f.steps)} steps: {claims}",
                f"  sup |sigma|/rho {peak:.6g} at {float(f.peak_time):.4g} s (margin {float(f.margin):.3g})",
                f"  sup |u| {float(f.peak_u):.6g}, energy {float(f.energy_u):.6g}, "
                f"total variation {float(f.total_variation_u):.6g}",
                f"  |sigma| < {show(np.asarray(self.bandwidth))} for good after {float(f.reach_time):.6g} s "
                f"(t_r = {self.reaching_time:.6g} s)",
                f"  |e^(i)| within their bounds for good after {float(f.settle_time):.6g} s "
                f"(t_s = {float(self.settling_time):.6g} s)",
                *_channel_lines(f, len(self.loop.channels)),
                *_sampled_lines(f),
                *_own_lines(f, self.measures),
                told,
                *([f"  {probed}"] if (probed := said_of_probed(self.loop)) else []),
            )
        )


def _own_lines(metrics: Metrics, measures: Sequence[AbstractMeasure]) -> list[str]:
    """The study's own metrics, a line each."""
    shown = [record for each in measures for record in each.records if not claims_of([record.name])]
    return [f"  {each.name} {float(metrics.own[each.name]):.6g} {each.unit}".rstrip() for each in shown]


def _channel_lines(metrics: Metrics, channels: int) -> list[str]:
    """What is told of each of several channels."""
    if channels == 1:
        return []
    f, lines = metrics.channels, []
    for i in range(channels):
        verdict, ratio, peak = (f[f"{name}[{i}]"] for name in ("verdict_funnel", "peak_ratio", "peak_u"))
        peaks = f"sup |sigma|/rho {float(ratio):.6g}, sup |u| {float(peak):.6g}"
        lines.append(f"  channel {i}: {Verdict(int(verdict)).name}, {peaks}")
    if metrics.peak_barrier is None or metrics.barrier_bound is None:
        return lines
    barrier, bound = float(np.asarray(metrics.peak_barrier)), float(np.asarray(metrics.barrier_bound))
    said = f"no more than {bound:.6g} by its bound"
    if np.isnan(bound) and not np.isnan(barrier):
        said = "of the quasi-sliding law alone is a bound known"
    return [*lines, f"  together: sup V {barrier:.6g}, {said}"]


def _sampled_lines(metrics: Metrics) -> list[str]:
    """Additional metrics of a loop with an implementation."""
    f = metrics.sampled
    if f is None:
        return []
    return [
        f"  sup (|sigma| - rho) {float(f.peak_excess):.4g}, inside for good after {float(f.recovery_time):.4g} s",
        f"  steady: excess variation of u {float(f.excess_variation_u):.4g}, reversals {float(f.reversal_rate):.4g} "
        f"1/s, power above cutoff {100 * float(f.high_frequency_ratio):.3g} %, rate {float(f.peak_rate_u):.4g} 1/s",
    ]


def simulate(
    loop: ClosedLoop | MultivariableLoop,
    x0: Real[Array, " n"] | Real[np.ndarray, " n"] | list[Any] | tuple[Any, ...],
    t1: RealScalarLike,
    *,
    bandwidth: Any = None,
    ts: Real[Array, " times"] | Real[np.ndarray, " times"] | None = None,
    settings: SolverSettings | None = None,
) -> Trajectory:
    """Solves one run of a closed loop from time 0 to `t1`.

    Args:
        loop: The closed loop.
        x0: The start, n numbers.
        t1: The horizon [s], positive.
        bandwidth: Bandwidth epsilon of quasi-sliding mode, rho_inf < epsilon < rho0 (C2), between where the funnel
            ends and starts; None stands for twice where it ends, as in both examples of the paper. With several
            inputs one for all channels, or one for each.
        ts: Times [s] at which to give the signals, increasing, within [0, t1]; None for 2001 evenly spaced.
        settings: Method and tolerances; None for the defaults.

    Returns:
        The trajectory. A loop that leaves its funnel, or a solve that fails, raises nothing: see `outcome`.

    Raises:
        InputError: An argument has the wrong shape or value.

    Examples:
        >>> import qsmc_jax as qj
        >>> control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
        >>> reference, disturbance = qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Sine(0.5, 1.0)
        >>> loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), reference, disturbance, control)
        >>> run = qj.simulate(loop, [0.9, 0.9], 20.0)
        >>> run.verdict.name, round(float(run.metrics.peak_ratio), 4)
        ('HELD', 0.6323)
    """
    if not isinstance(loop, MultivariableLoop):
        require_kind("loop", loop, ClosedLoop, ClosedLoop.hint)
    x0, t1 = as_float64(x0), as_float64(t1)
    check_start(loop, x0, t1)
    check_functions(loop, x0, t1)
    return simulate_drawn(loop, x0, t1, bandwidth, ts, settings, np.True_)


def simulate_drawn(
    loop: ClosedLoop | MultivariableLoop,
    x0: Any,
    t1: RealScalarLike,
    bandwidth: Any,
    ts: Any,
    settings: SolverSettings | None,
    is_drawn_well: BoolScalarLike,
) -> Trajectory:
    """As `simulate`; refused as INADMISSIBLE unless what was drawn for it had arguments in range.

    What the user wrote is not checked again: a run of a study comes out as its row did, whatever its numbers are.
    """
    settings = SolverSettings() if settings is None else settings
    widths = loop.widths(bandwidth)
    bandwidth = as_float64(widths[0] if len(widths) == 1 else widths)
    x0, t1 = as_float64(x0), as_float64(t1)
    check_start(loop, x0, t1)
    check_bandwidth(loop, bandwidth)
    made_of = () if is_traced(loop) else brought(loop)
    settings, ts = with_method(settings, loop, x0, t1, made_of), grid_of(ts, t1)
    solved = _solve_along(loop, x0, t1, bandwidth, ts, settings, np.asarray(is_drawn_well), made_of)
    return trajectory(loop, bandwidth, ts, solved)


def check_bandwidth(loop: ClosedLoop | MultivariableLoop, bandwidth: Any) -> None:
    """Raises `InputError` unless condition C2 holds in every channel; traced numbers pass."""
    require_finite("bandwidth", bandwidth)
    for each, width in zip(loop.channels, loop.widths(bandwidth), strict=True):
        each.control.funnel.check_bandwidth(width)


def reaching_time(loop: ClosedLoop | MultivariableLoop, bandwidth: Any) -> float:
    """t_r [s] of a loop: the latest of its channels'."""
    pairs = zip(loop.channels, loop.widths(bandwidth), strict=True)
    return max(float(each.control.funnel.reaching_time(width)) for each, width in pairs)


def trajectory(
    loop: ClosedLoop | MultivariableLoop,
    bandwidth: Any,
    ts: Float[Array | np.ndarray, " times"],
    solved: SolvedRun,
    measures: tuple[AbstractMeasure, ...] = (),
) -> Trajectory:
    """What a user sees of a solved run: with the loop that was solved."""
    told = solved.metrics, loop, bandwidth, solved.error_bounds, solved.settling_time, measures
    return Trajectory(ts, *solved.signals, *told)


def check_start(loop: ClosedLoop | MultivariableLoop, x0: Any, t1: Any) -> None:
    """Raises `InputError` unless the start and the horizon fit the loop, and its reference's derivatives one another.

    Traced numbers pass.
    """
    states = loop.plant.states
    require_shape("x0", x0, (states,), f"the plant has {_sized(loop)}")
    require_finite("x0", x0)
    require_positive("t1", t1)
    if loop.implementation is not None:
        loop.implementation.check(states, t1)
    require_recorded(loop, t1)
    for each in loop.channels:
        if isinstance(each.reference, AbstractReference):
            require_consistent(each.reference, each.order, t1)
        require_own_rates(each.control.funnel, t1)


def _sized(loop: ClosedLoop | MultivariableLoop) -> str:
    return f"order {loop.order}" if isinstance(loop.plant, AbstractPlant) else f"{loop.plant.states} states"


def check_functions(loop: ClosedLoop | MultivariableLoop, x0: Any, t1: Any) -> None:
    """Raises `InputError` if what the user wrote can't be solved as it stands; traced numbers pass.

    A plant must not jump in the state, and every function must be finite. A scenario alone is not asked: in a run of a
    study such things are an outcome, and it must be possible to look at it.
    """
    for body in loop.bodies:
        require_no_state_jumps(body)
    require_finite_functions(loop, x0, t1)
    if isinstance(loop.plant, AbstractStateSpace):
        require_relative_degree(loop.plant, x0)
    if isinstance(loop, MultivariableLoop):
        require_decoupling(loop, x0)


@entry_point
def _centres(funnel: AbstractFunnel, ts: Float[Array | np.ndarray, " times"]) -> Float[Array, " times"]:
    return jax.vmap(lambda t: jnp.asarray(funnel.centre(t), float))(jnp.asarray(ts))


_solve_along = entry_point(eqx.filter_jit(solve_along))

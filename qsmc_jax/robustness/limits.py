"""What theory says of the names that a map sweeps: thresholds to draw, and natural units for the axes."""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any, Literal, get_args

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require
from qsmc_jax.base.precision import entry_point
from qsmc_jax.control import thresholds
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.implementation.implementation import Implementation
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.simulation.outcome import Outcome
from qsmc_jax.simulation.trajectory import Trajectory, simulate
from qsmc_jax.study.study import Study

ThresholdKind = Literal["local", "sufficient", "necessary"]

_TIMES = 2001


@dataclasses.dataclass(frozen=True)
class Threshold:
    """A value of a name at which theory says that something changes; a line in the picture of a map.

    Attributes:
        name: What it is called in the legend.
        axis_name: The name of the study whose value it is.
        value: The value, in the units of that name.
        kind: "local" (of the linearised loop), "sufficient" (inside it nothing is violated) or "necessary" (beyond it
            something is).

    Raises:
        InputError: The kind is unknown, or the value is not a number.

    Examples:
        >>> import qsmc_jax as qj
        >>> line = qj.Threshold("stable hold", "sample_period", 0.02, kind="local")
        >>> line.value, line.kind
        (0.02, 'local')
    """

    name: str
    axis_name: str
    value: float
    kind: ThresholdKind

    def __post_init__(self):
        kinds = list(get_args(ThresholdKind))
        require(self.kind in kinds, f"Argument `kind` must be one of {kinds}, but is {self.kind!r}.")
        require(not np.isnan(self.value), f"Argument `value` of `{self.name}` must be a number, but is {self.value}.")


@dataclasses.dataclass(frozen=True)
class Limits:
    """What theory says of some names of a study, for its nominal run.

    Attributes:
        thresholds: Lines to draw.
        scales: By name, the factor that makes its values dimensionless and the label of the axis then.
    """

    thresholds: tuple[Threshold, ...] = ()
    scales: Mapping[str, tuple[float, str]] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class OperatingRange:
    """What the nominal run of the ideal loop meets.

    Attributes:
        c: Coefficients of the surface.
        narrowest: Least half-width of the funnel.
        steepest: Gain, gain times input, and half-width where the loop gain k' is largest.
        flattest: The same where it is smallest in the steady phase, t >= t_r.
        residual: Largest |w| from t = 0.
        gains: Least and largest |g| from t = 0.
        demand: What the comparison bound asks of the input, (|w| + |rho'|) / |g| at its largest from t = 0.
        ratio0: |sigma| / rho at the start.
        peak_u: Peak of |u|.
        period: Sample period of the implementation.
    """

    c: np.ndarray
    narrowest: float
    steepest: tuple[float, float, float]
    flattest: tuple[float, float, float]
    residual: float
    gains: tuple[float, float]
    demand: float
    ratio0: float
    peak_u: float
    period: float

    @property
    def loop_gain(self) -> float:
        """The largest k' [1/s]."""
        return thresholds.small_signal_gain(*self.steepest)

    def least(self, limit: Callable[..., float]) -> float:
        """The lower one of a limit where the loop gain is largest and where it is smallest."""
        return min(limit(*self.steepest, self.c), limit(*self.flattest, self.c))


def limits(study: Study, grids: Mapping[str, np.ndarray]) -> Limits:
    """What is known of swept names that set a number of the implementation, in proportion to it.

    The limits are those of the loop linearised along its nominal ideal run, where it is steepest (for a lag, also where
    it is flattest later); a study that disperses the plant switches around them. A period, delay or lag counts on its
    own, the rest of the implementation taken as ideal, but for the delay, from which half a period is taken: a hold is
    late by as much on average.

    Args:
        study: The study.
        grids: The names and their values, increasing.
    """
    axes = {name: _axis(study, name, grid) for name, grid in grids.items()}
    if not any(axes.values()):
        return Limits()
    found = _operating_range(study)
    if found is None:
        return Limits()
    lines, scales = [], {}
    for name, axis in axes.items():
        if axis is not None:
            field, ratio = axis
            drawn = _LIMITS[field](found, study.nominal.loop)
            lines += [Threshold(text, name, value / ratio, kind) for text, value, kind in drawn if 0 < value < math.inf]
            factor, label = _SCALES[field](found, study.nominal.loop)
            scales[name] = (factor * ratio, label)
    return Limits(tuple(lines), scales)


def _axis(study: Study, name: str, grid: np.ndarray) -> tuple[str, float] | None:
    """The number of the implementation that a name sets, and what one unit of the name is of it; None for none."""
    loop = study.nominal.loop
    if not isinstance(loop, ClosedLoop) or loop.implementation is None or len(grid) < 2 or grid[0] <= 0.0:
        return None
    low, high = (_numbers(study.substitute(**{name: value}).nominal.loop) for value in (grid[0], grid[-1]))
    for field in low:
        is_set = low[field] != high[field]
        if is_set and math.isclose(low[field] / grid[0], high[field] / grid[-1], rel_tol=1e-9):
            return field, low[field] / grid[0]
    return None


def _numbers(loop: ClosedLoop) -> dict[str, float]:
    """The numbers of an implementation for which there is a limit."""
    implementation: Any = loop.implementation
    actuator = {name: getattr(implementation.actuator, name, None) for name in ("time_constant", "frequency")}
    noise = None if implementation.noise is None else noise_bound(implementation, loop)
    rest = {
        name: getattr(implementation, name) for name in ("sample_period", "delay", "measurement_delay", "saturation")
    }
    return {name: float(value) for name, value in {**rest, **actuator, "noise": noise}.items() if value is not None}


@entry_point
def noise_bound(implementation: Implementation, loop: ClosedLoop) -> Any:
    """The bound that the bounds on the measured states imply for the noise on the sliding variable; `inf` if none."""
    if implementation.noise is None:
        return jnp.zeros(())
    if loop.states != loop.order:  # what is measured are states that are no errors
        return jnp.full((), jnp.inf)
    weights = jnp.append(jnp.abs(jnp.asarray(loop.control.surface.c)), 1.0)
    return jnp.sum(weights * implementation.noise.bounds())


def _operating_range(study: Study) -> OperatingRange | None:
    """What the nominal run of the ideal loop meets; None if there is no such run, or there are several inputs."""
    nominal, given = study.nominal, study.nominal.loop
    if not isinstance(given, ClosedLoop):
        return None
    law = given.control
    if not isinstance(law, QuasiSlidingControl) or law.is_scaled:
        return None
    loop = dataclasses.replace(given, implementation=None)
    ts = np.linspace(0.0, float(nominal.t1), _TIMES)
    run = simulate(loop, nominal.x0, nominal.t1, bandwidth=study.bandwidth, ts=ts)
    steady = ts >= run.reaching_time
    residual, gain, load = _balances(loop, run)
    if run.outcome != Outcome.COMPLETED or not steady.any() or not np.all(gain > 0.0):
        return None
    # The slope of the law where the run is, which is that at rest if w is what the input holds against.
    tangent = (np.asarray(run.u) - float(law.offset)) / float(law.gain)
    points = np.stack([gain, gain * tangent, np.asarray(run.rho)], axis=1)
    loop_gain = gain * (1.0 + tangent**2) / run.rho
    return OperatingRange(
        c=np.asarray(loop.control.surface.c),
        narrowest=float(loop.control.funnel.narrowest),
        steepest=tuple(points[np.argmax(loop_gain)].tolist()),
        flattest=tuple(points[steady][np.argmin(loop_gain[steady])].tolist()),
        residual=float(np.max(np.abs(residual))),
        gains=(float(np.min(gain)), float(np.max(gain))),
        demand=float(law.gain * np.max(load / gain) + np.abs(law.offset)),
        ratio0=float(np.abs(loop.whole.ratio(0.0, loop.start(nominal.x0)))),
        peak_u=float(run.metrics.peak_u),
        period=_numbers(nominal.loop)["sample_period"],
    )


@entry_point
def _balances(
    loop: ClosedLoop, run: Trajectory
) -> tuple[Float[Array, " times"], Float[Array, " times"], Float[Array, " times"]]:
    """The residual less the centre's rate, |gain| with the sign that the law takes it to have, the funnel's load."""
    loop = loop.whole

    def at(t: Array, row: Float[Array, " n"]) -> tuple[Array, Array, Array]:
        x = tuple(row[i] for i in range(loop.states))
        balance, funnel = loop.plain(t, loop.balance(t, x, loop.errors(t, x), loop.desired(t, x))), loop.control.funnel
        residual, gain = balance.residual - funnel.centre_and_rate(t)[1], loop.control.gain_sign * balance.gain
        return jnp.asarray(residual), jnp.asarray(gain), jnp.asarray(funnel.load(t, balance.residual))

    return jax.vmap(at)(jnp.asarray(run.ts), jnp.asarray(run.x))


_Line = tuple[str, float, ThresholdKind]


def _period_limits(found: OperatingRange, loop: ClosedLoop) -> list[_Line]:
    sufficient = thresholds.sufficient_period(found.residual, found.gains, loop.control.funnel, found.ratio0)
    return [
        ("hold", found.least(thresholds.critical_period), "local"),
        ("hold, bounds met", sufficient.period, "sufficient"),
    ]


def _delay_limits(found: OperatingRange, loop: ClosedLoop) -> list[_Line]:
    return [("delay", found.least(thresholds.critical_delay) - 0.5 * found.period, "local")]


def _lag_limits(found: OperatingRange, loop: ClosedLoop) -> list[_Line]:
    return [("lag", found.least(thresholds.critical_lag), "local")]


def _frequency_limits(found: OperatingRange, loop: ClosedLoop) -> list[_Line]:
    implementation: Any = loop.implementation
    damping = float(implementation.actuator.damping)
    at = (
        thresholds.critical_actuator_frequency(*point, damping, found.c) for point in (found.steepest, found.flattest)
    )
    return [("actuator", max(at), "local")]


def _saturation_limits(found: OperatingRange, loop: ClosedLoop) -> list[_Line]:
    return [("peak of the ideal input", found.peak_u, "local"), ("bound on w met", found.demand, "sufficient")]


def _noise_limits(found: OperatingRange, loop: ClosedLoop) -> list[_Line]:
    return [("noise as wide as the funnel", found.narrowest, "local")]


def _in_loop_times(symbol: str) -> Callable[[OperatingRange, ClosedLoop], tuple[float, str]]:
    return lambda found, loop: (found.loop_gain, f"${symbol} k'$ [-], $k' = \\pi g (1 + u_{{eq}}^2) / 2\\rho$")


def _lag_scale(found: OperatingRange, loop: ClosedLoop) -> tuple[float, str]:
    return (float(found.c[-1]), "$T_a c_{n-1}$ [-]") if found.c.size else (found.loop_gain, "$T_a k'$ [-]")


_LIMITS = {
    "sample_period": _period_limits,
    "delay": _delay_limits,
    "measurement_delay": _delay_limits,
    "time_constant": _lag_limits,
    "frequency": _frequency_limits,
    "saturation": _saturation_limits,
    "noise": _noise_limits,
}
_SCALES = {
    "sample_period": _in_loop_times(r"\tau"),
    "delay": _in_loop_times("h"),
    "measurement_delay": _in_loop_times("h"),
    "time_constant": _lag_scale,
    "frequency": lambda found, loop: (1.0 / found.loop_gain, "$\\omega / k'$ [-]"),
    "saturation": lambda found, loop: (1.0 / found.demand, r"$u_{max} / \sup\,(|w| + |\dot\rho|) / g$ [-]"),
    "noise": lambda found, loop: (1.0 / found.narrowest, r"$\nu / \rho_\infty$ [-], $\nu$ the bound on $\sigma$"),
}

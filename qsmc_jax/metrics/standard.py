"""The metrics of every run: each is declared here, with its unit and meaning, and nowhere else."""

import dataclasses
import functools as ft
import itertools as it
from collections.abc import Collection, Sequence
from typing import Any, TypeVar

import equinox as eqx
from jaxtyping import Array, Float, Int

from qsmc_jax.base.checks import nearest, require
from qsmc_jax.base.module import AbstractModule
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.record import Loops, Record, explained, metric, records_of, without_index
from qsmc_jax.multivariable import MultivariableLoop

_M = TypeVar("_M", bound=AbstractModule)


@explained
class SampledMetrics(AbstractModule):
    """Additional metrics of a loop with an implementation; the steady phase is from t_r to the horizon.

    At default settings the metrics of such a loop, these and those of `Metrics`, are good to 1e-4 relative to their
    size (`peak_excess`: to the funnel's; `excess_variation_u`: to that of `total_variation_u`), and with `tight()` to a
    tenth of that; `high_frequency_ratio` to 1e-3 of all power, `reversal_rate` to one reversal, and `settle_time` is
    late by up to a period.
    """

    recovery_time: Float[Array, ""] = metric(
        meaning="Time after which |sigma| < rho for good; 0 if it never was outside, inf if it ends there",
        unit="s",
        label="back in the funnel for good",
        loops="sampled",
        worse="high",
        has_gradient=True,
        may_jump=True,
    )
    peak_excess: Float[Array, ""] = metric(
        meaning="sup (|sigma| - rho), in units of the sliding variable; negative inside the funnel",
        label=r"$\sup (|\sigma| - \rho)$",
        loops="sampled",
        worse="high",
        has_gradient=True,
    )
    excess_variation_u: Float[Array, ""] = metric(
        meaning="In the steady phase, total variation of u less that of the equivalent input -w/g (of several -B^-1 w)",
        label="excess variation of u",
        phase="steady",
        loops="sampled",
        worse="high",
        has_gradient=True,
        is_compared=True,
    )
    reversal_rate: Float[Array, ""] = metric(
        meaning="Reversals of the command per time in the steady phase, with 1 % of its range as hysteresis",
        unit="1/s",
        label="reversals of u",
        phase="steady",
        loops="sampled",
        worse="high",
        is_compared=True,
        may_jump=True,
    )
    high_frequency_ratio: Float[Array, ""] = metric(
        meaning="Power of u above the cutoff frequency over all of it in the steady phase, which may pass 1 where u "
        "dies out",
        unit="-",
        label="high-frequency part of u",
        phase="steady",
        loops="sampled",
        worse="high",
        has_gradient=True,
        is_compared=True,
    )
    peak_rate_u: Float[Array, ""] = metric(
        meaning="In the steady phase, largest change of the command from sample to sample over the period",
        label="largest rate of u",
        phase="steady",
        loops="sampled",
        worse="high",
        has_gradient=True,
        is_compared=True,
    )


@explained
class Metrics(AbstractModule):
    """The metrics of one run, each a scalar (`peak_errors`: n scalars). What is not known is NaN, never a guess.

    At default settings, relative to their size, `total_variation_u`, `peak_errors` and `peak_u_bound` of an ideal loop
    are good to 1e-4, `margin`, `peak_ratio`, `energy_u`, `peak_u` and `rms_error` to 1e-5, `max_u` and `min_u` to 1e-5
    of `peak_u`. At `reach_time` |sigma| is the bandwidth to 1e-4, and at `peak_time` |sigma|/rho its peak to 1e-5;
    `violation_time` is good to 1e-5 of the horizon. With `tight()` all are good to a tenth of that. `settle_time` is
    late by up to a step; before t_r, where nothing is claimed of errors, they are looked at where steps meet only.
    `least_gain` and `largest_disturbance` are what was met there; the others are exact.

    Attributes:
        sampled: Additional metrics of a loop with an implementation; None for the ideal loop.
        channels: With several inputs the verdicts and some metrics of each channel, by their columns, such as
            `peak_ratio[0]`; the others are of all together: the worst, for `energy_u`, `total_variation_u` and
            `excess_variation_u` the sum, for `rms_error` the root of the sum of squares, and `peak_errors` are the
            channels' one after the other.
        own: The metrics and requirements of the study, by their columns.

    Examples:
        >>> import qsmc_jax as qj
        >>> metrics = qj.simulate(qj.paper.example1(), [0.9, 0.9], t1=2.0, bandwidth=0.1).metrics
        >>> round(float(metrics.peak_ratio), 3), round(float(metrics.columns()["rms_error"]), 3)
        (0.632, 0.46)
    """

    verdict: Int[Array, ""] = metric(meaning="Verdict on the funnel claim, |sigma(t)| < rho(t) for all t")
    verdict_reaching: Int[Array, ""] = metric(meaning="Verdict on |sigma(t)| < bandwidth for all t >= t_r")
    verdict_tracking: Int[Array, ""] = metric(
        meaning="Verdict on |e^(i)(t)| <= bandwidth ||G_i||_1 for all t >= t_s and all i, with the settling time t_s >="
        " t_r that the funnel guarantees: the first time from which the sharp envelope |C_i e^{At} E(0)| + int_0^t"
        " |h_i(t-s)| rho(s) ds (+ rho(t) for i = n - 1) stays inside that bound"
    )
    outcome: Int[Array, ""] = metric(meaning="How the solve ended, an `Outcome`")
    end_time: Float[Array, ""] = metric(
        meaning="Time up to which the run was solved", unit="s", label="end", may_jump=True
    )
    peak_ratio: Float[Array, ""] = metric(
        meaning="sup |sigma|/rho; 1 if an ideal loop left the funnel, where it ends",
        unit="-",
        label=r"$\sup |\sigma|/\rho$",
        worse="high",
        has_gradient=True,
        is_compared=True,
    )
    margin: Float[Array, ""] = metric(
        meaning="1 - peak_ratio, without cancellation",
        unit="-",
        label=r"$1 - \sup|\sigma|/\rho$",
        worse="low",
        has_gradient=True,
    )
    peak_time: Float[Array, ""] = metric(
        meaning="When the peak occurs", unit="s", label=r"time of $\sup |\sigma|/\rho$", may_jump=True
    )
    peak_u: Float[Array, ""] = metric(
        meaning="sup |u|, units of the input", label=r"$\sup |u|$", worse="high", has_gradient=True, is_compared=True
    )
    max_u: Float[Array, ""] = metric(
        meaning="sup u, with its sign, units of the input", label=r"$\sup u$", worse="high", has_gradient=True
    )
    min_u: Float[Array, ""] = metric(
        meaning="inf u, with its sign: negative where a one-sided actuator would be asked for what it can't give",
        label=r"$\inf u$",
        worse="low",
        has_gradient=True,
    )
    peak_u_bound: Float[Array, ""] = metric(
        meaning="What the comparison lemma allows for `peak_u`; a higher peak is a defect of the simulator",
        label=r"bound on $\sup |u|$",
    )
    reach_time: Float[Array, ""] = metric(
        meaning="Time after which |sigma| < bandwidth for good; inf if never",
        unit="s",
        label="reach time",
        worse="high",
        has_gradient=True,
        may_jump=True,
    )
    violation_time: Float[Array, ""] = metric(
        meaning="When the run first left the funnel; inf if it did not",
        unit="s",
        label="first outside",
        worse="low",
        may_jump=True,
    )
    settle_time: Float[Array, ""] = metric(
        meaning="Time after which the errors are within their bounds for good, to the step; inf if never",
        unit="s",
        label="settling time",
        worse="high",
        may_jump=True,
    )
    peak_errors: tuple[Float[Array, ""], ...] = metric(
        name="peak_error",
        meaning="sup |e^(i)| over t >= t_r, i = 0..n-1",
        label=r"$\sup |e^{(i)}|$",
        phase="steady",
        worse="high",
        has_gradient=True,
    )
    rms_error: Float[Array, ""] = metric(
        meaning="Root mean square of e over the horizon",
        label="RMS error",
        worse="high",
        has_gradient=True,
        is_compared=True,
    )
    energy_u: Float[Array, ""] = metric(
        meaning="Integral of u^2", label=r"$\int u^2$", worse="high", has_gradient=True, is_compared=True
    )
    total_variation_u: Float[Array, ""] = metric(
        meaning="Integral of |du/dt|; in an ideal loop, reversals within 30 tolerances do not count",
        label="total variation of u",
        worse="high",
        has_gradient=True,
        is_compared=True,
    )
    least_gain: Float[Array, ""] = metric(
        meaning="Least gain_sign * g met at the end of a step; not positive if the premise on the gain is broken",
        label=r"least $\pm g$",
        worse="low",
    )
    largest_disturbance: Float[Array, ""] = metric(
        meaning="Largest |d| met at the end of a step", label=r"largest $|d|$", worse="high"
    )
    steps: Int[Array, ""] = metric(meaning="Steps taken, kept or not", label="steps")
    coordinate_drift: Float[Array, ""] | None = metric(
        meaning="Of a plant in its own coordinates, the largest difference at the end of a step between sigma/rho as "
        "the state and as the funnel coordinate have it; UNDECIDED if it is more than 1e-3, or than the margin then",
        unit="-",
        label="drift of the coordinates",
        loops="own",
        worse="high",
        default=None,
    )
    peak_barrier: Float[Array, ""] | None = metric(
        meaning="With several inputs of an ideal loop sup (1/pi) sum ln(1 + tan^2(pi z_i/2)) over the channels, "
        "z = sigma/rho",
        unit="-",
        label="sup V",
        loops="several",
        worse="high",
        has_gradient=True,
        default=None,
    )
    barrier_bound: Float[Array, ""] | None = metric(
        meaning="With several inputs of an ideal loop what Lyapunov's inequality allows for `peak_barrier`, by what "
        "drives the run when it peaks; a higher peak is a defect of the simulator; inf if the decoupling matrix is "
        "not definite there; none is known, and it is NaN, where a law is another than the quasi-sliding one",
        unit="-",
        label="bound on sup V",
        loops="several",
        default=None,
    )
    sampled: SampledMetrics | None = None
    channels: dict[str, Array] = eqx.field(default_factory=dict)
    own: dict[str, Array] = eqx.field(default_factory=dict)

    def named(self) -> dict[str, Any]:
        """Every metric by its name, those of `sampled` and of the study among them."""
        named = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        sampled, channels, own = (named.pop(name) for name in ("sampled", "channels", "own"))
        named |= {} if sampled is None else vars(sampled)
        return {**{name: value for name, value in named.items() if value is not None}, **channels, **own}

    def columns(self) -> dict[str, Any]:
        """Every metric by the name of its column: `peak_error[i]` is that of the i-th derivative of the error."""
        named = self.named()
        peaks = named.pop("peak_errors", ())
        return {**named, **{f"peak_error[{i}]": peak for i, peak in enumerate(peaks)}}

    def only(self, names: Collection[str]) -> "Metrics":
        """The same with None for every metric that is neither named nor the study's own.

        Args:
            names: Names of records.
        """
        sampled = None if self.sampled is None else _only(self.sampled, names)
        wanted = {*names, *(column for name, column in BY_CHANNEL.items() if name in names)}
        channels = {column: value for column, value in self.channels.items() if without_index(column) in wanted}
        made = eqx.tree_at(lambda each: each.sampled, _only(self, names), sampled, is_leaf=lambda leaf: leaf is None)
        return eqx.tree_at(lambda each: each.channels, made, channels) if self.channels else made


def _only(module: _M, names: Collection[str]) -> _M:
    """The module with None for its metrics that are not named."""
    unasked = [field for field, record in records_of(type(module)).items() if record.name not in names]
    if not unasked:
        return module
    return eqx.tree_at(lambda each: [getattr(each, field) for field in unasked], module, replace_fn=lambda _: None)


# What is told of each of several channels, with the name of the column: the claim on the funnel has a name there.
BY_CHANNEL = {
    "verdict": "verdict_funnel",
    **{name: name for name in ("verdict_reaching", "verdict_tracking", "peak_ratio", "margin", "peak_u", "max_u")},
    **{name: name for name in ("min_u", "reach_time", "violation_time", "settle_time", "rms_error", "least_gain")},
}


def columns_of_channels(channels: int) -> tuple[str, ...]:
    """The metrics that there are for each of several channels, such as `peak_u[0]`; none if there is but one.

    Args:
        channels: How many there are.
    """
    names = [column for name, column in BY_CHANNEL.items() if not name.startswith("verdict")]
    return tuple(f"{name}[{i}]" for name in names for i in range(channels)) if channels > 1 else ()


def kinds_of(loop: ClosedLoop | MultivariableLoop) -> frozenset[Loops]:
    """Of which kinds a loop is, as records tell which loops have their metric.

    Args:
        loop: The loop.
    """
    is_sampled = loop.implementation is not None
    is_such: dict[Loops, bool] = {
        "all": True,
        "sampled": is_sampled,
        "several": not is_sampled and len(loop.channels) > 1,
        "own": not is_sampled and loop.axis == "state",
    }
    return frozenset(kind for kind, is_so in is_such.items() if is_so)


# What a study asks for if it says nothing.
USUAL = ("standard",)
# The group "claims": what verdicts need, and what is said of them.
_CLAIMS = (
    *("verdict", "verdict_reaching", "verdict_tracking", "outcome", "end_time", "peak_ratio", "margin", "peak_u"),
    *("reach_time", "violation_time", "settle_time", "least_gain", "largest_disturbance", "steps"),
    *("coordinate_drift", "peak_barrier", "barrier_bound"),
)
# Names by which metrics are told where they are no columns.
FIELDS = tuple(field.name for field in dataclasses.fields(Metrics))


@ft.lru_cache
def catalogue() -> dict[str, Record]:
    """The records of all metrics of a run, by their names.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.metrics.catalogue()["reach_time"].unit
        's'
    """
    records = (*records_of(Metrics).values(), *records_of(SampledMetrics).values())
    return {record.name: record for record in records}


def asked_for(given: Sequence[str]) -> tuple[str, ...]:
    """The names of the standard metrics that a study asks for, those of "claims" always among them.

    Args:
        given: Names of metrics and of groups of them.

    Raises:
        InputError: There is no such metric.
    """
    names = tuple(catalogue())
    groups = {"standard": names, "claims": _CLAIMS}
    for name in given:
        listed = f"{nearest(name, (*groups, *names))} There are: {', '.join((*groups, *names))}."
        require(name in names or name in groups, f"Argument `metrics` names `{name}`, which is no metric.{listed}")
    wanted = {*_CLAIMS, *it.chain.from_iterable(groups.get(name, (name,)) for name in given)}
    return tuple(name for name in names if name in wanted)


def record_of(column: str) -> Record:
    """The record of a column; of one that is no metric, a record of nothing but its name.

    Args:
        column: A column of a table of runs, such as `peak_error[0]`.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.metrics.record_of("peak_error[1]").meaning
        'sup |e^(i)| over t >= t_r, i = 0..n-1'
    """
    return catalogue().get(without_index(column), Record(column))

"""The metrics of several channels together: the worst of each, and all by channel."""

import dataclasses
import functools as ft
from collections.abc import Callable, Sequence

import jax.numpy as jnp
from jaxtyping import Array, Int

from qsmc_jax.metrics.claims import GRAVEST
from qsmc_jax.metrics.standard import BY_CHANNEL, Metrics, SampledMetrics
from qsmc_jax.metrics.verdict import Verdict


def joined(channels: Sequence[Metrics], barrier: tuple[Array, Array] | None, own: dict[str, Array]) -> Metrics:
    """The metrics of a run of several channels.

    Args:
        channels: The metrics of each.
        barrier: The peak of V, and its bound; None of a sampled loop, which has none.
        own: Metrics and requirements of the study.
    """
    first = channels[0]

    def of(name: str, join: Callable[[Array, Array], Array]) -> Array:
        return ft.reduce(join, [getattr(each, name) for each in channels])

    # Where a run left its funnels only those channels know their extremes that did; the others' are NaN.
    most, least = (ft.partial(of, join=join) for join in (jnp.fmax, jnp.fmin))
    highest = jnp.argmax(jnp.stack([jnp.nan_to_num(each.peak_ratio, nan=-1.0) for each in channels]))
    drifts = [each.coordinate_drift for each in channels if each.coordinate_drift is not None]
    by_channel = {
        f"{column}[{i}]": getattr(each, name) for name, column in BY_CHANNEL.items() for i, each in enumerate(channels)
    }
    return Metrics(
        verdict=_gravest([each.verdict for each in channels]),
        verdict_reaching=_gravest([each.verdict_reaching for each in channels]),
        verdict_tracking=_gravest([each.verdict_tracking for each in channels]),
        outcome=first.outcome,
        end_time=first.end_time,
        peak_ratio=most("peak_ratio"),
        margin=least("margin"),
        peak_time=jnp.stack([each.peak_time for each in channels])[highest],
        peak_u=most("peak_u"),
        max_u=most("max_u"),
        min_u=least("min_u"),
        peak_u_bound=of("peak_u_bound", jnp.maximum),
        reach_time=most("reach_time"),
        violation_time=least("violation_time"),
        settle_time=most("settle_time"),
        peak_errors=tuple(peak for each in channels for peak in each.peak_errors),
        rms_error=jnp.sqrt(sum(each.rms_error**2 for each in channels)),
        energy_u=of("energy_u", jnp.add),
        total_variation_u=of("total_variation_u", jnp.add),
        least_gain=least("least_gain"),
        largest_disturbance=most("largest_disturbance"),
        steps=first.steps,
        coordinate_drift=ft.reduce(jnp.maximum, drifts) if drifts else None,
        peak_barrier=None if barrier is None else barrier[0],
        barrier_bound=None if barrier is None else barrier[1],
        sampled=_sampled([each.sampled for each in channels if each.sampled is not None]),
        channels=by_channel,
        own=own,
    )


def _sampled(channels: Sequence[SampledMetrics]) -> SampledMetrics | None:
    """Those of a sampled loop: the worst of each, but excess variation is summed, as total variation is."""
    if not channels:
        return None
    names = [field.name for field in dataclasses.fields(SampledMetrics)]
    join = {name: jnp.add if name == "excess_variation_u" else jnp.fmax for name in names}
    return SampledMetrics(**{name: ft.reduce(join[name], [getattr(each, name) for each in channels]) for name in names})


def _gravest(verdicts: Sequence[Int[Array, ""]]) -> Int[Array, ""]:
    """The verdict on a claim about all channels."""
    found = jnp.stack(verdicts)
    code = jnp.zeros_like(found[0]) + int(Verdict.HELD)
    for verdict in reversed(GRAVEST):
        code = jnp.where(jnp.any(found == int(verdict)), int(verdict), code)
    return code

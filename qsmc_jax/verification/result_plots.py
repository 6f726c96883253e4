"""Pictures of a verification: the funnel with what the runs do in it, and how much room they leave."""

from typing import Any

import numpy as np

from qsmc_jax.display.plotting import BLUE, GREY, ORANGE, RED, SERIES, SKY, one_axes, panels
from qsmc_jax.simulation.channel_plots import draw_unit_funnel, ratios
from qsmc_jax.simulation.trajectory import reaching_time
from qsmc_jax.simulation.trajectory_plots import draw_edges, is_centred
from qsmc_jax.study.signals import signals
from qsmc_jax.verification.summary import Histogram

_BAND_RUNS = 64
_BAND_TIMES = 1001
_BANDS = ((0.0, 1.0), (0.05, 0.95), (0.25, 0.75))


def plot_verification(result: Any, ax: Any = None) -> Any:
    """The funnel with bands of the runs and the worst run, the histogram of the margin, and that of the reach time.

    Solves 64 runs and the worst one again to draw them, as one batch.

    Args:
        result: What `verify` returned.
        ax: Three matplotlib `Axes` to draw in, in reading order; None for a new figure, which also gets a heading.

    Returns:
        The axes, (3,): funnel, margin, reach time.
    """
    axes = panels(ax, 3, 3, (15.0, 4.8))
    _funnel(axes[0], result)
    _margin(axes[1], result.margin, result)
    _reach(axes[2], result.reach, result)
    if ax is None:
        axes[0].figure.suptitle(f"{result.verdict.name}: {result.runs} runs, seed {result.seed}")
    return axes


def plot_margin(result: Any, ax: Any = None) -> Any:
    """The histogram of the margin.

    Args:
        result: What `verify` returned.
        ax: Matplotlib `Axes` to draw in; None for a new figure.

    Returns:
        The axes.
    """
    ax = one_axes(ax, (6.0, 3.2))
    _margin(ax, result.margin, result)
    return ax


def _bands(ax: Any, ts: np.ndarray, values: np.ndarray, what: str = "") -> None:
    """Where most runs are at each time, given a row of values for each."""
    alive = np.isfinite(values).any(axis=0)
    for (low, high), alpha in zip(_BANDS, (0.2, 0.35, 0.5), strict=True):
        quantiles = np.nanquantile(values[:, alive], (low, high), axis=0)
        label = f"{what}all of {len(values)} runs" if high == 1.0 else f"{100 * low:g} to {100 * high:g} %"
        ax.fill_between(ts[alive], *quantiles, color=SKY, alpha=alpha, lw=0.0, label=label)


def _ratios(ax: Any, result: Any) -> None:
    """The channels' largest |sigma|/rho: bands of the runs, and each channel of the worst one."""
    study = result.study
    ts = np.linspace(0.0, float(study.nominal.t1), _BAND_TIMES)
    count, row = min(_BAND_RUNS, result.runs), result.worst.row(0)
    drawn = signals(study, range(count), result.seed, ts=ts, settings=result.settings)
    run = study.replay(row["index"], result.seed, settings=result.settings_of(row))
    centre = run.edges[1] - run.rho  # the nominal one, at the worst run's times
    centres = np.stack([np.interp(ts, run.ts, each) for each in centre.T], axis=1)
    largest = np.abs((drawn.sigma - centres) / drawn.rho).max(axis=2)
    _bands(ax, ts, largest, "largest, ")
    for i, z in enumerate(ratios(run).T):
        label = f"channel {i} of the worst, run {row['index']}"
        ax.plot(run.ts, z, color=SERIES[i % len(SERIES)], lw=1.0, label=label)
    draw_unit_funnel(ax, _reaching_time(result), "nominal $t_r$")


def _funnel(ax: Any, result: Any) -> None:
    if len(result.study.nominal.loop.channels) > 1:
        _ratios(ax, result)
        return
    study, eps = result.study, float(result.study.bandwidth)
    ts = np.linspace(0.0, float(study.nominal.t1), _BAND_TIMES)
    count, row = min(_BAND_RUNS, result.runs), result.worst.row(0)
    drawn = signals(study, [*range(count), row["index"]], result.seed, ts=ts, settings=result.settings)
    funnel = study.nominal.loop.control.funnel
    worst, sigma = (ts, drawn.sigma[-1], (-drawn.rho[-1], drawn.rho[-1])), drawn.sigma[:-1]
    # Of a program of its own only where it must be: decided by another solve, longer than the nominal run, or in a
    # funnel whose centre moves.
    if row["tier"] > 0 or row["end_time"] > ts[-1] or not is_centred(funnel):
        run = study.replay(row["index"], result.seed, settings=result.settings_of(row))
        worst = run.ts, run.sigma, run.edges
    _bands(ax, ts, sigma)
    draw_edges(ax, worst[0], worst[2], funnel, eps)
    ax.plot(*worst[:2], color=BLUE, lw=1.0, label=f"worst, run {row['index']}")
    t_r = _reaching_time(result)
    ax.axvline(t_r, ls=":", color=ORANGE, label=f"nominal $t_r$ = {t_r:.4g} s")
    ax.set_yscale("symlog", linthresh=2.0 * eps)
    ax.set(title="Sliding variable in its funnel", xlabel="t [s]", ylabel=r"$\sigma$ (linear below 2 $\varepsilon$)")
    ax.legend(loc="upper right", fontsize=7)


def _margin(ax: Any, histogram: Histogram, result: Any) -> None:
    _bars(ax, histogram)
    least = float(np.nan_to_num(result.worst["margin"][0]))
    ax.axvline(least, color=RED, ls="--", label=f"worst: {least:.3g}")
    ax.set(title="Margin to the funnel", xlabel=r"$1 - \sup |\sigma|/\rho$ [-]", ylabel="runs", xlim=(0.0, 1.0))
    ax.legend(loc="best", fontsize=8)


def _reach(ax: Any, histogram: Histogram, result: Any) -> None:
    _bars(ax, histogram)
    t_r = _reaching_time(result)
    ax.axvline(t_r, color=ORANGE, ls=":", lw=2.0, label=f"nominal $t_r$ = {t_r:.4g} s")
    ax.set(title="Reach time", xlabel=r"time after which $|\sigma| < \varepsilon$ for good [s]", ylabel="runs")
    ax.legend(loc="best", fontsize=8)


def _reaching_time(result: Any) -> float:
    return reaching_time(result.study.nominal.loop, result.study.bandwidth)


def _bars(ax: Any, histogram: Histogram) -> None:
    ax.stairs(histogram.counts, histogram.edges, fill=True, color=BLUE, alpha=0.6)
    ax.stairs(histogram.counts, histogram.edges, color=GREY, lw=0.5)

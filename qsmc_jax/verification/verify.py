"""Verification by Monte Carlo: the three claims of Theorem 1, each with an exact interval."""

import functools as ft
import math
import time
from collections.abc import Callable, Iterator

import numpy as np

from qsmc_jax.base.checks import require
from qsmc_jax.simulation.outcome import Verdict
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.lanes import Lanes
from qsmc_jax.study.monte_carlo import BLOCK, Progress, stream
from qsmc_jax.study.runs import CLAIMS, Runs, concatenate
from qsmc_jax.study.sampling import AbstractSampling, Random
from qsmc_jax.study.schedule import Workload
from qsmc_jax.study.study import Study
from qsmc_jax.verification.decided import through
from qsmc_jax.verification.ladder import Ladder, firmer, is_doubtful
from qsmc_jax.verification.result import Claim, NumericalError, Verification
from qsmc_jax.verification.statistics import clopper_pearson
from qsmc_jax.verification.summary import Summary

_STATEMENTS = {
    "funnel": "|sigma(t)| < rho(t) for all t",
    "reaching": "|sigma(t)| < bandwidth for all t >= t_r",
    "tracking": "the errors end inside the bound that |sigma| < bandwidth implies",
}

Sink = Callable[[Runs], None]


def verify(
    study: Study,
    runs: int,
    seed: int = 0,
    confidence: float = 0.95,
    *,
    worst: int = 5,
    sampling: AbstractSampling | None = None,
    settings: SolverSettings | None = None,
    block: int = BLOCK,
    threads: int | None = None,
    progress: Progress | None = None,
    sink: Sink | None = None,
) -> Verification:
    """Finds out by independent runs whether the funnel guarantee holds, and how sure that is.

    Doubtful runs are solved again on firmer rungs and never dropped; what stays undecided widens the intervals both
    ways. A random sample and the worst runs are solved again at a hundredth of the tolerance. Memory does not grow with
    the number of runs.

    Args:
        study: The study.
        runs: Number of runs, at least 1; `runs_needed` plans it.
        seed: Seed, 0 <= seed < 2**63. Use a fresh one for a certificate of tuned gains.
        confidence: Confidence of each interval, strictly between 0 and 1.
        worst: How many of the worst runs to report, at least 1.
        sampling: `Random()` (None). Designs whose points are not independent are refused.
        settings: Method and tolerances of the first solve; None for the defaults.
        block: Runs solved together, a multiple of 64.
        threads: Blocks solved at the same time; None for one a core.
        progress: Called as `progress(done, runs)` after each block.
        sink: Called with each table of final rows, in no particular order.

    Returns:
        The verification; `print` it.

    Raises:
        ValueError: An argument is out of range, or the sampling admits no exact interval.
    """
    require(runs >= 1, f"Argument `runs` must be at least 1, but is {runs}.")
    require(0.0 < confidence < 1.0, f"Argument `confidence` must lie strictly between 0 and 1, but is {confidence}.")
    require(worst >= 1, f"Argument `worst` must be at least 1, but is {worst}.")
    settings, sampling = settings or SolverSettings(), sampling or Random()
    require(sampling.is_independent, f"Argument `sampling` must be independent for `verify`: {sampling.why_not}")
    solve = ft.partial(stream, study, seed=seed, sampling=sampling, block=block, threads=threads)
    Lanes(study, settings, block).compile_nominal()
    workload = Workload()
    begin = time.perf_counter()
    summary = Summary(worst, longest_reach=_longest_reach(study))
    ladder = Ladder(solve, settings, block)
    sample: list[Runs] = []
    for table in through(ladder, solve(range(runs), settings=settings, progress=progress, workload=workload)):
        sample = sample or [table.take(~is_doubtful(table)).take(slice(max(block - worst, 1)))]
        summary.add(table)
        if sink is not None:
            sink(table)
    checked = concatenate([*sample, *summary.worst])
    numerical_error = _numerical_error(checked, solve, settings)
    return Verification(
        study=study,
        runs=runs,
        seed=seed,
        confidence=confidence,
        settings=settings,
        claims=tuple(
            _claim(summary, name, column, confidence) for name, column in zip(_STATEMENTS, CLAIMS, strict=True)
        ),
        worst=concatenate(summary.worst),
        numerical_error=numerical_error,
        climbed=tuple(ladder.climbed),
        defects=tuple(ladder.defects),
        margin=summary.margin,
        reach=summary.reach,
        peak_u=summary.peak_u,
        steps=summary.steps,
        occupancy=workload.occupancy,
        solve_seconds=time.perf_counter() - begin,
    )


def _longest_reach(study: Study) -> float:
    """Where the histogram of reach times ends: twice the nominal reaching time."""
    return 2.0 * float(study.nominal.loop.control.funnel.reaching_time(study.bandwidth)) or 1.0


def _claim(summary: Summary, name: str, column: str, confidence: float) -> Claim:
    counts = summary.counts[column]
    held, violated, undecided = counts[Verdict.HELD], counts[Verdict.VIOLATED], counts[Verdict.UNDECIDED]
    low, high = clopper_pearson(violated, undecided, held + violated + undecided, confidence)
    return Claim(name, _STATEMENTS[name], held, violated, undecided, counts[Verdict.INADMISSIBLE], low, high)


def _numerical_error(checked: Runs, solve: Callable[..., Iterator[Runs]], settings: SolverSettings) -> NumericalError:
    """Solves the decided rows again at a hundredth of the tolerance, and compares."""
    decided = (checked["verdict"] == Verdict.HELD) | (checked["verdict"] == Verdict.VIOLATED)
    before = checked.take(decided)
    if not len(before):
        return NumericalError(0, math.nan, 0)
    after = concatenate(list(solve(before["index"], settings=firmer(settings))))
    change = np.abs(after["peak_ratio"] - before["peak_ratio"])
    changed = np.any([after[claim] != before[claim] for claim in CLAIMS], axis=0)
    return NumericalError(len(before), float(np.nanmax(change, initial=0.0)), int(changed.sum()))

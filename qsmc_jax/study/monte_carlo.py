"""Many runs of a study: fixed-size blocks over threads, rows out in order of their index."""

import os
from collections import deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from qsmc_jax.base.checks import require
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.lanes import Lanes
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.sampling import AbstractSampling, Random
from qsmc_jax.study.study import Study

# Small enough that a sample for the numerical error and a few doubtful runs cost little, large enough to vectorise.
BLOCK = 256

Progress = Callable[[int, int], None]


def monte_carlo(
    study: Study,
    runs: int,
    seed: int = 0,
    *,
    sampling: AbstractSampling | None = None,
    settings: SolverSettings | None = None,
    block: int = BLOCK,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Runs:
    """Solves many runs of a study.

    Run i is a pure function of the study, the seed, the sampling and i: the same, to the last bit on one machine,
    whatever the number of runs, the block size or the threads.

    Args:
        study: The study.
        runs: How many, at least 1. Their indices are 0 ... runs - 1.
        seed: Seed, 0 <= seed < 2**63.
        sampling: Where the runs lie in the unit cube: `Random()` (None), `Sobol()` or `LatinHypercube(runs)`.
        settings: Method and tolerances; None for the defaults.
        block: Runs solved together, a multiple of 64.
        threads: Blocks solved at the same time; None for one a core.
        progress: Called as `progress(done, runs)` after each block.

    Returns:
        The table, on the host. For numbers of runs that do not fit in memory use `verify`, or `stream`.

    Raises:
        ValueError: An argument is out of range.
    """
    require(runs >= 1, f"Argument `runs` must be at least 1, but is {runs}.")
    blocks = stream(
        study, range(runs), seed, sampling=sampling, settings=settings, block=block, threads=threads, progress=progress
    )
    return concatenate(list(blocks))


def stream(
    study: Study,
    indices: Sequence[int] | np.ndarray,
    seed: int = 0,
    *,
    sampling: AbstractSampling | None = None,
    settings: SolverSettings | None = None,
    block: int = BLOCK,
    threads: int | None = None,
    progress: Progress | None = None,
) -> Iterator[Runs]:
    """Solves the runs of the given indices and yields them block by block, in order, holding only a few at a time.

    Args:
        study: The study.
        indices: Indices of the runs, any subset in any order.
        seed: Seed of the study.
        sampling: As for `monte_carlo`.
        settings: Method and tolerances; None for the defaults.
        block: Runs solved together, a multiple of 64.
        threads: Blocks solved at the same time; None for one a core.
        progress: Called as `progress(done, len(indices))` after each block.

    Yields:
        Tables of at most `block` rows.
    """
    lanes = Lanes(study, settings or SolverSettings(), block)
    sampling = sampling or Random()
    threads = os.cpu_count() or 1 if threads is None else threads
    require(threads >= 1, f"Argument `threads` must be at least 1, but is {threads}.")

    def work(start: int) -> Runs:
        chunk = np.asarray(indices[start : start + block], dtype=np.int64)
        return lanes.solve(chunk, sampling.points(seed, chunk, study.dimension))

    lanes.compile()
    done = 0
    for table in _in_order(work, range(0, len(indices), block), threads):
        done += len(table)
        if progress is not None:
            progress(done, len(indices))
        yield table


def _in_order(work: Callable[[int], Runs], starts: range, threads: int) -> Iterator[Runs]:
    """Results in the order of `starts`, with at most two pieces of work a thread begun and not yet taken."""
    pending: deque[Future[Runs]] = deque()
    remaining = iter(starts)
    with ThreadPoolExecutor(threads) as pool:
        try:
            for start in remaining:
                pending.append(pool.submit(work, start))
                if len(pending) >= 2 * threads:
                    yield pending.popleft().result()
            while pending:
                yield pending.popleft().result()
        finally:
            for future in pending:
                future.cancel()

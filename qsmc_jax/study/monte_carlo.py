"""Many runs of a study: fixed-size blocks over threads, rows out in order of their index."""

import collections
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np

from qsmc_jax.base.checks import require_count, require_kind
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.batches import BatchSolver, block_size, thread_count
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.sampling import SAMPLINGS, AbstractSampling, Random
from qsmc_jax.study.schedule import Workload
from qsmc_jax.study.study import HINT, Study, require_study
from qsmc_jax.study.windows import Piece, Planner, reassembled

Progress = Callable[[int, int], None]


def monte_carlo(
    study: Study,
    runs: int,
    seed: int = 0,
    *,
    sampling: AbstractSampling | None = None,
    settings: SolverSettings | None = None,
    block: int | None = None,
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
        sampling: Where the runs lie in the cube: `Random()` (None), `Sobol()`, `LatinHypercube(runs)`, `Table(rows)`.
        settings: Method and tolerances; None for the defaults.
        block: Runs solved together, a multiple of 64; None for what suits the platform, on CPUs 512.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        progress: Called as `progress(done, runs)` after each block.

    Returns:
        The table, on the host. For numbers of runs that do not fit in memory use `verify`, or `stream`.

    Raises:
        InputError: An argument is out of range.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> runs = qj.monte_carlo(study, runs=64, block=64)
        >>> len(runs), runs.names, bool((runs["peak_ratio"] < 1.0).all())
        (64, ('x0[0]', 'x0[1]'), True)
    """
    require_study(study)
    require_count("runs", runs)
    blocks = stream(
        study, range(runs), seed, sampling=sampling, settings=settings, block=block, threads=threads, progress=progress
    )
    tables = list(blocks)
    return tables[0] if len(tables) == 1 else concatenate(tables)


def stream(
    study: Study,
    indices: Sequence[int] | np.ndarray,
    seed: int = 0,
    *,
    sampling: AbstractSampling | None = None,
    settings: SolverSettings | None = None,
    block: int | None = None,
    threads: int | None = None,
    progress: Progress | None = None,
    workload: Workload | None = None,
    planner: Planner | None = None,
) -> Iterator[Runs]:
    """Solves the runs of the given indices and yields them window by window, in order, holding only a few at a time.

    Within a window of some blocks, runs with the same method and like cost are solved together. A run's row does not
    depend on it, to the last bit. Made to be called often, it asks whether the study has changed only before it
    compiles: `study.require_unchanged()` asks at any time.

    Args:
        study: The study.
        indices: Indices of the runs, any subset in any order.
        seed: Seed of the study.
        sampling: As for `monte_carlo`.
        settings: Method and tolerances; None for the defaults.
        block: Runs solved together, a multiple of 64; None for what suits the platform, on CPUs 512.
        threads: Blocks solved at the same time; None for one a core of a CPU.
        progress: Called as `progress(done, len(indices))` after each block.
        workload: Told what each block cost.
        planner: What earlier calls for the same study, seed, sampling, settings and block learned; None to begin anew.

    Yields:
        Tables of up to 16 blocks.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> [table["index"].tolist() for table in qj.stream(study, [17, 3], block=64)]
        [[17, 3]]
    """
    require_kind("study", study, Study, HINT)
    block = block_size(block)
    solver = BatchSolver(study, settings or SolverSettings(), block)
    sampling = sampling or Random()
    require_kind("sampling", sampling, AbstractSampling, SAMPLINGS)
    threads = thread_count(threads)
    planner = planner or Planner(solver, seed, sampling)
    done, solved = 0, []
    for piece, table in _in_order(solver, planner.pieces(indices), threads):
        done += len(table)
        solved.append((piece.rows, table))
        planner.learn(piece, table["steps"])
        if workload is not None:
            workload.add(table["steps"], block)
        if progress is not None:
            progress(done, len(indices))
        if piece.ends_window:
            yield reassembled(solved)
            solved = []


def _in_order(solver: BatchSolver, pieces: Iterator[Piece], threads: int) -> Iterator[tuple[Piece, Runs]]:
    """Pieces and their rows, in order, with at most two pieces a thread begun and not yet taken."""
    pending: collections.deque[tuple[Piece, Future[Runs]]] = collections.deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for piece in pieces:
                solver.compile(piece.method)  # here, or each thread would
                pending.append((piece, pool.submit(solver.solve, piece.indices, piece.points, piece.method)))
                if len(pending) >= 2 * threads:
                    piece, future = pending.popleft()
                    yield piece, future.result()
            while pending:
                piece, future = pending.popleft()
                yield piece, future.result()
        finally:
            for _, future in pending:
                future.cancel()

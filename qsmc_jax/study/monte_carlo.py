"""Many runs of a study: fixed-size blocks over threads, rows out in order of their index."""

import collections
import dataclasses
import os
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.stiffness import method_for
from qsmc_jax.study.lanes import Lanes
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.sampling import AbstractSampling, Random
from qsmc_jax.study.schedule import Schedule, Workload
from qsmc_jax.study.study import Study

# Small enough that a sample for the numerical error and a few doubtful runs cost little, large enough to vectorise.
BLOCK = 512
# Blocks in a window: within one, runs are solved in the order of what they are expected to cost. The first is small.
FIRST_WINDOW, WINDOW = 4, 16

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
    workload: Workload | None = None,
) -> Iterator[Runs]:
    """Solves the runs of the given indices and yields them window by window, in order, holding only a few at a time.

    Within a window of some blocks, runs with the same method and like cost are solved together. A run's row does not
    depend on it, to the last bit.

    Args:
        study: The study.
        indices: Indices of the runs, any subset in any order.
        seed: Seed of the study.
        sampling: As for `monte_carlo`.
        settings: Method and tolerances; None for the defaults.
        block: Runs solved together, a multiple of 64.
        threads: Blocks solved at the same time; None for one a core.
        progress: Called as `progress(done, len(indices))` after each block.
        workload: Told what each block cost.

    Yields:
        Tables of up to 16 blocks.
    """
    lanes = Lanes(study, settings or SolverSettings(), block)
    sampling = sampling or Random()
    threads = os.cpu_count() or 1 if threads is None else threads
    require(threads >= 1, f"Argument `threads` must be at least 1, but is {threads}.")
    planner = _Planner(lanes, seed, sampling)
    done, solved = 0, []
    for piece, table in _in_order(lanes, planner.pieces(indices), threads):
        done += len(table)
        solved.append((piece.rows, table))
        planner.learn(piece, table["steps"])
        if workload is not None:
            workload.add(table["steps"], block)
        if progress is not None:
            progress(done, len(indices))
        if piece.ends_window:
            yield _reassembled(solved)
            solved = []


@dataclasses.dataclass(frozen=True)
class _Piece:
    """Runs to be solved together: their rows in the window, their indices, points and method."""

    rows: np.ndarray
    indices: np.ndarray
    points: Float[np.ndarray, "runs dim"]
    method: str
    ends_window: bool


class _Planner:
    """Cuts the runs into windows, and each window into pieces of equal method and like cost."""

    def __init__(self, lanes: Lanes, seed: int, sampling: AbstractSampling):
        self._lanes, self._seed, self._sampling = lanes, seed, sampling
        self._schedules = collections.defaultdict(lambda: Schedule(lanes.study.dimension))

    def learn(self, piece: _Piece, steps: np.ndarray) -> None:
        """Takes in what a piece cost."""
        self._schedules[piece.method].learn(piece.points, steps)

    def pieces(self, indices: Sequence[int] | np.ndarray) -> Iterator[_Piece]:
        """All pieces, in the order of their windows. A small window comes first, to learn from."""
        start, size = 0, FIRST_WINDOW * self._lanes.count
        while start < len(indices):
            yield from self._window(np.asarray(indices[start : start + size], dtype=np.int64))
            start, size = start + size, WINDOW * self._lanes.count

    def _window(self, indices: np.ndarray) -> Iterator[_Piece]:
        block, dim = self._lanes.count, self._lanes.study.dimension
        chunks = [indices[i : i + block] for i in range(0, len(indices), block)]
        chunked = [self._sampling.points(self._seed, chunk, dim) for chunk in chunks]
        points, (methods, stiffness) = np.concatenate(chunked), self._methods(chunked)
        parts = []
        for method in map(str, np.unique(methods)):
            rows = np.flatnonzero(methods == method)
            rows = rows[self._schedules[method].order(points[rows], stiffness[rows])]
            parts += [(method, rows[i : i + block]) for i in range(0, len(rows), block)]
        for number, (method, rows) in enumerate(parts):
            self._lanes.compile(method)
            yield _Piece(rows, indices[rows], points[rows], method, number == len(parts) - 1)

    def _methods(self, chunked: list[Float[np.ndarray, "_ dim"]]) -> tuple[np.ndarray, np.ndarray]:
        """The method for each run, and how stiff it will be if that has a say."""
        runs, asked_for = sum(map(len, chunked)), self._lanes.settings.method
        if asked_for != "auto":
            return np.full(runs, asked_for), np.zeros(runs)
        stiffness = np.concatenate([self._lanes.stiffness(points) for points in chunked])
        nominal = self._lanes.study.stiffness
        return np.array([method_for(each, nominal) for each in stiffness]), stiffness


def _reassembled(solved: list[tuple[np.ndarray, Runs]]) -> Runs:
    """The rows of a window in order."""
    return concatenate([table for _, table in solved]).take(np.argsort(np.concatenate([rows for rows, _ in solved])))


def _in_order(lanes: Lanes, pieces: Iterator[_Piece], threads: int) -> Iterator[tuple[_Piece, Runs]]:
    """Pieces and their rows, in order, with at most two pieces a thread begun and not yet taken."""
    pending: collections.deque[tuple[_Piece, Future[Runs]]] = collections.deque()
    with ThreadPoolExecutor(threads) as pool:
        try:
            for piece in pieces:
                pending.append((piece, pool.submit(lanes.solve, piece.indices, piece.points, piece.method)))
                if len(pending) >= 2 * threads:
                    piece, future = pending.popleft()
                    yield piece, future.result()
            while pending:
                piece, future = pending.popleft()
                yield piece, future.result()
        finally:
            for _, future in pending:
                future.cancel()

"""Windows of runs, and in each the pieces to be solved together: of one method, and of like cost."""

import collections
import dataclasses
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import Float

from qsmc_jax.simulation.stiffness import BY_STIFFNESS, rows_by_method
from qsmc_jax.study.batches import BatchSolver
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.sampling import AbstractSampling
from qsmc_jax.study.schedule import Schedule

# Blocks in a window: within one, runs are solved in the order of what they are expected to cost. The first is small.
FIRST_WINDOW, WINDOW = 4, 16


@dataclasses.dataclass(frozen=True)
class Piece:
    """Runs to be solved together: their places among all asked for, their indices, points and method."""

    rows: np.ndarray
    indices: np.ndarray
    points: Float[np.ndarray, "runs dim"]
    method: str
    ends_window: bool


class Planner:
    """Cuts the runs into windows, and each window into pieces of equal method and like cost."""

    def __init__(self, solver: BatchSolver, seed: int, sampling: AbstractSampling):
        self._solver, self._seed, self._sampling = solver, seed, sampling
        self._schedules = collections.defaultdict(lambda: Schedule(solver.study.dimension))

    def learn(self, piece: Piece, steps: np.ndarray) -> None:
        """Takes in what a piece cost."""
        self._schedules[piece.method].learn(piece.points, steps)

    def pieces(self, indices: Sequence[int] | np.ndarray) -> Iterator[Piece]:
        """All pieces, in the order of their windows. As long as nothing is known a small one comes first, to learn."""
        start, size = 0, (WINDOW if self._schedules else FIRST_WINDOW) * self._solver.count
        while start < len(indices):
            yield from self._window(start, np.asarray(indices[start : start + size]))
            start, size = start + size, WINDOW * self._solver.count

    def _window(self, start: int, indices: np.ndarray) -> Iterator[Piece]:
        block, dim = self._solver.count, self._solver.study.dimension
        chunks = [indices[i : i + block] for i in range(0, len(indices), block)]
        chunked = [self._sampling.points(self._seed, chunk, dim) for chunk in chunks]
        points, stiffness, asked_for = np.concatenate(chunked), self._stiffness(chunked), self._solver.settings.method
        parts = []
        for method, rows in rows_by_method(stiffness, self._solver.study.stiffness, asked_for):
            if len(rows) > block:  # else they are solved together in any order
                rows = rows[self._schedules[method].order(points[rows], stiffness[rows])]
            parts += [(method, rows[i : i + block]) for i in range(0, len(rows), block)]
        for number, (method, rows) in enumerate(parts):
            yield Piece(start + rows, indices[rows], points[rows], method, number == len(parts) - 1)

    def _stiffness(self, chunked: list[Float[np.ndarray, "_ dim"]]) -> Float[np.ndarray, " runs"]:
        """How stiff each run will be; 0 if that has no say."""
        has_a_say = self._solver.settings.method in BY_STIFFNESS
        return np.concatenate([self._solver.stiffness(each) if has_a_say else np.zeros(len(each)) for each in chunked])


def reassembled(solved: list[tuple[np.ndarray, Runs]]) -> Runs:
    """The rows of a window in order."""
    together, rows = concatenate([table for _, table in solved]), np.concatenate([rows for rows, _ in solved])
    return together if np.all(rows[1:] > rows[:-1]) else together.take(np.argsort(rows))

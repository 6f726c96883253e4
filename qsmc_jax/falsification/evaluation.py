"""Simulations of a search: counted, none made twice, all by one program of a fixed size."""

import dataclasses
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from jaxtyping import Float, Int

from qsmc_jax.falsification.objective import Objective
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.batches import LANE_MULTIPLE, BatchSolver, table, thread_count
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.study import Study
from qsmc_jax.study.tangents import Along

# Runs that are kept, the worst: one of them is reported, if another way of solving it confirms it.
KEPT = 8


@dataclasses.dataclass(frozen=True)
class Ask:
    """What a search wants to know.

    Attributes:
        points: Points of the unit cube.
        coordinates: By which coordinates to differentiate at the only point; None for no derivative.
    """

    points: Float[np.ndarray, "points dim"]
    coordinates: Int[np.ndarray, " coordinates"] | None = None

    @property
    def cost(self) -> int:
        """Simulations that it takes: a gradient as many as there are coordinates, and one."""
        return len(self.points) if self.coordinates is None else 1 + len(self.coordinates)


@dataclasses.dataclass(frozen=True)
class Answer:
    """What it learns.

    Attributes:
        scores: How bad the runs are; -inf where nothing is known of one.
        gradient: The derivative of the score, 0 where there is none; None if it was not asked for.
    """

    scores: Float[np.ndarray, " points"]
    gradient: Float[np.ndarray, " dim"] | None = None


class Evaluator:
    """Makes simulations until the budget is spent, and keeps the worst.

    Attributes:
        simulations: Simulations made; a gradient counts as one for the run and one for each coordinate.
        undecided: Runs without a verdict on a claim by which they are judged.
        first_violation_at: Simulations after which the first run violated a claim it is judged by; None if none did.
        worst: The worst runs, the very worst first, and then some without a verdict; `index` is a row of `points`.
        points: Their points.
        progress: (simulations, score) each time a run was worse than all before.
    """

    def __init__(self, study: Study, objective: Objective, settings: SolverSettings, budget: int, threads: int | None):
        """Nothing simulated yet."""
        self._solver, self._objective, self._budget = BatchSolver(study, settings, LANE_MULTIPLE), objective, budget
        self._threads, self._known = thread_count(threads), {}
        self.simulations = self.undecided = 0
        self.first_violation_at: int | None = None
        self.worst: Runs | None = None
        self.points = np.empty((0, study.dimension))
        self.progress: list[tuple[int, float]] = []

    @property
    def left(self) -> int:
        """Simulations that may still be made."""
        return self._budget - self.simulations

    @property
    def is_done(self) -> bool:
        """Whether the budget is spent, or a claim was asked for and is violated."""
        return self.left <= 0 or (self._objective.is_claim and self.first_violation_at is not None)

    def answer(self, asks: Sequence[Ask]) -> list[Answer]:
        """Answers questions together, in their order; what the budget does not reach scores -inf.

        Args:
            asks: The questions. None but the study decides whether they may have derivatives.
        """
        points, directions, owners, counts = self._lanes(asks)
        if len(points):
            rows, slopes = self._solve(points, directions)
            self._keep(points, rows, counts)
        else:
            slopes = np.empty(0)
        return [self._answered(ask, slopes[owners == number]) for number, ask in enumerate(asks)]

    def _lanes(self, asks: Sequence[Ask]) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """The simulations of questions: point, direction, number of the question, and what each costs."""
        points, directions, owners, counts = [], [], [], []
        room, seen, dim = self.left, set(), self._solver.study.dimension
        for number, ask in enumerate(asks):
            if ask.coordinates is not None:
                if ask.cost <= room and len(ask.coordinates):
                    points += [ask.points[0]] * len(ask.coordinates)
                    directions += list(np.eye(dim)[ask.coordinates])
                    owners += [number] * len(ask.coordinates)
                    counts += [2] + [1] * (len(ask.coordinates) - 1)
                    room -= ask.cost
                continue
            for point in ask.points:
                key = point.tobytes()
                if key in self._known or key in seen or room < 1:
                    continue
                seen.add(key)
                points.append(point)
                directions.append(np.zeros(dim))
                owners.append(number)
                counts.append(1)
                room -= 1
        shape = (len(points), dim)
        return np.reshape(points, shape), np.reshape(directions, shape), np.array(owners, int), np.array(counts, int)

    def _solve(self, points: np.ndarray, directions: np.ndarray) -> tuple[Runs, np.ndarray]:
        """Rows and slopes of all lanes, some dozens at a time."""
        lanes, solver = self._solver.count, self._solver
        study, method = solver.study, solver.nominal_method
        if not self._objective.has_gradient:
            solver.compile(method)

            def solved(chunk: np.ndarray) -> tuple[Runs, np.ndarray]:
                return solver.solve(chunk, points[chunk], method), np.zeros(len(chunk))
        else:
            block = Along(solver.choices(method, adjoint="forward"), self._objective.column)
            program = solver.compile_block(block, np.empty((lanes, study.dimension)))

            def solved(chunk: np.ndarray) -> tuple[Runs, np.ndarray]:
                along = np.zeros((lanes, study.dimension))
                along[: len(chunk)] = directions[chunk]
                record, metrics, slopes = solver.call(program, points[chunk], along)
                return table(study, chunk, record, metrics), slopes[: len(chunk)]

        chunks = [np.arange(i, min(i + lanes, len(points))) for i in range(0, len(points), lanes)]
        with ThreadPoolExecutor(self._threads) as pool:
            tables, slopes = zip(*pool.map(solved, chunks), strict=True)
        return concatenate(tables), np.concatenate(slopes)

    def _keep(self, points: np.ndarray, rows: Runs, counts: np.ndarray) -> None:
        scores, violated = self._objective.scores(rows), self._objective.is_violated(rows)
        at = self.simulations + np.cumsum(counts)
        best = max((score for _, score in self.progress), default=-np.inf)
        doubtful = self._objective.is_undecided(rows)
        for point, score, now, is_doubtful in zip(points, scores, at, doubtful, strict=True):
            if point.tobytes() in self._known:
                continue
            self._known[point.tobytes()] = float(score)
            self.undecided += bool(is_doubtful)
            if score > best:
                best = float(score)
                self.progress.append((int(now), best))
        if self.first_violation_at is None and violated.any():
            self.first_violation_at = int(at[violated.argmax()])
        self.simulations += int(counts.sum())
        self._keep_worst(points, rows)

    def _keep_worst(self, points: np.ndarray, rows: Runs) -> None:
        both = rows if self.worst is None else concatenate([self.worst, rows])
        places = np.concatenate([self.points, points])
        _, first = np.unique(places, axis=0, return_index=True)
        first = np.sort(first)  # of runs as bad the earliest comes first
        order = first[np.argsort(-self._objective.scores(both.take(first)), kind="stable")]
        is_doubtful = self._objective.is_undecided(both.take(order))
        order = np.concatenate([order[~is_doubtful][:KEPT], order[is_doubtful][:KEPT]])
        self.points, kept = places[order], both.take(order)
        self.worst = dataclasses.replace(kept, columns={**kept.columns, "index": np.arange(len(order))})

    def _answered(self, ask: Ask, slopes: np.ndarray) -> Answer:
        scores = np.array([self._known.get(point.tobytes(), -np.inf) for point in ask.points])
        if ask.coordinates is None:
            return Answer(scores)
        gradient = np.zeros(ask.points.shape[1])
        if len(slopes):
            sign = -1.0 if self._objective.is_low_worse else 1.0
            gradient[ask.coordinates] = sign * np.nan_to_num(slopes, nan=0.0, posinf=0.0, neginf=0.0)
        return Answer(scores, gradient)

"""Which runs to solve together: a block takes as long as its slowest run."""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

# Weight of the penalty on the coefficients, against the number of runs seen: enough to make the system regular.
_PENALTY = 1e-6
# Features from which on a product takes longer by one thread than the others would be in the way.
_MANY_FEATURES = 500
# Runs of one block from which is learned.
_ENOUGH = 8192


@dataclasses.dataclass
class Workload:
    """What a stream of runs cost.

    Attributes:
        steps: Steps that the runs took.
        paid: Steps that were made, by every lane until the slowest of its block was done.
    """

    steps: int = 0
    paid: int = 0

    def add(self, steps: Int[np.ndarray, " runs"], lanes: int) -> None:
        """Counts one block of so many lanes."""
        self.steps += int(steps.sum())
        self.paid += lanes * int(steps.max(initial=0))

    @property
    def occupancy(self) -> float:
        """Part of the work that was not waiting for the slowest lane, in (0, 1]; 1 if there was none."""
        return self.steps / self.paid if self.paid else 1.0


class Schedule:
    """Learns the steps of a run from the steps of earlier ones, and puts runs with equal prospects side by side.

    Least squares for the logarithm of the steps, on each coordinate of the unit cube and its square. Whatever it
    predicts, the results are the same to the last bit.
    """

    def __init__(self, dim: int):
        """Knows nothing."""
        size = 2 * dim + 1
        self._gram, self._moments, self._seen = np.zeros((size, size)), np.zeros(size), 0

    def learn(self, points: Float[np.ndarray, "runs dim"], steps: Int[np.ndarray, " runs"]) -> None:
        """Updates the fit with solved runs; runs without a step are ignored."""
        every = max(1, -(-len(steps) // _ENOUGH))
        points, steps = points[::every], steps[::every]
        taken = steps > 0
        features = _features(points[taken])
        self._gram += _product(features, features)
        self._moments += _product(features, np.log(steps[taken]))
        self._seen += int(taken.sum())

    def order(
        self, points: Float[np.ndarray, "runs dim"], hint: Float[np.ndarray, " runs"]
    ) -> Int[np.ndarray, " runs"]:
        """Row numbers, runs with few steps first; while nothing is known, those with a low `hint`."""
        if not self._seen:
            return np.argsort(hint, kind="stable")
        penalty = _PENALTY * self._seen * np.eye(len(self._gram))
        coefficients = np.linalg.solve(self._gram + penalty, self._moments)
        return np.argsort(_features(points) @ coefficients, kind="stable")


def _features(points: Float[np.ndarray, "runs dim"]) -> Float[np.ndarray, "runs features"]:
    return np.concatenate([np.ones((len(points), 1)), points - 0.5, (points - 0.5) ** 2], axis=1)


def _product(features: Float[np.ndarray, "runs features"], others: np.ndarray) -> np.ndarray:
    """The features, transposed, times others; by one thread, unless there are very many.

    A large product starts as many threads as there are cores, which wait for more work for 30 ms, at full speed: in
    the way of those that solve.
    """
    if features.shape[1] > _MANY_FEATURES:
        return features.T @ others
    return np.einsum("ri,r...->i...", features, others)

"""Many searches at once: random runs first, then one from each of the worst, all simulated together."""

import numpy as np
from jaxtyping import Float

from qsmc_jax.falsification.ascent import Search, ascend
from qsmc_jax.falsification.cube import Cube
from qsmc_jax.falsification.evaluation import Answer, Ask, Evaluator
from qsmc_jax.study.monte_carlo import Progress
from qsmc_jax.study.sampling import Random

# Part of the budget that goes to random runs, how many there are at the least and, for each search, at the most.
_PART, _FEWEST, _MOST = 0.1, 8, 256
# Searches that go on at the same time.
TOGETHER = 4


def search(
    evaluator: Evaluator, cube: Cube, seed: int, budget: int, has_gradient: bool, progress: Progress | None
) -> float:
    """Spends the budget: random runs, searches from the worst of them, and so on from further ones.

    Args:
        evaluator: Makes the simulations.
        cube: Where to search.
        seed: Seed of the random runs.
        budget: Simulations at most.
        has_gradient: Whether the gradient can be trusted.
        progress: Called as `progress(simulations, budget)`.

    Returns:
        The score of the worst of the random runs at the beginning.
    """
    count = min(max(int(_PART * budget), _FEWEST), _MOST, budget)
    starts, drawn, random = [], 0, -np.inf
    active: list[tuple[Search, Ask]] = []
    while not evaluator.is_done:
        if not starts and len(active) < TOGETHER:
            points = cube.inside(Random().points(seed, range(drawn, drawn + count), len(cube.low)))
            before = evaluator.simulations
            (answer,) = evaluator.answer([Ask(points)])
            random = random if drawn else float(answer.scores.max())
            drawn += count
            if evaluator.is_done or evaluator.simulations == before:  # a cube without room has but one point
                break
            starts = _sorted(points, answer)
        while starts and len(active) < TOGETHER:
            point, score = starts.pop(0)
            new = ascend(point, score, cube, has_gradient)
            ask = next(new, None)
            if ask is not None:
                active.append((new, ask))
        active = _advanced(active, evaluator)
        if progress is not None:
            progress(min(evaluator.simulations, budget), budget)
    return random


def _sorted(points: Float[np.ndarray, "runs dim"], answer: Answer) -> list[tuple[np.ndarray, float]]:
    """The points with their scores, the worst first."""
    order = np.argsort(-answer.scores, kind="stable")
    return [(points[i], float(answer.scores[i])) for i in order]


def _advanced(active: list[tuple[Search, Ask]], evaluator: Evaluator) -> list[tuple[Search, Ask]]:
    """The searches after one more answer each; those that end drop out."""
    answers = evaluator.answer([ask for _, ask in active])
    going = []
    for (each, _), answer in zip(active, answers, strict=True):
        try:
            going.append((each, each.send(answer)))
        except StopIteration:
            continue
    return going

"""How bad a run each search finds within a budget of simulations. One command: see Time.

Question: Example 1 with everything uncertain and the worst constant disturbance: what peak |u| do `falsify`, random
search and SciPy's differential evolution find within 100, 200 and 400 simulations? The best known is 8.029.
Claim: `falsify` finds it within 100 from every seed, the others from none within 400.
Time: a minute or two on two cores:

    python studies/benchmarks/falsification_race.py --seeds 10
"""

import argparse
import runpy
from pathlib import Path

import numpy as np
from scipy import optimize

import qsmc_jax as qj
from qsmc_jax.falsification.adversary import against
from qsmc_jax.falsification.cube import cube_of

STUDY = runpy.run_path(str(Path(__file__).parents[1] / "example1_uncertain.py"))["study"]
METRIC, BUDGETS = "peak_u", (100, 200, 400)
# SciPy's default: members of the population for each number.
MEMBERS = 15


class Counted:
    """The metric at points of the coordinates that are searched, and the worst after each simulation."""

    def __init__(self) -> None:
        self._study = against(STUDY, 0)
        self._cube = cube_of(self._study, STUDY, 1e-3)
        self.dim = int(self._cube.is_free.sum())
        self.worst: list[float] = []

    def __call__(self, points: np.ndarray) -> np.ndarray:
        """The metric with the sign that SciPy wants, for points in columns."""
        places = np.tile(self._cube.centre, (points.shape[1], 1))
        places[:, self._cube.is_free] = points.T
        table = qj.Table(self._cube.inside(places))
        found = qj.monte_carlo(self._study, len(table), sampling=table, block=64)[METRIC]
        found = np.nan_to_num(found, nan=-np.inf)
        self.worst.extend(found)
        return -found

    def within(self, budgets: tuple[int, ...]) -> list[float]:
        """The worst after so many simulations."""
        return [float(np.max(self.worst[:budget])) for budget in budgets]


def random_search(seed: int) -> list[float]:
    """Independent uniform points."""
    count = Counted()
    count(np.random.default_rng(seed).uniform(size=(count.dim, BUDGETS[-1])))
    return count.within(BUDGETS)


def differential_evolution(seed: int) -> list[float]:
    """SciPy's, a generation at a time."""
    count = Counted()
    generations = -(-BUDGETS[-1] // (MEMBERS * count.dim))
    options = {"popsize": MEMBERS, "maxiter": generations, "polish": False, "tol": 0.0}
    bounds = [(0.0, 1.0)] * count.dim
    optimize.differential_evolution(count, bounds, rng=seed, vectorized=True, updating="deferred", **options)
    return count.within(BUDGETS)


def ours(seed: int) -> list[float]:
    """`falsify` with the whole of the budget each time."""
    return [qj.falsify(STUDY, METRIC, budget=budget, seed=seed, adversary=0).value for budget in BUDGETS]


def main() -> None:
    """The least and the median over the seeds, for each search and budget."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=10)
    seeds = range(parser.parse_args().seeds)
    print("| search | " + " | ".join(f"{budget} simulations: least, median" for budget in BUDGETS) + " |")
    print("|---" * (1 + len(BUDGETS)) + "|")
    for search in (ours, random_search, differential_evolution):
        found = np.array([search(seed) for seed in seeds])
        cells = [f"{each.min():.4f}, {np.median(each):.4f}" for each in found.T]
        print(f"| {search.__name__} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()

"""What a gradient by two gains costs, in solves of the same runs. One command: see Time.

Question: How much longer than solving 64 runs does it take to solve them with the derivatives of two metrics by mu and
    rho_inf?
Claim: two to three times as long with Tsit5 and for sampled loops, three and a half with Rodas5P, on one core.
Time: a minute, to be held on one core:

    taskset -c 0 python studies/benchmarks/gradient_cost.py
"""

import runpy
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.batches import BatchSolver
from qsmc_jax.study.sampling import Random
from qsmc_jax.study.tangents import differentiate

STUDIES = Path(__file__).parents[1]
NAMES, METRICS = ("mu", "rho_inf"), ("rms_error", "energy_u")
# Study and method; a sampled loop has one method only.
CASES = (
    ("example1_uncertain.py", "tsit5"),
    ("example1_uncertain.py", "rodas5p"),
    ("example1_tuned.py", "auto"),
    ("example2_tuned.py", "auto"),
)
RUNS, REPEATS = 64, 9


def seconds(work: Callable[[], Any]) -> float:
    """How long it takes."""
    begin = time.perf_counter()
    work()
    return time.perf_counter() - begin


def cost(file: str, method: str) -> tuple[float, float]:
    """Median times of solving, and of solving with derivatives [s]; the two take turns."""
    study = runpy.run_path(str(STUDIES / file))["study"]
    settings = SolverSettings(method=method, adjoint="forward")  # pyright: ignore[reportArgumentType]
    indices, solver = np.arange(RUNS), BatchSolver(study, settings, RUNS)
    points = Random().points(0, indices, study.dimension)

    def solve() -> Any:
        return solver.solve(indices, points, solver.nominal_method)

    def derive() -> Any:
        options = {"names": NAMES, "metrics": METRICS, "settings": settings, "block": RUNS, "threads": 1}
        return differentiate(study, indices, 0, **options)

    solve()
    derive()
    times = [(seconds(solve), seconds(derive)) for _ in range(REPEATS)]
    return statistics.median(each[0] for each in times), statistics.median(each[1] for each in times)


def main() -> None:
    """Prints the table."""
    print("| study | method | 64 runs [ms] | with derivatives [ms] | ratio |")
    print("|---|---|---|---|---|")
    for file, method in CASES:
        solving, deriving = cost(file, method)
        print(f"| {file} | {method} | {1e3 * solving:.1f} | {1e3 * deriving:.1f} | {deriving / solving:.2f} |")


if __name__ == "__main__":
    main()

"""What a step costs of a loop with a recorded disturbance, by the number of samples. One command: see Time.

Question: How much longer than with 40 samples does a step of 64 runs take with 4000, even or not, without and with an
    implementation?
Claim: at most 1.3 times in continuous time; up to 1.6 with an implementation.
Time: two minutes, to be held on one core:

    taskset -c 0 python studies/benchmarks/long_recordings.py
"""

import statistics
import time
from collections.abc import Callable

import numpy as np

import qsmc_jax as qj
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.batches import BatchSolver
from qsmc_jax.study.sampling import Random

RUNS, REPEATS, FEW, MANY, T1 = 64, 9, 40, 4000, 4.0
CASES = {
    "held, even": ("hold", 0.0, None),
    "lines, even": ("linear", 0.0, None),
    "cubic, even": ("cubic", 0.0, None),
    "lines, uneven": ("linear", 0.4, None),
    "lines, even, implemented": ("linear", 0.0, qj.Implementation(sample_period=1e-3)),
}


def a_step(samples: int, kind: str, unevenness: float, implementation: qj.Implementation | None) -> Callable[[], float]:
    """What solves a block and returns how long a step of it took [s]."""
    generator = np.random.default_rng(samples)
    grid = np.linspace(0.0, T1, samples)
    inner = np.r_[0.0, np.full(samples - 2, unevenness * grid[1]), 0.0]
    recording = qj.Recording(grid + inner * generator.uniform(-1.0, 1.0, samples), generator.normal(size=samples), kind)
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05))
    plant, reference = qj.plants.InvertedPendulum(), qj.references.SumOfSines([1.0], [1.0])

    def scenario(draw: qj.Draw) -> qj.Scenario:
        disturbance = draw.uniform("size", 0.1, 0.5) * qj.disturbances.Recorded(recording)
        loop = qj.ClosedLoop(plant, reference, disturbance, control, implementation)
        return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=T1)

    study, indices = qj.Study(scenario, bandwidth=0.1, metrics="claims"), np.arange(RUNS)
    solver = BatchSolver(study, SolverSettings(method="tsit5"), RUNS)
    points = Random().points(0, indices, study.dimension)

    def solve() -> float:
        begin = time.perf_counter()
        runs = solver.solve(indices, points, "tsit5")
        return (time.perf_counter() - begin) / np.max(runs["steps"])

    solve()
    return solve


def main() -> None:
    """Prints the table; the two take turns."""
    print(f"{'':26} us a step, {FEW}   {MANY}   ratio")
    for name, case in CASES.items():
        few, many = a_step(FEW, *case), a_step(MANY, *case)
        pairs = [(few(), many()) for _ in range(REPEATS)]
        medians = [1e6 * statistics.median(column) for column in zip(*pairs, strict=True)]
        ratio = statistics.median(b / a for a, b in pairs)
        print(f"{name:26} {medians[0]:14.1f} {medians[1]:8.1f} {ratio:6.2f}")


if __name__ == "__main__":
    main()

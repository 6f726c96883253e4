"""How many hold-steps a second, side by side with NumPy. One command: `python studies/benchmarks/sampled_race.py`.

Question: the sampled loop of Example 1, 8192 runs of 10 000 holds, with all metrics of every run: how fast against the
same loop in NumPy, bare (states, and peaks as seen at samples) and with the same metrics? The contestants take turns.
Time: six minutes on two cores (`--quick`: one).
"""

import argparse
import statistics
import time
from collections.abc import Callable

import numpy as np
import sampled_numpy

import qsmc_jax as qj


def scenario(draw: qj.Draw) -> qj.Scenario:
    """Example 1 as the NumPy program has it."""
    paper = qj.paper.example1()
    plant = qj.plants.InvertedPendulum(mass=draw.uniform("mass", 0.008, 0.012))
    sine = qj.disturbances.Sine(draw.uniform("amplitude", -0.5, 0.5), draw.uniform("frequency", 0.5, 2.0))
    implementation = qj.Implementation(sampled_numpy.PERIOD)
    loop = qj.ClosedLoop(plant, paper.reference, sine, paper.control, implementation)
    t1 = draw.parameter("t1", 20.0, bounds=(0.1, 100.0))
    return qj.Scenario(loop, draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1)


STUDY = qj.Study(scenario, bandwidth=0.1)


def ours(runs: int, holds: int) -> np.ndarray:
    """Peaks by `monte_carlo`."""
    return qj.monte_carlo(STUDY.substitute(t1=holds * sampled_numpy.PERIOD), runs)["peak_ratio"]


def numpys(variant: str, is_plain: bool) -> Callable[[int, int], np.ndarray]:
    """A contestant: peaks by one of the NumPy programs."""

    def solve(runs: int, holds: int) -> np.ndarray:
        return sampled_numpy.simulate(runs, holds, 0, variant, is_plain=is_plain)["peak_ratio"]

    return solve


CONTESTANTS = {
    "qsmc_jax, all metrics": ours,
    "NumPy, all metrics": numpys("full", is_plain=True),
    "NumPy, bare": numpys("bare", is_plain=True),
    "NumPy, all metrics, sines by tangents": numpys("full", is_plain=False),
    "NumPy, bare, sines by tangents": numpys("bare", is_plain=False),
}


def race(runs: int, holds: int, rounds: int) -> dict[str, float]:
    """Hold-steps a second of each, the median of some rounds in which they take turns."""
    speeds: dict[str, list[float]] = {name: [] for name in CONTESTANTS}
    ours(64, 100)  # compiled beforehand
    for _ in range(rounds):
        for name, solve in CONTESTANTS.items():
            begin = time.perf_counter()
            solve(runs, holds)
            speeds[name].append(runs * holds / (time.perf_counter() - begin))
    return {name: statistics.median(found) for name, found in speeds.items()}


def main() -> None:
    """Prints the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="2048 runs of 2000 holds, once")
    is_quick = parser.parse_args().quick
    speeds = race(2048, 2000, 1) if is_quick else race(8192, 10_000, 3)
    best = speeds["qsmc_jax, all metrics"]
    print("| contestant | million hold-steps/s | qsmc_jax is so many times as fast |\n|---|---|---|")
    for name, speed in speeds.items():
        print(f"| {name} | {speed / 1e6:.1f} | {best / speed:.1f} |")


if __name__ == "__main__":
    main()

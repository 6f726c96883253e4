"""How fast, at what accuracy, and against whom. One command: `python studies/benchmarks/race.py --out results/race`.

Question: how many runs of Example 1 a second, side by side with what else a user could do, as the funnel tightens?
Time: some ten minutes on two cores (`--quick`: one).
"""

import argparse
import dataclasses
import json
import os
import platform
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, ClassVar

import contestants
import diffrax as dfx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import qsmc_jax as qj
from qsmc_jax.simulation import engine
from qsmc_jax.study.draw import Draw
from qsmc_jax.tracing.compiled import compiled

RHO_INF = (0.05, 0.005, 0.0005)
TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7)
# Peaks within this of the truth are accurate enough to compare speeds at.
WANTED = 1e-4


def example1(draw: Any) -> qj.Scenario:
    """Example 1 from random starts, under a sine of random amplitude."""
    mu = draw.parameter("mu", 3.0, bounds=(0.5, 10.0))
    funnel = qj.Funnel(4.0, mu, draw.parameter("rho_inf", 0.05, bounds=(1e-5, 0.09)))
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), funnel)
    disturbance = qj.disturbances.Sine(draw.uniform("amplitude", -0.5, 0.5), 1.0)
    loop = qj.ClosedLoop(qj.plants.InvertedPendulum(), qj.references.SumOfSines([1.0], [1.0]), disturbance, control)
    return qj.Scenario(loop, draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=contestants.HORIZON)


def example2(draw: Any) -> qj.Scenario:
    """Example 2 from random starts, under the paper's disturbance with a random factor."""
    paper = qj.paper.example2()
    funnel = qj.Funnel(5.0, 3.0, draw.parameter("rho_inf", 0.05, bounds=(1e-5, 0.09)))
    control = qj.QuasiSlidingControl(paper.control.surface, funnel)
    disturbance = draw.uniform("amplitude", 0.5, 1.0) * paper.disturbance
    loop = qj.ClosedLoop(paper.plant, paper.reference, disturbance, control)
    return qj.Scenario(loop, draw.uniform("x0", 0.5, 0.7, shape=(4,)), t1=contestants.HORIZON)


EXAMPLES = {1: (example1, contestants.example1), 2: (example2, contestants.example2)}
STUDY = qj.Study(example1, bandwidth=0.1)


def chain(n: int) -> qj.AbstractPlant:
    """Integrators in a row, n of them."""

    class Chain(qj.AbstractPlant):
        order: ClassVar[int] = n

        def drift(self, t: Any, x: Any) -> Any:
            return -x[0]

        def gain(self, t: Any, x: Any) -> Any:
            return 1.0

    return Chain()


def ours(example: Callable[..., Any], method: str = "auto", block: int = 1024) -> Callable[..., np.ndarray]:
    """This library, in the terms of the contestants: it draws their starts and amplitudes itself, from seed 0."""

    def solve(x0: np.ndarray, amplitudes: np.ndarray, rho_inf: float, tolerance: float) -> np.ndarray:
        settings = qj.SolverSettings(rtol=tolerance, method=method, max_steps=1_000_000)
        study = qj.Study(example, bandwidth=2 * rho_inf, values={"rho_inf": rho_inf})
        return qj.monte_carlo(study, len(x0), settings=settings, block=min(block, -(-len(x0) // 64) * 64))["peak_ratio"]

    return solve


@dataclasses.dataclass(frozen=True)
class Row:
    """One contestant at one tolerance."""

    example: int
    rho_inf: float
    name: str
    tolerance: float
    runs: int
    runs_per_second: float
    peak_error: float
    false_violations: int


def race(
    number: int, rivals: dict[str, tuple[Callable[..., np.ndarray], int]], tolerances: Sequence[float], repeats: int
) -> list[Row]:
    """All contestants, interleaved, on the same runs; medians of the repeats."""
    rows = []
    example, most = EXAMPLES[number][0], max(count for _, count in rivals.values())
    x0, amplitudes = starts(qj.Study(example, bandwidth=0.1), most)
    for rho_inf in RHO_INF:
        counts = {name: _fewer(count, rho_inf) if name != "qsmc_jax" else count for name, (_, count) in rivals.items()}
        truth = ours(example, "rodas5p")(x0, amplitudes, rho_inf, 1e-11)
        for tolerance in tolerances:
            times: dict[str, list[float]] = {name: [] for name in rivals}
            peaks = {}
            for repeat in range(repeats + 1):  # the first compiles
                for name, (solve, _) in rivals.items():
                    begin, count = time.perf_counter(), counts[name]
                    peaks[name] = solve(x0[:count], amplitudes[:count], rho_inf, tolerance)
                    times[name] += [time.perf_counter() - begin] if repeat else []
            for name, count in counts.items():
                error = float(np.max(np.abs(peaks[name] - truth[:count])))
                false = int(np.sum(~(peaks[name] < 1.0)))
                rows.append(
                    Row(number, rho_inf, name, tolerance, count, count / float(np.median(times[name])), error, false)
                )
                print(_line(rows[-1]), flush=True)
    return rows


def _fewer(count: int, rho_inf: float) -> int:
    """Runs of a rival: in the narrowest funnel most take so many steps that a tenth has to do."""
    return max(4, int(count * min(1.0, rho_inf / 0.005)))


def starts(study: qj.Study, runs: int) -> tuple[np.ndarray, np.ndarray]:
    """Starts and amplitudes of the first runs of a study."""
    drawn = qj.monte_carlo(study, runs)
    return np.stack([drawn[name] for name in drawn.names if name.startswith("x0")], axis=1), drawn["amplitude"]


def _line(row: Row) -> str:
    return (
        f"{row.example:<4d}{row.rho_inf:<8g}{row.name:28}{row.tolerance:<9.0e}{row.runs:6d}{row.runs_per_second:12.0f}"
        f"{row.peak_error:12.1e}{row.false_violations:8d}"
    )


def headline(runs: int, repeats: int) -> dict[str, float]:
    """Runs a second of Example 1 at rtol 1e-6, turn by turn: ours, plain diffrax, and C++ if it compiles."""
    cpp, times = contestants.CompiledTsit5(), {"qsmc_jax": [], "plain vmapped diffrax": [], "C++, no supremum": []}
    x0, amplitudes = starts(STUDY, runs)
    plain = contestants.plain_diffrax(contestants.example1, dfx.Tsit5)
    for repeat in range(repeats + 1):  # the first compiles
        for name, solve in (("qsmc_jax", ours(example1)), ("plain vmapped diffrax", plain)):
            begin = time.perf_counter()
            solve(x0, amplitudes, 0.05, 1e-6)
            times[name] += [time.perf_counter() - begin] if repeat else []
        if cpp.is_there and repeat:
            times["C++, no supremum"].append(cpp.seconds(runs, os.cpu_count() or 1, 1e-6))
    return {name: runs / float(np.median(each)) for name, each in times.items() if each}


def against_runs(counts: Sequence[int]) -> dict[int, float]:
    """Runs a second against the number of runs, after compilation."""
    speeds = {}
    for count in counts:
        block = 1024 if count >= 2048 else 64
        qj.monte_carlo(STUDY, 64, block=block)
        begin = time.perf_counter()
        for _ in qj.stream(STUDY, range(count), block=block):
            pass
        speeds[count] = count / (time.perf_counter() - begin)
    return speeds


def heavy_tail(runs: int) -> dict[str, float]:
    """Runs a second where rho_inf is log-uniform over 0.0005 ... 0.09: the method by stiffness, or explicit."""

    def spread(draw: Any) -> qj.Scenario:
        return example1(Substituted(draw, rho_inf=draw.log_uniform("rho_inf", 0.0005, 0.09)))

    study, speeds = qj.Study(spread, bandwidth=0.1), {}
    for method in ("auto", "tsit5"):
        settings = qj.SolverSettings(method=method)
        qj.monte_carlo(study, 64, settings=settings)
        begin = time.perf_counter()
        qj.monte_carlo(study, runs, settings=settings)
        speeds[method] = runs / (time.perf_counter() - begin)
    return speeds


class Substituted:
    """Another draw with some of its parameters replaced by numbers that were drawn."""

    def __init__(self, draw: Any, **numbers: Any):
        """Takes the numbers by name."""
        self._draw, self._numbers = draw, numbers

    def parameter(self, name: str, default: float, *, bounds: tuple[float, float]) -> Any:
        """The number, if there is one."""
        return self._numbers[name] if name in self._numbers else self._draw.parameter(name, default, bounds=bounds)

    def __getattr__(self, name: str) -> Any:
        return getattr(self._draw, name)


def gradient_cost(runs: int, repeats: int) -> dict[str, float]:
    """Time of a batch mean and its gradient by mu and rho_inf, forward, over that of the mean alone; rtol 1e-6."""
    gains, rtol = {"mu": np.float64(3.0), "rho_inf": np.float64(0.05)}, np.float64(1e-6)
    points = np.random.default_rng(0).uniform(size=(runs, STUDY.dimension))

    def mean(gains: Any, rtol: Any) -> Any:
        def rms_error(point: Any) -> Any:
            settings = qj.SolverSettings(rtol, method="tsit5", adjoint="forward")
            made = example1(Draw(point, gains))
            x0 = tuple(made.x0)
            metrics, _ = engine.solve(engine.pose(made.loop, x0, 0.1, settings), x0, made.t1, settings)
            return metrics.rms_error + metrics.peak_ratio

        return jnp.mean(jax.vmap(rms_error)(points))

    def gradient(gains: Any, rtol: Any) -> Any:
        along = {name: jnp.asarray([float(name == other) for other in gains]) for name in gains}
        return jax.vmap(lambda d: jax.jvp(lambda g: mean(g, rtol), (gains,), (d,))[1])(along)

    times: list[list[float]] = [[], []]
    with jax.enable_x64(True):
        programs = [compiled(f, gains, rtol, vectorise=True) for f in (mean, gradient)]
        for _ in range(repeats):
            for program, taken in zip(programs, times, strict=True):
                begin = time.perf_counter()
                jax.block_until_ready(program(gains, rtol))
                taken.append(time.perf_counter() - begin)
    primal, both = (float(np.median(each)) for each in times)
    return {"mean [s]": primal, "gradient [s]": both, "ratio": both / primal}


def against_order(orders: Sequence[int], runs: int) -> dict[int, dict[str, float]]:
    """Runs a second, and steps a run, against the order of the plant."""
    speeds = {}
    for order in orders:
        plant, surface = chain(order), qj.SlidingSurface.binomial(2.0, order)

        def of_order(draw: Any, plant: Any = plant, surface: Any = surface, order: int = order) -> qj.Scenario:
            control = qj.QuasiSlidingControl(surface, qj.Funnel(2.0 * 3.0**order, 2.0, 0.05))
            loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Sine(0.5, 1.0), control)
            return qj.Scenario(loop, draw.uniform("x0", 0.0, 0.5, shape=(order,)), t1=contestants.HORIZON)

        study = qj.Study(of_order, bandwidth=0.1)
        qj.monte_carlo(study, 64, block=512)
        begin = time.perf_counter()
        steps = qj.monte_carlo(study, runs, seed=1, block=512)["steps"]
        speeds[order] = {"runs/s": runs / (time.perf_counter() - begin), "steps": float(np.mean(steps))}
    return speeds


def fastest_at(rows: list[Row], wanted: float) -> list[Row]:
    """Per funnel and contestant the fastest row whose peaks are that accurate."""
    best: dict[tuple[int, float, str], Row] = {}
    for row in rows:
        key = row.example, row.rho_inf, row.name
        if row.peak_error <= wanted and (key not in best or row.runs_per_second > best[key].runs_per_second):
            best[key] = row
    return list(best.values())


def plot(rows: list[Row]) -> Any:
    """Work against precision, a row an example, a panel a funnel."""
    names, numbers = (list(dict.fromkeys(getattr(row, field) for row in rows)) for field in ("name", "example"))
    size = {"figsize": (13, 1 + 3.6 * len(numbers)), "layout": "constrained"}
    figure, axes = plt.subplots(len(numbers), len(RHO_INF), sharex=True, sharey=True, squeeze=False, **size)
    for panels, number in zip(axes, numbers, strict=True):
        for ax, rho_inf in zip(panels, RHO_INF, strict=True):
            for name, marker in zip(names, "osD^vPX*", strict=False):
                mine = [row for row in rows if (row.name, row.rho_inf, row.example) == (name, rho_inf, number)]
                error = [max(row.peak_error, 1e-9) for row in mine]
                ax.plot(error, [1e6 / row.runs_per_second for row in mine], marker=marker, label=name)
            ax.axvline(WANTED, color="0.6", linestyle=":")
            ax.set(xscale="log", yscale="log", title=rf"Example {number}, $\rho_\infty$ = {rho_inf:g}")
            ax.grid(alpha=0.3)
        panels[0].set_ylabel("time a run [µs]")
    for ax in axes[-1]:
        ax.set_xlabel(r"largest error of sup$|\sigma|/\rho$ [-]")
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4)
    return figure


def contest(number: int, many: int, few: int, tiny: int) -> dict[str, tuple[Callable[..., np.ndarray], int]]:
    """Who takes part in an example, and with how many runs."""
    example, motion = EXAMPLES[number]
    rivals = {
        "qsmc_jax": (ours(example), many),
        "plain vmapped diffrax": (contestants.plain_diffrax(motion, dfx.Tsit5), few),
        "NumPy RK4, fixed steps": (contestants.numpy_rk4(motion), few),
        "SciPy LSODA": (contestants.scipy_loop(motion, "LSODA"), tiny),
        "SciPy RK45": (contestants.scipy_loop(motion, "RK45"), tiny),
    }
    if number == 1:
        rivals["diffrax with Kvaerno5"] = contestants.plain_diffrax(motion, dfx.Kvaerno5), min(few, 64)
        numba_solve = contestants.numba_tsit5()
        rivals.update({"numba Tsit5, parallel": (numba_solve, few)} if numba_solve else {})
    return rivals


def main() -> None:
    """Races, prints and writes."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", type=Path, required=True, help="folder for race.json and race.png")
    parser.add_argument("--quick", action="store_true", help="fewer repeats, tolerances and runs")
    parser.add_argument("--example", type=int, choices=EXAMPLES, action="append", help="only this example")
    options = parser.parse_args()
    many, few, tiny, repeats = (2048, 256, 4, 1) if options.quick else (8192, 256, 4, 5)
    tolerances = TOLERANCES[1::2] if options.quick else TOLERANCES
    print(f"{'ex':4}{'rho_inf':8}{'contestant':28}{'rtol':9}{'runs':>6}{'runs/s':>12}{'peak error':>12}{'false':>8}")
    rows = []
    for number in options.example or EXAMPLES:
        rows += race(number, contest(number, many, few, tiny), tolerances, repeats)
    print(f"\nFastest with peaks within {WANTED:g}:", *map(_line, fastest_at(rows, WANTED)), sep="\n")
    extra = {
        "headline": headline(many, repeats),
        "gradient": gradient_cost(512, repeats),
        "heavy tail": heavy_tail(many),
        "runs": against_runs((100, 1000, 10_000) if options.quick else (100, 1000, 10_000, 100_000, 1_000_000)),
        "order": against_order((1, 2, 4) if options.quick else range(1, 9), few),
    }
    print(json.dumps(extra, indent=1))
    options.out.mkdir(parents=True, exist_ok=True)
    content = {
        "machine": f"{platform.processor() or platform.machine()}, {os.cpu_count()} cores",
        "rows": [dataclasses.asdict(row) for row in rows],
        **extra,
    }
    (options.out / "race.json").write_text(json.dumps(content, indent=1))
    plot(rows).savefig(options.out / "race.png", dpi=150)


if __name__ == "__main__":
    main()

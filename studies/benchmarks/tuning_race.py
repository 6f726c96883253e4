"""How many simulations until the gains are good, by gradients and without. One command: see Time.

Question: Example 1 in a computer, mu and rho_inf to be chosen: after how many simulations is `tune` as good as SciPy's
differential evolution and Optuna's TPE are in the end, all on the same training runs?
Claim: in the median of five seeds after a thirtieth of what differential evolution takes, a fourteenth of what TPE
    takes, and after less than a tenth in each. README.md has the table.
Time: twenty minutes on two cores (`--seeds 1 --budget 90`: one or two):

    python studies/benchmarks/tuning_race.py --out results/tuning_race.png
"""

import argparse
import dataclasses
import runpy
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy import optimize

import qsmc_jax as qj
from qsmc_jax.display.plotting import BLUE, GREEN, ORANGE, one_axes
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.tuning.batch import Batch, Evaluation
from qsmc_jax.tuning.bounds import bounds_of
from qsmc_jax.tuning.objectives import parse_constraint, parse_objective

FILE = Path(__file__).parents[1] / "example1_implemented.py"
STUDY = runpy.run_path(str(FILE))["study"].substitute(sample_period=1e-3)
NAMES = ("mu", "rho_inf")
OBJECTIVE = "mean(total_variation_u)"
SUBJECT_TO = ("worst(reach_time) <= 1.5", "worst(peak_u) <= 5", "worst(peak_ratio) <= 0.9")
# Objectives this close, relatively, count as equally good.
CLOSE = 1e-3
# What a passed constraint costs the rivals, which know none, against the relative objective.
PENALTY = 10.0
# SciPy's default: members of the population for each gain.
MEMBERS = 15
OURS = "qsmc_jax"


@dataclasses.dataclass(frozen=True)
class Curve:
    """The best so far of one search.

    Attributes:
        n_simulations: Simulations made, after each evaluation.
        best: The least objective of the feasible points up to there; infinite before the first.
    """

    n_simulations: np.ndarray
    best: np.ndarray

    @property
    def final(self) -> float:
        """The best of all."""
        return float(self.best[-1])

    def reached(self, target: float) -> float:
        """Simulations after which it is first as good as the target; infinite if never."""
        close = np.isfinite(self.best) & (self.best <= target + CLOSE * abs(target))
        return float(self.n_simulations[close.argmax()]) if close.any() else np.inf

    def at(self, simulations: np.ndarray) -> np.ndarray:
        """The best after so many simulations."""
        number = np.searchsorted(self.n_simulations, simulations, side="right") - 1
        return np.where(number < 0, np.inf, self.best[number])


def curve(history: Sequence[Evaluation]) -> Curve:
    """Best so far of a history."""
    found = [each.objective if each.is_feasible else np.inf for each in history]
    return Curve(np.array([each.n_simulations for each in history]), np.minimum.accumulate(found))


def training_runs(runs: int, seed: int) -> Batch:
    """What `tune` makes of the same arguments."""
    constraints = tuple(map(parse_constraint, SUBJECT_TO))
    settings = SolverSettings(adjoint="forward")
    objective = parse_objective(OBJECTIVE)
    return Batch(STUDY, bounds_of(STUDY, NAMES), objective, constraints, runs, seed, settings, None, None, 0, None)


def penalised(batch: Batch, scale: float) -> Callable[[Any], float]:
    """What the rivals make small, on the unit cube: one number for objective and constraints."""

    def value(v: Any) -> float:
        made = batch.evaluate(np.asarray(v))
        total = made.objective / scale + PENALTY * float(np.maximum(made.excess, 0.0).sum())
        return total if np.isfinite(total) else 1e6

    return value


def by_evolution(value: Callable[[Any], float], seed: int, budget: int) -> None:
    """SciPy's differential evolution as it stands; it may stop before the budget is spent."""
    generations = max(budget // (MEMBERS * len(NAMES)) - 1, 0)
    bounds = [(0.0, 1.0)] * len(NAMES)
    optimize.differential_evolution(value, bounds, maxiter=generations, popsize=MEMBERS, rng=seed, polish=False)


def by_optuna(value: Callable[[Any], float], seed: int, budget: int) -> None:
    """Optuna's tree-structured Parzen estimator as it stands."""
    import optuna  # pyright: ignore[reportMissingImports]  # of the extra `bench`

    optuna.logging.set_verbosity(optuna.logging.WARNING)
    search = optuna.create_study(sampler=optuna.samplers.TPESampler(seed=seed))
    search.optimize(lambda trial: value([trial.suggest_float(name, 0.0, 1.0) for name in NAMES]), n_trials=budget)


RIVALS = {"SciPy differential evolution": by_evolution, "Optuna TPE": by_optuna}
COLOURS = dict(zip((OURS, *RIVALS), (BLUE, ORANGE, GREEN), strict=True))


def race(seed: int, runs: int, budget: int) -> dict[str, Curve]:
    """All contestants on the training runs of one seed."""
    ours = qj.tune(STUDY, NAMES, OBJECTIVE, SUBJECT_TO, runs=runs, seed=seed, certificate_runs=0)
    curves = {OURS: curve(ours.history)}
    for name, search in RIVALS.items():
        batch = training_runs(runs, seed)
        search(penalised(batch, abs(ours.before.objective)), seed, budget)
        curves[name] = curve(batch.history)
    return curves


def metrics_against(rival: str, curves: dict[str, Curve]) -> list[float]:
    """Both bests, simulations made by the rival, those of both until the rival's best, and their ratio."""
    ours, other = curves[OURS], curves[rival]
    theirs, mine = other.reached(other.final), ours.reached(other.final)
    return [other.final, ours.final, float(other.n_simulations[-1]), theirs, mine, theirs / mine]


def print_table(races: dict[int, dict[str, Curve]]) -> None:
    """One line for each rival and seed, and the medians."""
    print("| rival | seed | its best | our best | its simulations | it was there after | we were after | ratio |")
    print("|---|---|---|---|---|---|---|---|")
    for rival in RIVALS:
        rows = {str(seed): metrics_against(rival, curves) for seed, curves in races.items()}
        rows["median"] = np.median(list(rows.values()), axis=0).tolist()
        for label, (best, ours, *simulations, ratio) in rows.items():
            counts = " | ".join(f"{each:.0f}" for each in simulations)
            print(f"| {rival} | {label} | {best:.4f} | {ours:.4f} | {counts} | {ratio:.1f} |")


def plot(races: dict[int, dict[str, Curve]]) -> Any:
    """Best so far against simulations: every seed thin, the median thick. The axes."""
    ax = one_axes(None, (7.0, 4.5))
    for name, colour in COLOURS.items():
        curves = [each[name] for each in races.values()]
        for each in curves:
            ax.step(each.n_simulations, each.best, where="post", color=colour, alpha=0.35, linewidth=0.8)
        simulations = np.unique(np.concatenate([each.n_simulations for each in curves]))
        middle = np.median([each.at(simulations) for each in curves], axis=0)
        ax.step(simulations, middle, where="post", color=colour, linewidth=2.2, label=f"{name}, median")
    ax.plot([], [], color="black", alpha=0.35, linewidth=0.8, label="single seeds")
    ax.set(xscale="log", xlabel="simulations [runs]", ylabel="best feasible mean total variation of u [N m]")
    ax.legend()
    return ax


def main() -> None:
    """Prints the table, and draws the curves."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--seeds", type=int, default=5, help="so many seeds, from 0")
    parser.add_argument("--runs", type=int, default=128, help="training runs of each evaluation")
    parser.add_argument("--budget", type=int, default=600, help="evaluations of each rival at most")
    parser.add_argument("--out", type=Path, help="PNG to be drawn")
    options = parser.parse_args()
    races = {seed: race(seed, options.runs, options.budget) for seed in range(options.seeds)}
    print_table(races)
    if options.out is not None:
        options.out.parent.mkdir(parents=True, exist_ok=True)
        plot(races).figure.savefig(options.out, dpi=150)


if __name__ == "__main__":
    main()

"""Objective and constraints over a grid of two gains, on the same training runs: where the search went, and why."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require, require_count, require_kind, require_list
from qsmc_jax.display.result import AbstractResult
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.study.study import Study
from qsmc_jax.tuning.batch import KEPT, Batch
from qsmc_jax.tuning.bounds import bounds_of
from qsmc_jax.tuning.objectives import Constraint, Objective, parse_constraint, parse_objective
from qsmc_jax.tuning.result import Tuning
from qsmc_jax.tuning.result_plots import plot_contour, plot_pareto


@dataclasses.dataclass(frozen=True, repr=False)
class Landscape(AbstractResult):
    """Metrics over a grid of two gains.

    Attributes:
        names: The two gains.
        grids: Their values.
        objectives: What was evaluated; the first is the objective.
        constraints: The constraints.
        values: Each objective, (objectives, first, second); infinite where some run has no metric.
        is_feasible: Where every constraint is kept, and every run admissible with known metrics, (first, second).
        marked: Each objective at the gains that were marked, by label.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     rho0, mu = draw.parameter("rho0", 4.0, bounds=(3.0, 8.0)), draw.parameter("mu", 3.0, bounds=(2.0, 4.0))
        ...     control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0, mu, rho_inf=0.05))
        ...     loop = dataclasses.replace(qj.paper.example1(), control=control)
        ...     return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> found = qj.landscape(study, ["rho0", "mu"], "mean(energy_u)", points=2, runs=2, block=64)
        >>> found.names, found.is_feasible.tolist()
        (('rho0', 'mu'), [[True, True], [True, True]])
    """

    names: tuple[str, str]
    grids: tuple[Float[np.ndarray, " first"], Float[np.ndarray, " second"]]
    objectives: tuple[Objective, ...]
    constraints: tuple[Constraint, ...]
    values: Float[np.ndarray, "objectives first second"]
    is_feasible: np.ndarray
    marked: Mapping[str, Float[np.ndarray, " objectives"]]

    def __str__(self) -> str:
        grid = " x ".join(f"{len(grid)} {name}" for name, grid in zip(self.names, self.grids, strict=True))
        return f"{self.objectives[0]} over {grid}"

    @property
    def is_efficient(self) -> np.ndarray:
        """Which feasible cells no other feasible cell beats in the first two objectives, (first, second)."""
        points = self.values[:2].reshape(2, -1).T
        points = np.where(self.is_feasible.reshape(-1, 1) & np.isfinite(points), points, np.inf)
        no_worse = np.all(points[None] <= points[:, None], axis=2)
        better = np.any(points[None] < points[:, None], axis=2)
        efficient = ~np.any(no_worse & better, axis=1) & np.isfinite(points).all(axis=1)
        return efficient.reshape(self.is_feasible.shape)

    def table(self) -> dict[str, Any]:
        """The cells as columns, a row a cell: both gains, each objective, whether it is feasible."""
        mesh = np.meshgrid(*self.grids, indexing="ij")
        columns = {name: values.ravel() for name, values in zip(self.names, mesh, strict=True)}
        columns.update({str(made): values.ravel() for made, values in zip(self.objectives, self.values, strict=True)})
        return {**columns, "is_feasible": self.is_feasible.ravel()}

    def summary(self) -> dict[str, Any]:
        """Everything as plain numbers and texts, ready for JSON."""
        cells = {name: column.tolist() for name, column in self.table().items()}
        marked = {label: values.tolist() for label, values in self.marked.items()}
        return {"names": list(self.names), "constraints": [str(c) for c in self.constraints], **cells, "marked": marked}

    def plot(self, ax: Any = None, *, tuned: Tuning | None = None) -> Any:
        """Contours of the objective, where the constraints are kept, and the path of a search.

        Args:
            ax: Matplotlib `Axes` to draw in; None for a new figure.
            tuned: What `tune` returned for the same two gains; None for contours alone.

        Returns:
            The axes.
        """
        if tuned is not None:
            require_kind("tuned", tuned, Tuning, "Give what `tune` returned.")
            is_fitting = set(self.names) <= set(tuned.parameters)
            require(is_fitting, f"Argument `tuned` must have tuned {' and '.join(self.names)}; it has not.")
        return plot_contour(self, tuned, ax)

    def plot_pareto(self, ax: Any = None) -> Any:
        """The second objective against the first, efficient cells joined, and the marked gains.

        Args:
            ax: Matplotlib `Axes` to draw in; None for a new figure.

        Returns:
            The axes.
        """
        require(len(self.objectives) > 1, "A Pareto front needs two objectives: give `against`.")
        return plot_pareto(self, ax)


def landscape(
    study: Study,
    parameters: Sequence[str],
    objective: str | Objective,
    subject_to: Sequence[str | Constraint] = (),
    *,
    against: str | Objective | None = None,
    points: int = 12,
    runs: int = 128,
    seed: int = 0,
    mark: Mapping[str, Mapping[str, float]] | None = None,
    settings: SolverSettings | None = None,
    block: int | None = None,
    threads: int | None = None,
    progress: Callable[[int, int], None] | None = None,
) -> Landscape:
    """Evaluates objective and constraints over the whole range of two parameters, every cell on the same runs.

    Args:
        study: The study.
        parameters: Two names, as for `tune`.
        objective: The objective, such as accuracy.
        subject_to: The constraints.
        against: A second objective, such as effort, for the Pareto front.
        points: Values of each parameter, spread evenly over its bounds (in the logarithm if they are far apart).
        runs: Runs of each cell.
        seed: Their seed.
        mark: Gains to be marked in the Pareto front, by label.
        settings: Method and tolerances.
        block: Runs solved together at most, a multiple of 64; None for what suits the platform.
        threads: Blocks solved at the same time.
        progress: Called as `progress(done, all)` after each cell.

    Returns:
        The landscape; `plot` it.

    Raises:
        InputError: An argument is out of range.

    Examples:
        >>> import dataclasses
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     rho0, mu = draw.parameter("rho0", 4.0, bounds=(3.0, 8.0)), draw.parameter("mu", 3.0, bounds=(2.0, 4.0))
        ...     control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0, mu, rho_inf=0.05))
        ...     loop = dataclasses.replace(qj.paper.example1(), control=control)
        ...     return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> found = qj.landscape(study, ["rho0", "mu"], "mean(energy_u)", points=2, runs=2, block=64)
        >>> [grid.tolist() for grid in found.grids], found.values.shape
        ([[3.0, 8.0], [2.0, 4.0]], (1, 2, 2))
    """
    require_list("parameters", parameters)
    require_list("subject_to", subject_to)
    names = tuple(parameters)
    require(len(names) == 2, f"Argument `parameters` must name two parameters, but is {list(names)}.")
    require_count("points", points, 2)
    objectives = tuple(parse_objective(each) for each in (objective, against) if each is not None)
    constraints = tuple(map(parse_constraint, subject_to))
    bounds = bounds_of(study, names)
    asked = (*(each <= 0.0 for each in objectives), *constraints)  # their excess is their value: all of one solve
    batch = Batch(
        study, bounds, objectives[0], asked, runs, seed, settings or SolverSettings(), block, threads, 0, None
    )
    cells = [np.array([a, b]) for a in np.linspace(0, 1, points) for b in np.linspace(0, 1, points)]
    made = []
    for number, v in enumerate(cells):
        made.append(batch.evaluate(v))
        if progress is not None:
            progress(number + 1, len(cells))
    count, shape = len(objectives), (points, points)
    values = np.array([[each.excess[i] for each in made] for i in range(count)]).reshape(count, *shape)
    kept = [all(excess <= KEPT for excess in each.excess[count:]) and each.unknown == 0.0 for each in made]
    first = np.array([bounds.gains(np.array([a, 0.0]))[names[0]] for a in np.linspace(0, 1, points)])
    second = np.array([bounds.gains(np.array([0.0, b]))[names[1]] for b in np.linspace(0, 1, points)])
    is_feasible = np.array(kept).reshape(shape)
    marked = {}
    for label, gains in (mark or {}).items():
        marked[label] = np.array(batch.evaluate(bounds.place(gains)).excess[:count])
    return Landscape((names[0], names[1]), (first, second), objectives, constraints, values, is_feasible, marked)

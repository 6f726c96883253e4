"""Signals of many runs of a study on one time grid, solved as batches."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require, require_kind
from qsmc_jax.display.notebook import as_dataset
from qsmc_jax.display.short_repr import short_repr
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.signals import grid_of
from qsmc_jax.study.batches import LANE_MULTIPLE, BatchSolver, table
from qsmc_jax.study.runs import Runs, concatenate
from qsmc_jax.study.sampling import AbstractSampling, Random
from qsmc_jax.study.study import Study, require_study
from qsmc_jax.study.windows import Planner

_PER_DERIVATIVE = ("x", "desired", "e")
_SINGLE = ("sigma", "rho", "u", "d")


@dataclasses.dataclass(frozen=True, eq=False)
class SignalBatch:
    """Signals of several runs on one time grid. NumPy float64; NaN after the end of a run.

    Attributes:
        ts: Times [s].
        runs: The runs' rows, drawn values and metrics, in the order asked for.
        x: States, (runs, times, n).
        desired: Desired output and its first n - 1 derivatives, (runs, times, n).
        e: Errors e^(0) ... e^(n-1), (runs, times, n).
        sigma: Sliding variable, (runs, times); with several inputs, as the next three, (runs, times, m).
        rho: Funnel half-width, (runs, times).
        u: Control input, (runs, times).
        d: Disturbance, (runs, times).
        axis: What the states are numbered by, "derivative", or "state" for a plant in its own coordinates.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> batch = qj.signals(qj.Study(scenario, bandwidth=0.1), range(64))
        >>> batch, len(batch), bool((abs(batch.e[:, -1, 0]) < abs(batch.e[:, 0, 0])).all())
        (<SignalBatch: 64 runs of order 2 at 2001 times, 0 to 2 s>, 64, True)
    """

    ts: Float[np.ndarray, " times"]
    runs: Runs
    x: Float[np.ndarray, "runs times states"]
    desired: Float[np.ndarray, "runs times n"]
    e: Float[np.ndarray, "runs times n"]
    sigma: Float[np.ndarray, "runs times ..."]
    rho: Float[np.ndarray, "runs times ..."]
    u: Float[np.ndarray, "runs times ..."]
    d: Float[np.ndarray, "runs times ..."]
    axis: str = "derivative"

    def __len__(self) -> int:
        return len(self.runs)

    def to_xarray(self) -> Any:
        """The signals as an `xarray.Dataset` over run, t [s] and the derivative; needs the extra `notebook`."""
        error = "derivative" if self.sigma.ndim == 2 else "error"  # of several channels, one after the other
        axes = {"x": self.axis}
        wide = {name: (("run", "t", axes.get(name, error)), getattr(self, name)) for name in _PER_DERIVATIVE}
        flat = {name: (("run", "t", "channel")[: self.sigma.ndim], getattr(self, name)) for name in _SINGLE}
        coordinates = {
            "run": self.runs["index"],
            "t": ("t", self.ts, {"units": "s"}),
            error: np.arange(self.e.shape[-1]),
        }
        return as_dataset({**wide, **flat}, coordinates, {})

    __repr__ = short_repr

    def __str__(self) -> str:
        order, times = self.e.shape[-1], len(self.ts)
        return f"{len(self)} runs of order {order} at {times} times, {self.ts[0]:g} to {self.ts[-1]:g} s"


def signals(
    study: Study,
    indices: Sequence[int] | np.ndarray,
    seed: int = 0,
    *,
    ts: Float[np.ndarray, " times"] | Sequence[float] | None = None,
    sampling: AbstractSampling | None = None,
    settings: SolverSettings | None = None,
    block: int = LANE_MULTIPLE,
) -> SignalBatch:
    """Solves runs of a study again and gives their signals: one batch instead of one replay after the other.

    Args:
        study: The study.
        indices: Indices of the runs, at least one, any subset in any order; as in the column `index`.
        seed: Seed of the study.
        ts: Times [s], increasing, within the horizon of the nominal run; None for 2001 evenly spaced. What lies beyond
            the horizon of a run is NaN.
        sampling: Sampling of the study; None for `Random()`.
        settings: Method and tolerances; None for the defaults.
        block: Runs solved together, a multiple of 64.

    Returns:
        The signals; `len(ts) * (3 n + 4)` numbers of 8 bytes a run.

    Raises:
        InputError: An argument is out of range.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     return qj.Scenario(qj.paper.example1(), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)
        >>> batch = qj.signals(qj.Study(scenario, bandwidth=0.1), [3, 17], ts=[0.0, 0.5, 2.0])
        >>> batch.sigma.shape, batch.x.shape, bool((abs(batch.sigma) < batch.rho).all())
        ((2, 3), (2, 3, 2), True)
    """
    require_study(study)
    solver = BatchSolver(study, settings or SolverSettings(), block)
    sampling = sampling or Random()
    require_kind("sampling", sampling, AbstractSampling, "Use `qj.Random()` or the sampling of the study.")
    require(len(indices) > 0, "Argument `indices` must name at least one run, but is empty.")
    grid = grid_of(ts, study.nominal.t1)
    rows, solved, signals_of = [], [], []
    for piece in Planner(solver, seed, sampling).pieces(indices):
        record, solved_run = solver.call(solver.compile(piece.method, grid), piece.points, grid)
        rows.append(piece.rows)
        solved.append(table(study, piece.indices, record, solved_run.metrics))
        signals_of.append([signal[: len(piece.rows)] for signal in solved_run.signals])
    order = np.argsort(np.concatenate(rows))
    together = (np.concatenate(each)[order] for each in zip(*signals_of, strict=True))
    return SignalBatch(grid, concatenate(solved).take(order), *together, axis=study.nominal.loop.axis)

"""The one place that vmaps: a block of runs as one program, compiled once per study."""

import dataclasses
import functools as ft
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import jax
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import require, require_count, require_kind
from qsmc_jax.base.kept import kept
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.metrics.standard import Metrics
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.stiffness import method_for
from qsmc_jax.study.contents import Made
from qsmc_jax.study.one_run import run, run_along, stiffness_at
from qsmc_jax.study.runs import Runs
from qsmc_jax.study.study import Study
from qsmc_jax.tracing.compiled import traced
from qsmc_jax.tracing.platforms import platform

_Shapes: TypeAlias = tuple[tuple[int, ...], ...]
# Blocks of any multiple of this many lanes give bitwise the same rows, however the runs are cut into blocks.
LANE_MULTIPLE = 64


@dataclasses.dataclass(frozen=True)
class BatchSolver:
    """Programs that solve a fixed number of runs of one study together, one for each method.

    Attributes:
        study: The study.
        settings: Method and tolerances.
        count: Runs solved together, a multiple of 64.
    """

    study: Study
    settings: SolverSettings
    count: int

    def __post_init__(self):
        require_kind("settings", self.settings, SolverSettings, "Make one: `qj.SolverSettings(rtol=1e-8)`.")
        fits = self.count >= 1 and self.count % LANE_MULTIPLE == 0
        require(fits, f"Argument `block` must be a positive multiple of {LANE_MULTIPLE}, but is {self.count}.")

    def stiffness(self, points: Float[np.ndarray, "runs dim"]) -> Float[np.ndarray, " runs"]:
        """How stiff each of up to `count` runs will be."""
        # One program for blocks of all sizes, but for very large ones: it costs less to fill than to compile.
        solver = dataclasses.replace(self, count=max(self.count, platform().block))
        program = solver._made(_compiled, _stiffness, ())
        with in_64_bits():
            return np.asarray(program(solver._filled(points), self.study.numbers))[: len(points)]

    def compile(self, method: str, *grid: np.ndarray) -> Callable[..., Any]:
        """The program: of rows, or given times, of signals at them.

        Compiled on the first call, then the same one whatever values the names and tolerances have.
        """
        return self.compile_block(self._rows(method), *grid)

    def choices(self, method: str, **changes: Any) -> tuple[tuple[str, Any], ...]:
        """Name and value of what is static in the settings of a block; `compile_block` vectorises the whole of it.

        What is not differentiated is made for forward mode, which is the same to the last bit and traced in less time.
        """
        return self.settings.replace(method=method, vectorise=False, **changes).choices

    def compile_nominal(self) -> None:
        """The program that the nominal run needs, and with it most others."""
        self.compile(self.nominal_method)

    def trace_nominal(self) -> None:
        """The part of the same that needs Python, which does one thing at a time."""
        self._made(_traced, self._rows(self.nominal_method), self._given)

    @property
    def nominal_method(self) -> str:
        """The method for the nominal run."""
        nominal = self.study.stiffness
        return method_for(nominal, nominal, self.settings.method)

    def solve(self, indices: np.ndarray, points: Float[np.ndarray, "runs dim"], method: str) -> Runs:
        """The rows of up to `count` runs. Lanes left over repeat the first run and are dropped."""
        return table(self.study, indices, *self.call(self.compile(method), points))

    def compile_block(self, block: Callable[..., Any], *more: np.ndarray) -> Callable[..., Any]:
        """The program of a block, given points, values, bandwidth, tolerances, and what else such a block takes."""
        return self._made(_compiled, block, (*self._given, *map(np.shape, more)))

    def call(self, program: Callable[..., Any], points: Float[np.ndarray, "runs dim"], *more: np.ndarray) -> Any:
        """What such a program makes of up to `count` points, on the host; rows beyond them mean nothing."""
        numbers = as_float64(self.study.bandwidth), self.settings.rtol, self.settings.atol
        with in_64_bits():
            return jax.device_get(program(self._filled(points), self.study.numbers, *numbers, *more))

    @property
    def _given(self) -> _Shapes:
        """Shapes of the bandwidth and the tolerances, which every block of rows is given."""
        return np.shape(self.study.bandwidth), (), ()

    def _rows(self, method: str) -> "_Block":
        return _Block(self.choices(method, adjoint="forward"))

    def _made(self, make: Callable[..., Any], block: Callable[..., Any], rest: "_Shapes") -> Callable[..., Any]:
        """What `_traced` or `_compiled` makes of a block."""
        study, vectorise = self.study, self.settings.vectorise
        return make(block, study.made, self._shapes(), study.dimension, self.count, rest, vectorise)

    def _filled(self, points: Float[np.ndarray, "runs dim"]) -> Float[np.ndarray, "lanes dim"]:
        """The points, and the first again for every lane left over."""
        return np.concatenate([points, np.repeat(points[:1], self.count - len(points), axis=0)])

    def _shapes(self) -> tuple[tuple[str, tuple[int, ...]], ...]:
        """Name and shape of each of the study's numbers."""
        return tuple((name, value.shape) for name, value in self.study.numbers.items())


def thread_count(threads: int | None) -> int:
    """Blocks to be solved at the same time; None stands for what suits the platform."""
    count = platform().threads if threads is None else threads
    require_count("threads", count)
    return count


def block_size(block: int | None) -> int:
    """Runs to be solved together; None stands for what suits the platform."""
    return platform().block if block is None else block


# What compiles the last few programs traced: it takes memory, and is asked for once more at most.
@kept(maxsize=2)
def _traced(
    block: Callable[..., Any],
    scenario: Made,
    shapes: tuple[tuple[str, tuple[int, ...]], ...],
    dim: int,
    count: int,
    rest: _Shapes,
    vectorise: bool,
) -> Callable[[], Callable[..., Any]]:
    """What compiles the program of `block(scenario, points, values, *rest)` for arguments of the given shapes."""
    scenario.require_unchanged()
    with in_64_bits():
        points = jax.ShapeDtypeStruct((count, dim), np.float64)
        values = {name: jax.ShapeDtypeStruct(shape, np.float64) for name, shape in shapes}
        others = (jax.ShapeDtypeStruct(shape, np.float64) for shape in rest)
        return traced(ft.partial(block, scenario), points, values, *others, vectorise=vectorise)


@kept(maxsize=64)
def _compiled(*what: Any) -> Callable[..., Any]:
    """The program of what `_traced` is given."""
    with in_64_bits():
        return _traced(*what)()


def _stiffness(
    scenario: Made, points: Float[Array, "lanes dim"], values: Mapping[str, Array]
) -> Float[Array, " lanes"]:
    return jax.vmap(ft.partial(stiffness_at, scenario, values))(points)


@dataclasses.dataclass(frozen=True)
class _Block:
    """Solves runs together, and reads their signals at times that it may be given.

    Made twice of equal settings it is equal, so that nothing is compiled twice.
    """

    choices: tuple[tuple[str, Any], ...]

    def __call__(
        self,
        scenario: Made,
        points: Float[Array, "lanes dim"],
        values: Mapping[str, Array],
        bandwidth: Float[Array, "..."],
        rtol: Float[Array, ""],
        atol: Float[Array, ""],
        *grid: Float[Array, " times"],
    ) -> tuple[dict[str, Array], Any]:
        solve = run_along if grid else run
        settings = SolverSettings(rtol, atol, **dict(self.choices))
        return jax.vmap(ft.partial(solve, scenario, settings, bandwidth, *grid, values))(points)


def table(study: Study, indices: np.ndarray, record: Mapping[str, np.ndarray], metrics: Metrics) -> Runs:
    """The rows of the runs asked for, drawn values first."""
    rows = len(indices)
    columns = {"index": np.asarray(indices, np.int64)}
    for spec in study.specs:
        flat = record[spec.name].reshape(len(record[spec.name]), -1)
        columns.update({name: flat[:rows, i] for i, name in enumerate(spec.columns)})
    names = tuple(columns)[1:]
    columns.update({name: value[:rows] for name, value in metrics.columns().items()})
    return Runs(columns, names, study.records)

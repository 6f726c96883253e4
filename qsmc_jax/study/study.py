"""A study: scenarios drawn from the unit cube, and the bandwidth they are judged by."""

import contextlib
import dataclasses
import functools as ft
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_kind, show
from qsmc_jax.base.module import AbstractModule, as_float64, float_field, require_fields
from qsmc_jax.base.precision import entry_point
from qsmc_jax.display.short_repr import short_repr
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.metrics.check import check_measures, records_in
from qsmc_jax.metrics.claims import STATEMENTS, TOGETHER, claims_of_channels, margin_column, verdict_column
from qsmc_jax.metrics.metric import AbstractMeasure, AbstractMetric
from qsmc_jax.metrics.record import Record
from qsmc_jax.metrics.requirements import Required, Requirement
from qsmc_jax.metrics.standard import USUAL, asked_for, record_of
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.simulation.settings import SolverSettings
from qsmc_jax.simulation.signals import grid_of, signals_at_start
from qsmc_jax.simulation.stiffness import BY_STIFFNESS, method_for
from qsmc_jax.simulation.trajectory import (
    Trajectory,
    check_bandwidth,
    check_functions,
    check_start,
    simulate_drawn,
    trajectory,
)
from qsmc_jax.study.contents import Contents, Made, contents
from qsmc_jax.study.draw import Draw, discover
from qsmc_jax.study.one_run import program, run_along, stiffness_at
from qsmc_jax.study.sampling import AbstractSampling, Random
from qsmc_jax.study.specs import TABLE_COLUMNS, DrawSpec, check_values, dimension


class Scenario(AbstractModule):
    """One run to be made: a loop, its start and its horizon.

    Attributes:
        loop: The closed loop.
        x0: The start, n numbers.
        t1: The horizon [s], positive.

    Raises:
        InputError: `x0` does not fit the plant, or a number is not finite, or `t1` is not positive.

    Examples:
        >>> import qsmc_jax as qj
        >>> scenario = qj.Scenario(qj.paper.example1(), x0=[0.9, 0.9], t1=20.0)
        >>> scenario.loop.order, scenario.x0.tolist()
        (2, [0.9, 0.9])
    """

    loop: ClosedLoop | MultivariableLoop
    x0: Float[Array, " n"] = float_field()
    t1: Float[Array, ""] = float_field()

    def __check_init__(self):
        require_fields(self)
        check_start(self.loop, self.x0, self.t1)


# Runs whose horizons are looked at where a window must not lie beyond all.
_TRIED = 8
# How to come by a study.
HINT = "Make one: `qj.Study(scenario, bandwidth=...)`."


@dataclasses.dataclass(frozen=True, eq=False)
class Study:
    """A scenario function, the names it draws, and the bandwidth of quasi-sliding mode.

    Everything one may ask of it, Monte Carlo, replay, sweeps or tuning, is a choice of values for its names.

    Attributes:
        scenario: A function `scenario(draw) -> Scenario`, pure and traceable by JAX.
        bandwidth: Bandwidth epsilon, rho_inf < epsilon < rho0 (C2), in units of the sliding variable; with several
            inputs one for all channels, or one for each.
        values: Numbers substituted for names, by name; see `substitute`.
        metrics: What tables of its runs tell: "standard" for all that is known of a run; "claims" for no more than
            verdicts need, in less time; or a list of such words, of names of standard metrics as in
            `qj.metrics.catalogue()`, and of metrics of one's own, see `qj.metrics`. A list of the last alone adds them
            to the standard ones.
        requirements: Requirements of one's own by their names, made by `qj.always` and `qj.eventually`: claims beside
            those of Theorem 1, with the columns `verdict_NAME` and `margin_NAME`.
        specs: What is known of each name; found by calling the scenario.
        nominal: The scenario with every distribution at its median.
        contents: Hashes of what it computes, by part, with all that it reads from outside.

    Raises:
        InputError: The scenario is not one, a name or value is wrong, or the nominal loop breaks C2.

    Examples:
        >>> import qsmc_jax as qj
        >>> def scenario(draw):
        ...     funnel = qj.Funnel(rho0=4.0, mu=draw.parameter("mu", 3.0, bounds=(0.5, 10.0)), rho_inf=0.05)
        ...     control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), funnel)
        ...     plant = qj.plants.InvertedPendulum(mass=draw.uniform("mass", 0.008, 0.012))
        ...     loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Zero(), control)
        ...     return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=20.0)
        >>> study = qj.Study(scenario, bandwidth=0.1)
        >>> [spec.name for spec in study.specs]
        ['mu', 'mass', 'x0']
    """

    scenario: Callable[[Draw], Scenario]
    bandwidth: float | Sequence[float]
    values: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    metrics: Any = "standard"
    requirements: Any = dataclasses.field(default_factory=dict)
    specs: tuple[DrawSpec, ...] = dataclasses.field(init=False)
    nominal: Scenario = dataclasses.field(init=False)
    contents: Contents = dataclasses.field(init=False)

    __repr__ = short_repr

    def __str__(self) -> str:
        fixed = f"; fixed: {', '.join(self.values)}" if self.values else ""
        names = ", ".join(spec.name for spec in self.specs) or "no names"
        return f"{names}; bandwidth {show(as_float64(self.bandwidth))}{fixed}"

    def __post_init__(self):
        require(callable(self.scenario), f"Argument `scenario` must be a function of `draw`, but is {self.scenario!r}.")
        object.__setattr__(self, "bandwidth", _plain(self.bandwidth))
        object.__setattr__(self, "specs", discover(ft.partial(_scenario_of, self.scenario))[0])
        object.__setattr__(self, "metrics", _metrics(self.metrics))
        object.__setattr__(self, "requirements", _requirements(self.requirements))
        self._take(self.values)
        if self.measures:
            self._check_measures()
        object.__setattr__(self, "contents", contents(self.scenario, self.measures))

    def _check_measures(self) -> None:
        start = signals_at_start(self.nominal.loop, self.nominal.x0)
        drawn = [column for spec in self.specs for column in spec.columns]
        claims = (*STATEMENTS, *claims_of_channels(len(self.nominal.loop.channels)), TOGETHER)
        taken = [*TABLE_COLUMNS, *map(verdict_column, claims), *drawn]
        parts = [part for measure in self.measures for part in measure.parts]
        ends = [end for part in parts for end in (part.after, part.before) if np.isfinite(end)]
        horizon = float(self.nominal.t1)
        check_measures(self.measures, start, horizon if max(ends) < horizon else self._longest_horizon(), taken)

    def _longest_horizon(self) -> float:
        """The longest horizon [s] of the nominal run and a few others, of those that make a loop."""
        found = [float(self.nominal.t1)]
        for point in Random().points(0, range(_TRIED), self.dimension):
            with contextlib.suppress(ValueError):
                found.append(float(_call(self.scenario, Draw(point, self.values)).t1))
        return max(found)

    @property
    def claims(self) -> tuple[str, ...]:
        """The claims that its runs are judged by: the three of Theorem 1, also by channel, and its requirements."""
        return (*STATEMENTS, *claims_of_channels(len(self.nominal.loop.channels)), *self.requirements)

    @property
    def own_metrics(self) -> tuple[AbstractMetric, ...]:
        """Those of its metrics that are not standard."""
        return tuple(each for each in self.metrics if not isinstance(each, str))

    @property
    def standard(self) -> tuple[str, ...]:
        """The names of the standard metrics that it asks for."""
        return asked_for(self.asked)

    @property
    def asked(self) -> tuple[str, ...]:
        """The words by which it asks for them."""
        return tuple(each for each in self.metrics if isinstance(each, str))

    @property
    def measured(self) -> tuple[str, ...]:
        """The columns of its own metrics, and of the margins of its requirements."""
        return (*(each.name for each in self.own_metrics), *map(margin_column, self.requirements))

    @property
    def measures(self) -> tuple[AbstractMeasure, ...]:
        """Its own metrics and its requirements."""
        return (*self.own_metrics, *(Required(*each) for each in self.requirements.items()))

    def _take(self, values: Mapping[str, Any]) -> None:
        """Checks the values and what the scenario makes of them, and keeps both."""
        values = check_values(self.specs, values)
        nominal = _call(self.scenario, Draw(None, values))
        check_functions(nominal.loop, nominal.x0, nominal.t1)
        check_bandwidth(nominal.loop, as_float64(self.bandwidth))
        object.__setattr__(self, "values", values)
        object.__setattr__(self, "nominal", nominal)

    def require_unchanged(self) -> None:
        """Raises `InputError` if what the scenario reads from outside, such as a global, is no longer what it was.

        Asked by whatever gives a verdict, and before a program is compiled.
        """
        self.made.require_unchanged()

    @property
    def made(self) -> Made:
        """The scenario with its contents: what its programs are known by."""
        return Made(self.scenario, self.contents, self.measures, self.standard)

    @ft.cached_property
    def records(self) -> dict[str, Record]:
        """What is known of the columns that this study alone has, by their names."""
        drawn = {column: Record(column, f"Drawn by the study: {s.kind}") for s in self.specs for column in s.columns}
        for measure in self.measures:
            drawn.update(records_in(measure, self.nominal.loop.sizes))
        return drawn

    def record_of(self, column: str) -> Record:
        """What is known of a column of its tables: unit, meaning, label of an axis.

        Args:
            column: The column.
        """
        return self.records.get(column) or record_of(column)

    @property
    def dimension(self) -> int:
        """Coordinates of the unit cube that a run takes."""
        return dimension(self.specs)

    @ft.cached_property
    def stiffness(self) -> float:
        """How stiff the nominal run is; see `stiffness` in simulation/stiffness.py."""
        return float(self._stiffness_at(self._median))

    @ft.cached_property
    def numbers(self) -> dict[str, Float[np.ndarray, "..."]]:
        """Every parameter and every substituted name, by name: data, so that no value is compiled in."""
        parameters = {spec.name: spec.nominal for spec in self.specs if spec.kind == "parameter"}
        return {name: as_float64(value) for name, value in sorted({**parameters, **self.values}.items())}

    def substitute(self, **values: Any) -> "Study":
        """The same study with the given names fixed: parameters at other values, or distributions at a number.

        Another value of the same names does not recompile.

        Args:
            **values: A number for each name to be fixed, or an array of the name's shape.

        Raises:
            InputError: A name does not exist (the nearest is suggested), or a value lies outside its bounds.
        """
        made = object.__new__(Study)
        for name in ("scenario", "bandwidth", "specs", "metrics", "requirements", "contents"):
            object.__setattr__(made, name, getattr(self, name))
        made._take({**self.values, **values})
        return made

    def asking(self, *names: str) -> "Study":
        """The same study, asking for other standard metrics; its own stay.

        Args:
            *names: "standard", "claims", or names of standard metrics.

        Raises:
            InputError: There is no such metric.
        """
        made = self.substitute()
        object.__setattr__(made, "metrics", _metrics((*names, *self.own_metrics)))
        return made

    def replay(
        self,
        index: int,
        seed: int = 0,
        *,
        sampling: AbstractSampling | None = None,
        ts: Float[np.ndarray, " times"] | None = None,
        settings: SolverSettings | None = None,
    ) -> Trajectory:
        """Solves run `index` of a Monte Carlo study again, in full.

        A run in which a distribution has arguments out of range is INADMISSIBLE and not begun; where it makes no loop,
        the nominal one stands in the result.

        Args:
            index: Index of the run, as in the column `index`.
            seed: Seed of the study.
            sampling: Sampling of the study; None for `Random()`.
            ts: Times [s] at which to give the signals; None for 2001 evenly spaced.
            settings: Method and tolerances; None for the defaults.
        """
        point = (sampling or Random()).points(seed, [index], self.dimension)[0]
        draw = Draw(point, self.values)
        try:
            made = _call(self.scenario, draw)
        except ValueError:
            if draw.is_valid:
                raise
            loop, x0, t1 = self.nominal.loop, self.nominal.x0, self.nominal.t1
            return simulate_drawn(loop, x0, t1, self.bandwidth, ts, settings, draw.is_valid)
        return self._solve(made, point, ts, settings)

    def simulate(
        self, *, ts: Float[np.ndarray, " times"] | None = None, settings: SolverSettings | None = None
    ) -> Trajectory:
        """Solves the nominal run: parameters as substituted, distributions at their medians.

        Args:
            ts: Times [s] at which to give the signals; None for 2001 evenly spaced.
            settings: Method and tolerances; None for the defaults.
        """
        return self._solve(self.nominal, self._median, ts, settings)

    def _solve(self, made: Scenario, point: np.ndarray, ts: Any, settings: SolverSettings | None) -> Trajectory:
        """Solves the run at a point, of which the scenario made this."""
        self.require_unchanged()
        settings = settings or SolverSettings()
        if settings.method in BY_STIFFNESS:
            own = 0.0 if is_traced(self.numbers) else float(self._stiffness_at(point))
            settings = settings.replace(method=method_for(own, self.stiffness, settings.method))
        ts, bandwidth = grid_of(ts, made.t1), as_float64(self.bandwidth)
        _, solved = program(run_along, self.made)(settings, bandwidth, ts, self.numbers, point)
        return trajectory(made.loop, bandwidth, ts, solved, self.measures)

    def _stiffness_at(self, point: np.ndarray) -> Any:
        return program(stiffness_at, self.made)(self.numbers, point)

    @property
    def _median(self) -> np.ndarray:
        return np.full(self.dimension, 0.5)


def _plain(bandwidth: Any) -> float | tuple[float, ...]:
    """A bandwidth as a plain number, or several, as files have it."""
    numbers = as_float64(bandwidth)
    require(
        bandwidth is not None and np.ndim(numbers) <= 1,
        f"Argument `bandwidth` must be one number, or one for each channel, but is {bandwidth!r}.",
    )
    return float(numbers) if np.ndim(numbers) == 0 else tuple(np.asarray(numbers).tolist())


def require_study(study: Any, name: str = "study") -> None:
    """Raises unless an argument is a study, whose scenario computes what it did when it was made."""
    require_kind(name, study, Study, HINT)
    study.require_unchanged()


def _metrics(given: Any) -> tuple[AbstractMetric | str, ...]:
    given = [given] if isinstance(given, str) else given
    is_list, found = isinstance(given, list | tuple), type(given).__name__
    require(is_list, f"Argument `metrics` must be a list of metrics, but is a `{found}`: write [...] around it.")
    names = [each for each in given if isinstance(each, str)]
    asked_for(names)
    for metric in (each for each in given if not isinstance(each, str)):
        require_kind("metrics", metric, AbstractMetric, "Use those of `qj.metrics`, such as `qj.metrics.Peak`.")
    return (*(names or USUAL), *(each for each in given if not isinstance(each, str)))


def _requirements(given: Any) -> dict[Any, Requirement]:
    found, hint = type(given).__name__, 'write {"name": qj.always(...)}'
    require(isinstance(given, Mapping), f"Argument `requirements` must be a dictionary, but is a `{found}`: {hint}.")
    for requirement in given.values():
        require_kind("requirements", requirement, Requirement, "Make them by `qj.always` and `qj.eventually`.")
    return dict(given)


def _scenario_of(scenario: Callable[[Any], Any], draw: Draw) -> Scenario:
    """What a scenario function returns, which must be a `Scenario`."""
    result = scenario(draw)
    found = type(result).__name__
    require(
        isinstance(result, Scenario),
        f"Argument `scenario` must return a `Scenario(loop, x0, t1)`, but returns a `{found}`.",
    )
    return result


_call = entry_point(_scenario_of)

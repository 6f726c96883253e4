r"""Rosenbrock methods for stiff loops: linearly implicit, so that no equation has to be solved by iteration.

With $J = \partial f / \partial y$ at the start of the step, each stage solves one linear system with the same matrix,
$(\frac{1}{h \gamma} I - J) k_i = f(t_0 + c_i h, y_0 + \sum_j a_{ij} k_j) + \frac{1}{h} \sum_j C_{ij} k_j
+ h d_i \frac{\partial f}{\partial t}$.

Source: Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.7 (the form above: eq. (7.25)).
"""

import dataclasses
import functools as ft
from typing import Any, ClassVar

import diffrax as dfx
import equinox as eqx
import jax
import jax.numpy as jnp

from qsmc_jax.base.types import RealScalarLike, Scalars
from qsmc_jax.enclosures.unseen import Nodes
from qsmc_jax.numerics.barrier import Barrier
from qsmc_jax.numerics.linear import Factors, eliminate, substitute
from qsmc_jax.solvers.explicit import weighted
from qsmc_jax.solvers.quartic_interpolation import QuarticInterpolation
from qsmc_jax.solvers.tsit5 import derivative_at_start

# Part of the error between the ends of a step that counts like one at its end, which stays.
_SHARE = 0.5


@dataclasses.dataclass(frozen=True)
class RosenbrockTableau:
    r"""The numbers of a stiffly accurate method: its last stage is the error estimate.

    Attributes:
        order: Order of the solution.
        gamma: The diagonal coefficient.
        a: Weights of the earlier stages in the argument of f, for stage 2 and on.
        c_matrix: Weights of the earlier stages on the right-hand side, for stage 2 and on.
        c: Times of the stages in the step.
        d: Weights of the time derivative.
        dense: Rows of the dense output, $y(\theta) = (1 - \theta) y_0 + \theta y_1 + \theta (1 - \theta)
            \sum_r \theta^r \sum_i D_{ri} k_i$.
    """

    order: int
    gamma: float
    a: tuple[tuple[float, ...], ...]
    c_matrix: tuple[tuple[float, ...], ...]
    c: tuple[float, ...]
    d: tuple[float, ...]
    dense: tuple[tuple[float, ...], ...]


class Rosenbrock(dfx.AbstractAdaptiveSolver):
    """A Rosenbrock method as a diffrax solver, for states that are tuples of scalars.

    One Jacobian a step, by forward mode, and one elimination, written out for the size of the state. The solver state
    is the derivative at the start of the next step.

    Attributes:
        tableau: `RODAS4` or `RODAS5P`.
        once: Around what the linear systems of many states use more than once; None for none.
    """

    tableau: RosenbrockTableau = eqx.field(static=True)
    once: Barrier | None = None

    term_structure: ClassVar = dfx.AbstractTerm
    interpolation_cls: ClassVar = QuarticInterpolation

    @property
    def nodes(self) -> Nodes:
        """Where in a step it looks: at its stages, and at the middle."""
        return _nodes(self.tableau)

    def order(self, terms: Any) -> int:
        return self.tableau.order

    def func(self, terms: Any, t0: RealScalarLike, y0: Scalars, args: Any) -> Scalars:
        return terms.vf(t0, y0, args)

    def init(self, terms: Any, t0: RealScalarLike, t1: RealScalarLike, y0: Scalars, args: Any) -> Scalars:
        return terms.vf(t0, y0, args)

    def step(
        self,
        terms: Any,
        t0: RealScalarLike,
        t1: RealScalarLike,
        y0: Scalars,
        args: Any,
        solver_state: Scalars,
        made_jump: Any,
    ) -> tuple[Scalars, Scalars, dict[str, Any], Scalars, dfx.RESULTS]:
        tableau, h = self.tableau, t1 - t0
        frequency = 1.0 / jnp.where(h > 0.0, h, 1.0)
        rates = derivative_at_start(terms, t0, y0, args, solver_state, made_jump)
        jacobian, time_rates = _linearised(terms, t0, y0, args)
        matrix = _iteration_matrix(jacobian, frequency / tableau.gamma)
        factors = eliminate(matrix, self.once if len(y0) > _FEW else None)
        drift = tuple(h * rate for rate in time_rates)
        stages = [substitute(factors, _plus(rates, drift, tableau.d[0]))]
        y1 = y0
        for a, c, node, d in zip(tableau.a, tableau.c_matrix, tableau.c[1:], tableau.d[1:], strict=True):
            y1 = _plus(y0, weighted(a, stages))
            rates = terms.vf(t1 if node == 1.0 else t0 + node * h, y1, args)
            sides = _plus(_plus(rates, weighted(c, stages), frequency), drift, d)
            stages.append(substitute(factors, sides))
        y1 = _plus(y1, stages[-1])
        dense = _dense(tableau, y0, y1, stages, frequency)
        between = _middle_error(terms, t0 + 0.5 * h, args, factors, dense, frequency)
        error = tuple(jnp.maximum(jnp.abs(a), _SHARE * jnp.abs(b)) for a, b in zip(stages[-1], between, strict=True))
        return y1, error, dense, terms.vf(t1, y1, args), dfx.RESULTS.successful


# Up to so many unknowns it costs less to work out some entries of the linear system twice than to keep them.
_FEW = 4


@ft.cache
def _nodes(tableau: RosenbrockTableau) -> Nodes:
    places = tuple(sorted({*tableau.c, 0.5}))
    return Nodes(places, few=(0.0, min(places, key=lambda place: abs(place - 0.45)), 1.0))


def _linearised(terms: Any, t: RealScalarLike, y: Scalars, args: Any) -> tuple[list[Scalars], Scalars]:
    """The columns of the Jacobian, and the derivative by time."""

    def column(j: int) -> Scalars:
        def along(yj: RealScalarLike) -> Scalars:
            return terms.vf(t, (*y[:j], yj, *y[j + 1 :]), args)

        return jax.jvp(along, (y[j],), (jnp.ones_like(y[j]),))[1]

    time_rates = jax.jvp(lambda s: terms.vf(s, y, args), (t,), (jnp.ones_like(t),))[1]
    return [column(j) for j in range(len(y))], time_rates


def _iteration_matrix(columns: list[Scalars], diagonal: RealScalarLike) -> list[list[RealScalarLike]]:
    """The rows of `diagonal` I - J."""
    size = range(len(columns))
    return [[(diagonal if i == j else 0.0) - columns[j][i] for j in size] for i in size]


def _plus(x: Scalars, y: Scalars, factor: RealScalarLike = 1.0) -> Scalars:
    """The sum of `x` and `factor` times `y`."""
    if isinstance(factor, float) and factor in (0.0, 1.0):
        return x if factor == 0.0 else tuple(a + b for a, b in zip(x, y, strict=True))
    return tuple(a + factor * b for a, b in zip(x, y, strict=True))


def _dense(
    tableau: RosenbrockTableau, y0: Scalars, y1: Scalars, stages: list[Scalars], frequency: RealScalarLike
) -> dict[str, Scalars]:
    """The method's own dense output by its ends and its middle: in a stiff step, f there would magnify the error."""
    first, *others = (weighted(row, stages) for row in tableau.dense)
    rise, middle = _plus(y1, y0, -1.0), tuple(0.5 * (a + b) for a, b in zip(y0, y1, strict=True))
    fall, middle = first, _plus(middle, first, 0.25)
    for power, row in enumerate(others, start=1):
        fall, middle = _plus(fall, row), _plus(middle, row, 0.25 * 0.5**power)
    starts, ends = _plus(rise, first), _plus(rise, fall, -1.0)
    dy0, dy1 = (tuple(frequency * slope for slope in slopes) for slopes in (starts, ends))
    return {"y0": y0, "y1": y1, "dy0": dy0, "dy1": dy1, "middle": middle}


def _middle_error(
    terms: Any, t: RealScalarLike, args: Any, factors: Factors, dense: dict[str, Scalars], frequency: RealScalarLike
) -> Scalars:
    """The error of the dense output at the middle of the step: its defect there, through the step's own linear system.

    In a stiff step the error estimate, which is one for the end, knows nothing of it.
    """
    ends = zip(dense["y0"], dense["y1"], dense["dy0"], dense["dy1"], strict=True)
    slopes = tuple(1.5 * frequency * (b - a) - 0.25 * (m0 + m1) for a, b, m0, m1 in ends)
    return substitute(factors, _plus(terms.vf(t, dense["middle"], args), slopes, -1.0))


# Source: Hairer and Wanner, Solving Ordinary Differential Equations II, section IV.7, Table 7.3; code RODAS.
RODAS4 = RosenbrockTableau(
    order=4,
    gamma=0.25,
    a=(
        (1.544,),
        (0.9466785280815826, 0.2557011698983284),
        (3.314825187068521, 2.896124015972201, 0.9986419139977817),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950),
        (1.221224509226641, 6.019134481288629, 12.53708332932087, -0.6878860361058950, 1.0),
    ),
    c_matrix=(
        (-5.6688,),
        (-2.430093356833875, -0.2063599157091915),
        (-0.1073529058151375, -9.594562251023355, -20.47028614809616),
        (7.496443313967647, -10.24680431464352, -33.99990352819905, 11.70890893206160),
        (8.083246795921522, -7.981132988064893, -31.52159432874371, 16.31930543123136, -6.058818238834054),
    ),
    c=(0.0, 0.386, 0.21, 0.63, 1.0, 1.0),
    d=(0.25, -0.1043, 0.1035, -0.0362, 0.0, 0.0),
    dense=(
        (10.12623508344586, -7.487995877610167, -34.80091861555747, -7.992771707568823, 1.025137723295662),
        (-0.6762803392801253, 6.087714651680015, 16.43084320892478, 24.76722511418386, -6.594389125716872),
    ),
)
# Source: Steinebach (2023), Construction of Rosenbrock-Wanner method Rodas5P and numerical benchmarks within the Julia
# Differential Equations package, BIT Numerical Mathematics 63.
_LAST = (-7.502846399306121, 2.561846144803919, -11.627539656261098, -0.18268767659942256, 0.030198172008377946)
RODAS5P = RosenbrockTableau(
    order=5,
    gamma=0.21193756319429014,
    a=(
        (3.0,),
        (2.849394379747939, 0.45842242204463923),
        (-6.954028509809101, 2.489845061869568, -10.358996098473584),
        (2.8029986275628964, 0.5072464736228206, -0.3988312541770524, -0.04721187230404641),
        _LAST,
        (*_LAST, 1.0),
        (*_LAST, 1.0, 1.0),
    ),
    c_matrix=(
        (-14.155112264123755,),
        (-17.97296035885952, -2.859693295451294),
        (147.12150275711716, -1.41221402718213, 71.68940251302358),
        (165.43517024871676, -0.4592823456491126, 42.90938336958603, -5.961986721573306),
        (24.854864614690072, -3.0009227002832186, 47.4931110020768, 5.5814197821558125, -0.6610691825249471),
        (
            30.91273214028599,
            -3.1208243349937974,
            77.79954646070892,
            34.28646028294783,
            -19.097331116725623,
            -28.087943162872662,
        ),
        (
            37.80277123390563,
            -3.2571969029072276,
            112.26918849496327,
            66.9347231244047,
            -40.06618937091002,
            -54.66780262877968,
            -9.48861652309627,
        ),
    ),
    c=(0.0, 0.6358126895828704, 0.4095798393397535, 0.9769306725060716, 0.4288403609558664, 1.0, 1.0, 1.0),
    d=(
        0.21193756319429014,
        -0.42387512638858027,
        -0.3384627126235924,
        1.8046452872882734,
        2.325825639765069,
        0.0,
        0.0,
        0.0,
    ),
    dense=(
        (
            25.948786856663858,
            -2.5579724845846235,
            10.433815404888879,
            -2.3679251022685204,
            0.524948541321073,
            1.1241088310450404,
            0.4272876194431874,
            -0.17202221070155493,
        ),
        (
            -9.91568850695171,
            -0.9689944594115154,
            3.0438037242978453,
            -24.495224566215796,
            20.176138334709044,
            15.98066361424651,
            -6.789040303419874,
            -6.710236069923372,
        ),
        (
            11.419903575922262,
            2.8879645146136994,
            72.92137995996029,
            80.12511834622643,
            -52.072871366152654,
            -59.78993625266729,
            -0.15582684282751913,
            4.883087185713722,
        ),
    ),
)

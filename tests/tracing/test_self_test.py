"""What batches are compiled with gets every elementary function right, and a compiler that does not is found out."""

import jax
import jax.numpy as jnp
import mpmath as mp
import numpy as np
import pytest
from typer.testing import CliRunner

import qsmc_jax as qj
from qsmc_jax.cli.main import app
from qsmc_jax.study.batches import BatchSolver
from qsmc_jax.tracing import self_test
from qsmc_jax.tracing.compiled import compiled
from qsmc_jax.tracing.self_test import ELEMENTARY, arguments, batch, wrong_functions
from qsmc_jax.tracing.vectorise import is_vectorised, vectorised
from studies_for_tests import Integrator

TRUTH = {
    "sin": mp.sin,
    "cos": mp.cos,
    "tan": mp.tan,
    "arcsin": mp.asin,
    "arccos": mp.acos,
    "arctan": mp.atan,
    "arctan2": mp.atan2,
    "sinh": mp.sinh,
    "cosh": mp.cosh,
    "tanh": mp.tanh,
    "arcsinh": mp.asinh,
    "arccosh": mp.acosh,
    "arctanh": mp.atanh,
    "exp": mp.exp,
    "exp2": lambda x: mp.power(2, x),
    "expm1": mp.expm1,
    "log": mp.log,
    "log2": lambda x: mp.log(x, 2),
    "log10": mp.log10,
    "log1p": mp.log1p,
    "sqrt": mp.sqrt,
    "rsqrt": lambda x: 1 / mp.sqrt(x),
    "cbrt": lambda x: mp.sign(x) * mp.cbrt(abs(x)),
    "power": mp.power,
    "hypot": mp.hypot,
    "divide": mp.fdiv,
    "sigmoid": lambda x: 1 / (1 + mp.exp(-x)),
    "softplus": lambda x: mp.log1p(mp.exp(x)),
    "logaddexp": lambda x, y: mp.log(mp.exp(x) + mp.exp(y)),
    "erf": mp.erf,
    "erfc": mp.erfc,
    "ndtr": mp.ncdf,
    "ndtri": lambda p: -mp.sqrt(2) * mp.erfinv(1 - 2 * p),
    "gammaln": mp.loggamma,
    "floor": mp.floor,
    "ceil": mp.ceil,
    "round": mp.nint,
    "trunc": lambda x: mp.sign(x) * mp.floor(abs(x)),
    "sign": mp.sign,
    "abs": abs,
    "maximum": max,
    "minimum": min,
    "fmod": lambda x, y: x - y * mp.sign(x * y) * mp.floor(abs(x / y)),
    "mod": lambda x, y: x - y * mp.floor(x / y),
}


def errors(function, truth, lanes, vectorise):
    """In units in the last place of the true values."""
    values = batch(function, lanes, vectorise)
    with mp.workdps(50):
        exact = [truth(*map(mp.mpf, map(float, x))) for x in zip(*arguments(function, lanes), strict=True)]
        pairs = zip(values, exact, strict=True)
        return [float(abs(mp.mpf(float(got)) - true)) / np.spacing(abs(float(true))) for got, true in pairs]


@pytest.mark.parametrize("vectorise", [True, False], ids=["vectorised", "plain"])
@pytest.mark.parametrize("name", TRUTH)
@pytest.mark.slow
def test_elementary_functions_are_right_in_a_batch(name, vectorise):
    """Within the units in the last place that the table allows: 4, or more where JAX's formula loses digits."""
    for lanes in (1, 3, 64, 512):
        assert max(errors(ELEMENTARY[name], TRUTH[name], lanes, vectorise)) <= ELEMENTARY[name].ulps, lanes


def test_every_function_has_a_truth():
    assert TRUTH.keys() == ELEMENTARY.keys()


@pytest.fixture
def careless(monkeypatch):
    """A compiler that rounds the exponentials of batches to float32: what a fault in one function looks like."""
    table = {name: ELEMENTARY[name] for name in ("exp", "sqrt", "arctan")}
    table["exp"] = table["exp"]._replace(fn=lambda x: jnp.exp(x).astype(np.float32).astype(np.float64))
    monkeypatch.setattr(self_test, "ELEMENTARY", table)


@pytest.mark.usefixtures("careless")
def test_a_function_that_is_wrong_is_named():
    assert wrong_functions(64) == ["exp", "exp (vectorise=False)"]


def test_nan_is_wrong(monkeypatch):
    table = {"log": ELEMENTARY["log"]._replace(fn=lambda x: jnp.where(x > 10.0, jnp.nan, jnp.log(x)))}
    monkeypatch.setattr(self_test, "ELEMENTARY", table)
    assert wrong_functions(64) == ["log", "log (vectorise=False)"]


@pytest.mark.slow
@pytest.mark.usefixtures("careless")
def test_doctor_names_what_is_wrong_and_fails():
    done = CliRunner().invoke(app, ["doctor", "--no-cache"])
    assert done.exit_code == 1, done.output
    assert "elementary functions under the batches' compiler options: wrong: exp, exp (vectorise=False)" in done.output


def options_of(monkeypatch, fn, vectorise, lanes=64):
    """What the compiler is told about the program of a function."""
    told = []

    def compile_nothing(self, compiler_options):
        told.append(compiler_options)
        return fn

    monkeypatch.setattr(jax.stages.Lowered, "compile", compile_nothing)
    compiled(fn, np.ones(lanes), vectorise=vectorise)
    return told[0]


def kernel(x):
    """An arctangent where the rewriter does not go: the combination of a general reduction."""
    return jax.lax.reduce(x, np.float64(0.0), lambda a, b: a + jnp.arctan(b), (0,))


CASES = {
    "arctan": (jnp.arctan, True, True),
    "arctan, plain": (jnp.arctan, False, False),
    "nothing to replace": (jnp.sqrt, True, True),
    "nothing to replace, plain": (jnp.sqrt, False, False),
    "arctan out of reach": (kernel, True, False),
    "arctan out of reach in a loop": (lambda x: jax.lax.map(kernel, jnp.stack([x, x])), True, False),
    "derivative": (jax.vmap(jax.grad(lambda x: jnp.sin(jnp.arctan(x)))), True, True),
}


@pytest.mark.parametrize(("fn", "vectorise", "is_wide"), CASES.values(), ids=CASES)
def test_only_programs_without_an_arctangent_of_jax_get_wide_vectors(monkeypatch, fn, vectorise, is_wide):
    assert ("xla_cpu_prefer_vector_width" in options_of(monkeypatch, fn, vectorise)) == is_wide


def solved(x):
    """A linear solve that holds programs in a named tuple."""
    return jax.lax.custom_linear_solve(
        lambda y: y * jnp.arctan(x), jnp.sin(x), lambda _, b: b / jnp.arctan(x), symmetric=True
    )


def test_the_rewriter_enters_linear_solves():
    assert is_vectorised(jax.make_jaxpr(vectorised(solved))(0.3))
    assert float(vectorised(solved)(0.3)) == pytest.approx(float(mp.sin(0.3) / mp.atan(0.3)), rel=1e-15)


def test_a_kernel_out_of_reach_is_reported():
    assert not is_vectorised(jax.make_jaxpr(vectorised(kernel))(np.ones(3)))


class Weak(qj.AbstractPlant):
    """An integrator whose gain is its state."""

    order = 1

    def drift(self, t, x):
        return 0.0 * x[0]

    def gain(self, t, x):
        return x[0]


def study_of(plant, error=lambda start: 0.2):
    """A study whose start is the arctangent of a drawn number; how far from the reference, as a function of it."""

    def scenario(draw):
        control = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(2.0, 1.0, 0.1))
        start = jnp.arctan(draw.uniform("a", 0.1, 0.9))
        loop = qj.ClosedLoop(plant, qj.references.Constant(start), qj.disturbances.Constant(0.3), control)
        return qj.Scenario(loop, x0=jnp.stack([start + error(start)]), t1=1.0)

    return qj.Study(scenario, bandwidth=0.2)


both_ways = pytest.mark.parametrize("vectorise", [True, False], ids=["vectorised", "plain"])


@both_ways
@pytest.mark.parametrize("count", [64, 512])
def test_an_arctangent_in_a_scenario_is_right_in_the_choice_of_a_method(count, vectorise):
    points = np.linspace(0.01, 0.99, count)[:, None]
    solver = BatchSolver(study_of(Weak()), qj.SolverSettings(vectorise=vectorise), count)
    gains = np.array([np.arctan(0.1 + 0.8 * u) for u in points[:, 0]])
    # Along the reference arctan(a) the gain is arctan(a), and the input |d| + |rho'| over it.
    ts = np.linspace(0.0, 1.0, 4001)
    rho = 2.0 * np.exp(-ts) + 0.1
    inputs = (0.3 + 2.0 * np.exp(-ts)) / gains[:, None]
    expected = np.trapezoid(gains[:, None] * np.pi / (2.0 * rho) * (1.0 + inputs**2), ts)
    np.testing.assert_allclose(solver.stiffness(points), expected, rtol=1e-2)
    assert len(np.unique(solver.stiffness(points))) == count


@pytest.mark.slow
@both_ways
def test_an_arctangent_in_a_scenario_is_right_in_every_run(vectorise):
    settings = qj.SolverSettings(vectorise=vectorise)
    study = study_of(Integrator(1.0), error=lambda start: 1.3 + start)
    runs = qj.monte_carlo(study, 64, block=64, settings=settings)
    # From there |sigma| / rho only falls: tan(pi z / 2) > 0.3 + 2 z for z > 0.66.
    np.testing.assert_allclose(runs["peak_ratio"], (1.3 + np.arctan(runs["a"])) / 2.1, rtol=1e-12)
    assert len(np.unique(runs["peak_ratio"])) == 64

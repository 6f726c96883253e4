"""Programs of a JAX that nobody knows yet: they are left as they are, or probed, and it is said; values stay right.

Such a JAX is one of today's whose programs are changed on the way, in one detail at a time.
"""

import ast
import math
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import qsmc_jax as qj
from qsmc_jax.cli.console import say
from qsmc_jax.cli.main import app
from qsmc_jax.cli.session import session
from qsmc_jax.cli.verbosity import telling
from qsmc_jax.enclosures.enclosure import CannotEncloseError, enclose
from qsmc_jax.enclosures.intervals import Interval
from qsmc_jax.enclosures.unseen import Nodes, Step, unseen
from qsmc_jax.model.derivatives import time_derivatives
from qsmc_jax.model.state_jumps import require_continuous
from qsmc_jax.tracing import programs, self_test, vectorise
from qsmc_jax.tracing.programs import Rewriter, UnknownProgramError, called, evaluated, loop, parts
from qsmc_jax.tracing.vectorise import is_vectorised, vectorised, why_not_vectorised
from studies_for_tests import Integrator

PACKAGE = Path(qj.__file__).parent
TABLE = jnp.linspace(0.0, 1.0, 4)


def test_only_one_file_knows_what_programs_are_made_of():
    """JAX documents none of these; `jax.extend` is where they live."""
    undocumented = {"eqns", "invars", "outvars", "constvars", "aval", "in_avals", "out_avals", "primitive"}
    for path in PACKAGE.rglob("*.py"):
        if path.name == "programs.py":
            continue
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            modules = [getattr(node, "module", None) or ""] if isinstance(node, ast.ImportFrom) else []
            modules += [each.name for each in node.names] if isinstance(node, ast.Import) else []
            assert not any(each.startswith(("jax.extend", "jax._src", "jax.interpreters")) for each in modules), path
            assert not (isinstance(node, ast.Attribute) and node.attr in undocumented), (path, node.attr)


# The rewriter


@pytest.fixture
def rewriter(monkeypatch):
    """One of its own, so that a problem is not remembered by other tests."""
    made = Rewriter(vectorise._REWRITER._functions)
    monkeypatch.setattr(vectorise, "_REWRITER", made)
    return made


def with_everything(x):
    """Sines in all that the rewriter enters."""
    in_a_loop = jax.lax.scan(lambda c, a: (jnp.sin(c) + a, jnp.cos(c)), x, TABLE)[0]
    return jax.jit(jnp.tan)(x) + jax.lax.cond(x > 0.0, jnp.sin, jnp.cos, x) + in_a_loop


def fresh():
    """The same as another function, which JAX has not traced before."""
    return lambda x: with_everything(x)


def expected(x):
    """The same in Python's floats."""
    state = x
    for a in np.linspace(0.0, 1.0, 4):
        state = math.sin(state) + a
    return math.tan(x) + (math.sin(x) if x > 0.0 else math.cos(x)) + state


class Changed:
    """What `jax.make_jaxpr` returns, with one attribute other than it was."""

    def __init__(self, program, name, value):
        self._program, self._name, self._value = program, name, value

    def __getattr__(self, name):
        if name == self._name:
            if isinstance(self._value, Exception):
                raise self._value
            return self._value
        return getattr(self._program, name)


STRANGE = {
    "no inside": ("jaxpr", AttributeError("no attribute `jaxpr`")),
    "without end": ("jaxpr", RecursionError("maximum recursion depth exceeded")),
    "can't be replaced": ("replace", TypeError("unexpected argument `eqns`")),
    "inside of another kind": ("jaxpr", 3),
}


def strange(monkeypatch, name, value):
    """From here on JAX makes programs with one attribute that is not as it was."""
    make = jax.make_jaxpr

    def made(fn, return_shape=False):
        def traced(*arguments):
            program, shape = make(fn, return_shape=True)(*arguments)
            program = Changed(program, name, value)
            return (program, shape) if return_shape else program

        return traced

    monkeypatch.setattr(jax, "make_jaxpr", made)


@pytest.mark.parametrize("change", STRANGE)
@pytest.mark.parametrize("transform", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_a_program_of_unknown_make_is_left_as_it_is_and_said(monkeypatch, rewriter, change, transform):
    strange(monkeypatch, *STRANGE[change])
    assert why_not_vectorised() == ""
    for x in (0.3, -0.8):
        assert float(transform(vectorised(fresh()))(x)) == pytest.approx(expected(x), rel=1e-14)
    assert f"does not know the programs of JAX {jax.__version__}" in why_not_vectorised()


def test_an_equation_of_unknown_make_is_left_as_it_is_and_said(monkeypatch, rewriter):
    def failing(self, raw):
        raise KeyError("num_consts")

    monkeypatch.setattr(Rewriter, "_equation", failing)
    assert float(jax.jit(vectorised(fresh()))(0.3)) == pytest.approx(expected(0.3), rel=1e-14)
    assert "KeyError: 'num_consts'" in why_not_vectorised()


def test_a_jax_without_the_parts_that_rewriting_needs_is_left_as_it_is(monkeypatch):
    monkeypatch.setattr(programs, "core", None)
    monkeypatch.setattr(programs, "_MISSING", "cannot import name 'core' from 'jax.extend'")
    monkeypatch.setattr(vectorise, "_REWRITER", Rewriter(vectorise._REWRITER._functions))
    assert float(jax.jit(vectorised(fresh()))(0.3)) == pytest.approx(expected(0.3), rel=1e-14)
    assert "cannot import name 'core'" in why_not_vectorised()


def test_with_the_programs_of_this_version_nothing_is_wrong(rewriter):
    assert is_vectorised(jax.make_jaxpr(vectorised(fresh()))(0.3))
    assert why_not_vectorised() == ""


def test_derivatives_of_what_is_left_as_it_is_are_right(monkeypatch, rewriter):
    strange(monkeypatch, *STRANGE["can't be replaced"])
    assert float(jax.grad(vectorised(jnp.tan))(0.3)) == pytest.approx(1.0 / math.cos(0.3) ** 2, rel=1e-14)
    assert why_not_vectorised()


def test_a_program_that_cannot_be_read_may_hold_slow_functions():
    """So it is not given the wide vectors that miscompile an arctangent."""
    for change in ("without end", "inside of another kind"):
        assert not is_vectorised(Changed(jax.make_jaxpr(jnp.sqrt)(0.3), *STRANGE[change]))
    assert is_vectorised(jax.make_jaxpr(jnp.sqrt)(0.3))


@pytest.mark.parametrize(("fn", "name", "may_hide"), [(jnp.exp, "exp", True), (jnp.argmax, "argmax", False)])
def test_an_operation_that_nobody_can_look_into_may_hold_a_slow_function_if_it_makes_numbers(
    monkeypatch, fn, name, may_hide
):
    before = programs._equation

    def opaque(raw):
        equation = before(raw)
        return equation._replace(name="call_hi_primitive", params={}) if equation.name == name else equation

    monkeypatch.setattr(programs, "_equation", opaque)
    assert is_vectorised(jax.make_jaxpr(jax.jit(fn))(np.ones(3))) == (not may_hide)


@pytest.mark.parametrize("problem", ["KeyError: 'num_consts'", ""])
def test_a_command_says_once_that_solves_are_slow_if_they_are(capsys, rewriter, problem):
    rewriter._problem = problem
    with telling([]), session(cache=False):
        say("{}")
    said = capsys.readouterr()
    assert said.out == "{}\n"
    assert said.err.count("Solves are right but slow") == (1 if problem else 0)
    assert said.err.count("\n") == (1 if problem else 0)


@pytest.mark.slow
def test_doctor_says_that_solves_are_slow(monkeypatch, rewriter):
    rewriter._problem = "KeyError: 'num_consts'"
    monkeypatch.setattr(self_test, "ELEMENTARY", {"sqrt": self_test.ELEMENTARY["sqrt"]})
    done = CliRunner().invoke(app, ["doctor", "--no-cache"])
    assert done.exit_code == 0, done.output
    assert "by vector instructions: Solves are right but slow" in done.output


# The walk


def scanned(t):
    return jax.lax.scan(lambda c, a: (c * t + a, c - a), 0.5, TABLE, reverse=True)[1].sum()


def branched(t):
    return jax.lax.cond(t > 0.4, jnp.sin, jnp.cos, t)


def called_inside(t):
    return jax.jit(lambda s: jnp.sin(3.0 * s))(t)


WALKED = {
    "scan": scanned,
    "cond": branched,
    "jit": called_inside,
    "reduce_sum": lambda t: jnp.sum(jnp.stack([t, -0.3 * t])),
    "integer_pow": lambda t: t**3,
    "exp": jnp.exp,
    "convert_element_type": lambda t: jnp.asarray(t > 0.5, float),
}


def renamed(params):
    return {f"new_{name}": value for name, value in params.items()}


def one_more(params):
    return {**params, "is_negated": True}


# No rule reads the parameters of `exp`, nor those of a call beside its program.
NO_MATTER = {("exp", renamed), ("jit", one_more), ("cond", one_more)}


@pytest.mark.parametrize(
    ("name", "change"), [(n, c) for n in WALKED for c in (renamed, one_more) if (n, c) not in NO_MATTER]
)
def test_an_operation_with_unknown_parameters_is_tried_within_the_box_and_named(monkeypatch, name, change):
    before = programs._equation

    def changed(raw):
        equation = before(raw)
        return equation._replace(params=change(equation.params)) if equation.name == name else equation

    monkeypatch.setattr(programs, "_equation", changed)
    # What an operation does is JAX's business, whatever its parameters are called.
    monkeypatch.setattr("qsmc_jax.enclosures.enclosure.computed", computed_by_jax)
    (found,), _, unknown = enclose(WALKED[name], Interval(jnp.asarray(0.2), jnp.asarray(0.9)))
    assert unknown == (name,)
    values = np.asarray(jax.vmap(WALKED[name])(np.array([0.2, 0.55, 0.9])))
    assert float(found.lo) <= values.min() + 1e-12
    assert float(found.hi) >= values.max() - 1e-12


def computed_by_jax(equation, operands):
    return programs.computed(equation._replace(params=equation.made_by_jax.params), operands)


@pytest.mark.parametrize("counts", [(0, 1), (1, 0), (2, 1), (1, 2), (0, 0)])
def test_a_loop_whose_parts_do_not_fit_is_none(monkeypatch, counts):
    """A count of constants or states that is not what it seems would give an enclosure of something else."""
    (equation,) = (each for each in parts(jax.make_jaxpr(scanned)(0.3)).equations if each.name == "scan")
    assert loop(equation)[3:] == (1, 1)
    monkeypatch.setattr(programs, "_counts", lambda equation: counts)
    assert loop(equation) is None


def test_a_call_of_another_number_of_inputs_is_none():
    (equation,) = (each for each in parts(jax.make_jaxpr(called_inside)(0.3)).equations if each.name == "jit")
    assert called(equation) is not None
    assert called(equation._replace(inputs=equation.inputs * 2)) is None


def unreadable(raw):
    return raw.there_is_no_such_thing


def test_what_cannot_be_read_is_probed(monkeypatch):
    monkeypatch.setattr(programs, "_equation", unreadable)
    with pytest.raises(CannotEncloseError):
        enclose(jnp.sin, Interval(jnp.asarray(0.1), jnp.asarray(0.2)))
    thirds = (0.0, 0.5, 1.0)
    found = unseen(lambda t: jnp.sin(40.0 * t), Step(0.0, 0.1, Nodes(thirds, few=thirds)))
    assert found.probed == ("a program of this version of JAX",)
    # Its crest lies at pi / 80, between two nodes; it is seen from a thirty-second of the step away or less.
    assert float(found.high) >= math.sin(math.pi / 2.0 + 40.0 * 0.1 / 32.0)


def test_a_plant_whose_program_cannot_be_read_passes_and_a_derivative_of_it_is_right(monkeypatch):
    monkeypatch.setattr(programs, "_equation", unreadable)
    derivatives = time_derivatives(lambda t: jnp.sin(2.0 * t), 0.3, 2)
    truth = [math.sin(0.6), 2.0 * math.cos(0.6), -4.0 * math.sin(0.6)]
    np.testing.assert_allclose(np.array(derivatives), truth, rtol=1e-14)
    require_continuous(Integrator(1.0), "drift")


def test_a_reference_whose_program_cannot_be_read_is_refused_with_a_remedy(monkeypatch):
    monkeypatch.setattr(programs, "_equation", unreadable)
    with pytest.raises(ValueError, match="with this version of JAX nobody can tell"):
        qj.references.Smooth(jnp.sin)


def test_reading_an_unknown_program_names_the_version():
    with pytest.raises(UnknownProgramError, match=rf"JAX {jax.__version__}"):
        evaluated(object(), [], programs.computed)

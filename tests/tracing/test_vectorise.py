"""Rewritten functions against the functions themselves: equal values and derivatives, and nothing slow left."""

import functools as ft

import diffrax as dfx
import equinox as eqx
import jax
import jax.extend.core
import jax.numpy as jnp
import numpy as np
import pytest

from qsmc_jax.base.module import AbstractModule, float_field
from qsmc_jax.tracing.programs import dtype_of, parts, programs_in
from qsmc_jax.tracing.vectorise import vectorised

SLOW = {"sin", "cos", "tan", "atan"}
POINTS = np.array([-1.3, -0.2, 0.4, 2.1])
RTOL = 1e-14


@jax.custom_jvp
def with_rule(x):
    return jnp.sin(x)


@with_rule.defjvp
def _with_rule_jvp(primals, tangents):
    # Thrice the derivative, so that dropping the rule shows.
    return with_rule(primals[0]), 3.0 * jnp.cos(primals[0]) * tangents[0]


@jax.custom_vjp
def with_backward(x):
    return jnp.tan(x)


with_backward.defvjp(lambda x: (jnp.tan(x), jnp.sin(x)), lambda residual, y_bar: (5.0 * residual * y_bar,))


def scanned(x):
    return jax.lax.scan(lambda c, a: (jnp.sin(c) + a, jnp.cos(c)), x, jnp.linspace(0.0, 1.0, 4))[0]


def looped(x):
    return jax.lax.while_loop(lambda c: jnp.cos(c) > 0.2, lambda c: c + 0.1 * jnp.cos(c), x)


def branched(x):
    return jax.lax.cond(x > 0.0, jnp.sin, lambda y: jnp.tan(0.3 * y), x)


def switched(x):
    return jax.lax.switch(jnp.int32(x), [jnp.sin, jnp.cos, jnp.arctan], x)


def in_vector(x):
    return jnp.sum(jax.vmap(jnp.tan)(x * jnp.array([0.1, 0.3])))


FUNCTIONS = {
    "all four": lambda x: jnp.sin(x) + jnp.cos(x) * jnp.tan(0.4 * x) + jnp.arctan(x),
    "jit": jax.jit(lambda x: jax.jit(jnp.sin)(2.0 * x) * x),
    "scan": scanned,
    "cond": branched,
    "switch": switched,
    "checkpoint": jax.checkpoint(lambda x: jnp.sin(jnp.cos(x))),
    "vmap inside": in_vector,
    "grad inside": jax.grad(lambda x: jnp.sin(x) * jnp.arctan(x)),
    "custom_jvp": with_rule,
    "custom_jvp in a jit of a scan": jax.jit(lambda x: jax.lax.scan(lambda c, _: (with_rule(c), None), x, length=2)[0]),
    "sinc": jnp.sinc,
    "constant operand": lambda x: x * jnp.sin(1.0),
}
REVERSE_ONLY = {"custom_vjp": with_backward}
FORWARD_ONLY = {"while": looped}


def table(*kinds):
    items = {name: f for kind in kinds for name, f in kind.items()}
    return pytest.mark.parametrize("f", items.values(), ids=items.keys())


def primitives(program):
    """Names of the primitives with a float64 operand, at any depth."""
    for equation in parts(program).equations:
        if any(dtype_of(each) == np.float64 for each in equation.inputs):
            yield equation.name
        for inner in programs_in(equation.params):
            yield from primitives(inner)


def names_used(f, *args):
    return set(primitives(jax.make_jaxpr(f)(*args)))


def compare(f, transform, rtol=RTOL, atol=0.0):
    """The transformed function at all points at once, with and without the rewriting."""
    values = [jax.jit(jax.vmap(transform(g)))(POINTS) for g in (vectorised(f), f)]
    np.testing.assert_allclose(*values, rtol=rtol, atol=atol)


@table(FUNCTIONS, REVERSE_ONLY, FORWARD_ONLY)
def test_values_agree(f):
    compare(f, lambda g: g)


@table(FUNCTIONS, REVERSE_ONLY, FORWARD_ONLY)
def test_values_agree_without_jit_and_vmap(f):
    np.testing.assert_allclose(vectorised(f)(0.4), f(0.4), rtol=RTOL)


@table(FUNCTIONS, REVERSE_ONLY)
def test_reverse_derivatives_agree(f):
    compare(f, jax.grad)


@table(FUNCTIONS, FORWARD_ONLY)
def test_forward_derivatives_agree(f):
    compare(f, jax.jacfwd)


@table({name: FUNCTIONS[name] for name in ("all four", "jit", "scan", "sinc", "custom_jvp")})
def test_second_derivatives_agree(f):
    compare(f, lambda g: jax.grad(jax.grad(g)), rtol=1e-12, atol=1e-13)


@table(FUNCTIONS, REVERSE_ONLY, FORWARD_ONLY)
def test_nothing_slow_is_left(f):
    assert names_used(f, 0.3) & SLOW or f is jnp.sinc  # which newer versions take from a polynomial
    assert not names_used(vectorised(f), 0.3) & SLOW


@table({"reverse": jax.grad(with_rule), "forward": lambda x: jax.jvp(with_rule, (x,), (1.0,))[1]})
def test_nothing_slow_is_left_in_a_derivative_rule_inside(f):
    assert not names_used(vectorised(f), 0.3) & SLOW


@table({name: FUNCTIONS[name] for name in ("custom_jvp", "sinc", "scan")})
def test_nothing_slow_is_left_in_derivatives_outside(f):
    assert not names_used(jax.jacfwd(vectorised(f)), 0.3) & SLOW


@table({"gelu": jax.nn.gelu, "softplus": jax.nn.softplus, "relu": jax.nn.relu, "tanh": jnp.tanh})
def test_functions_without_trigonometry_are_unchanged(f):
    assert str(jax.make_jaxpr(vectorised(f))(0.3)) == str(jax.make_jaxpr(f)(0.3))
    np.testing.assert_array_equal(vectorised(f)(0.3), f(0.3))


@pytest.mark.skipif(not hasattr(jax.extend.core, "check_jaxpr"), reason="this version of JAX does not check programs")
def test_the_rewritten_program_is_well_typed():
    jax.extend.core.check_jaxpr(jax.make_jaxpr(vectorised(lambda x: scanned(x) + branched(x)))(0.3).jaxpr)


def test_other_dtypes_are_left_alone():
    assert "sin" in str(jax.make_jaxpr(vectorised(jnp.sin))(np.float32(0.3)))
    np.testing.assert_array_equal(vectorised(jnp.sin)(np.float32(0.3)), jnp.sin(np.float32(0.3)))


def test_unknown_primitives_are_left_alone():
    def called_back(x):
        return jax.pure_callback(np.sin, jax.ShapeDtypeStruct((), np.float64), x) + jnp.cos(x)

    np.testing.assert_allclose(vectorised(called_back)(0.3), np.sin(0.3) + np.cos(0.3), rtol=RTOL)


def saved_at(ts, message=""):
    """e^-t at these times; with a message also a check of one's own that fails."""
    ts = eqx.error_if(ts, ts[0] > 0.2, message) if message else ts
    term, options = dfx.ODETerm(lambda t, y, args: -y), {"saveat": dfx.SaveAt(ts=ts), "throw": False}
    return dfx.diffeqsolve(term, dfx.Tsit5(), 0.0, 1.0, 1e-3, jnp.ones(()), max_steps=1000, **options).ys


@pytest.mark.slow
def test_checks_that_cannot_fail_call_the_host_no_more():
    ts = np.array([0.3, 0.7])
    assert "pure_callback" in names_used(saved_at, ts)
    assert "pure_callback" not in names_used(vectorised(saved_at), ts)
    np.testing.assert_allclose(jax.jit(vectorised(jax.vmap(saved_at)))(ts[None]), np.exp(-ts)[None], rtol=1e-10)
    np.testing.assert_allclose(jax.grad(lambda ts: vectorised(saved_at)(ts)[1])(ts), [0.0, -np.exp(-0.7)], rtol=1e-4)


@pytest.mark.parametrize("message", ["too late", "saveat.ts"])
def test_other_checks_fail_as_before(message):
    with pytest.raises(Exception, match=message):
        eqx.filter_jit(vectorised(ft.partial(saved_at, message=message)))(jnp.array([0.3, 0.7]))


def test_away_from_the_cpu_nothing_is_replaced(monkeypatch):
    monkeypatch.setattr(jax, "default_backend", lambda: "gpu")
    assert "sin" in names_used(vectorised(jnp.sin), 0.3)


def field(t, y, args):
    """A vector field as the solvers call it, with leaves that are not arrays."""
    angle, rate = y
    restoring = args["shape"](angle) if args["extra"] is None else angle
    return rate, -args["stiffness"] * restoring ** args["power"] + jnp.sin(t) * args["forcing"][1]


ARGS = {"shape": jnp.sin, "extra": None, "power": 3, "stiffness": np.float64(0.7), "forcing": np.array([1.0, 2.0])}


@pytest.mark.parametrize("transform", [lambda f: f, jax.jit], ids=["eager", "jit"])
def test_arguments_may_hold_functions_none_and_python_numbers(transform):
    fast = transform(lambda t, y: vectorised(field)(t, y, ARGS))
    np.testing.assert_allclose(fast(1.2, (0.4, 0.5)), field(1.2, (0.4, 0.5), ARGS), rtol=RTOL)


def test_derivatives_and_batches_pass_through_arguments_inside_a_pytree():
    def pull(f, stiffness, angle):
        return f(1.2, (angle, jnp.asarray(0.5)), {**ARGS, "stiffness": stiffness})[1]

    ks, angles = jnp.linspace(0.1, 2.0, 3), jnp.linspace(-1.0, 1.0, 3)
    slopes = jax.jit(jax.vmap(jax.grad(pull, (1, 2)), (None, 0, 0)), static_argnums=0)
    np.testing.assert_allclose(slopes(vectorised(field), ks, angles), slopes(field, ks, angles), rtol=RTOL)


class Wave(AbstractModule):
    rate: jax.Array = float_field()

    def __call__(self, t):
        return jnp.sin(self.rate * t)


def test_numbers_held_by_the_function_stay_leaves():
    slope = eqx.filter_grad(lambda f: f(2.0))(vectorised(Wave(jnp.asarray(0.3))))
    np.testing.assert_allclose(jax.tree.leaves(slope)[0], 2.0 * np.cos(0.6), rtol=RTOL)


def test_made_twice_of_one_function_it_compiles_once():
    traces = []

    @eqx.filter_jit
    def run(f, x):
        traces.append(x)
        return f(x)

    run(vectorised(jnp.sin), jnp.ones(()))
    run(vectorised(jnp.sin), jnp.ones(()))
    assert len(traces) == 1


def test_a_result_that_does_not_depend_on_the_arguments_is_an_array_too():
    run = jax.jit(lambda x: vectorised(lambda y: (jnp.sin(y), jnp.full((), jnp.nan), jnp.array(3)))(x))
    results = run(0.5)
    assert [type(result).__name__ for result in results] == ["ArrayImpl"] * 3
    assert [result.dtype.name for result in results] == ["float64", "float64", "int64"]
    direct = vectorised(lambda y: (jnp.sin(y), jnp.full((), jnp.nan)))(jnp.asarray(0.5))
    assert all(isinstance(result, jax.Array) for result in direct)

"""Functions of JAX with sine, cosine, tangent and arctangent replaced by ones that vectorise on a CPU."""

import functools as ft
import weakref
from collections.abc import Callable
from typing import Any

import jax
import jax.extend.linear_util as lu
import jax.numpy as jnp
import numpy as np
from jax.extend import core
from jax.extend.core import primitives as prims

from qsmc_jax.base import elementary
from qsmc_jax.base.module import AbstractModule

_FAST = {
    prims.sin_p: elementary.sin,
    prims.cos_p: elementary.cos,
    prims.tan_p: elementary.tan,
    prims.atan_p: elementary.atan,
}
_ENTERED = {
    prims.jit_p,
    prims.call_p,
    prims.closed_call_p,
    prims.remat_p,
    prims.cond_p,
    prims.scan_p,
    prims.while_p,
    prims.custom_jvp_call_p,
    prims.custom_vjp_call_p,
    prims.linear_solve_p,
}

_REWRITTEN: weakref.WeakKeyDictionary[core.ClosedJaxpr, core.ClosedJaxpr] = weakref.WeakKeyDictionary()


def vectorised(fn: Callable[..., Any]) -> "_Vectorised":
    """The same function with its float64 `sin`, `cos`, `tan` and `arctan` replaced by those of `elementary`.

    For a function called inside `jit`, such as the vector field of an ODE: each call traces it, rewrites the program
    that came out, through `jit`, `cond`, `scan`, `while_loop`, `checkpoint`, custom derivatives and linear solves, and
    runs it. Other things (a sharded map, a kernel, a callback) are left as they are, and so are other dtypes, and
    everything where JAX's default backend at the time of the call is no CPU: `is_vectorised` tells whether any is left.
    Values differ in the last places; derivatives are exact.

    Args:
        fn: Any function that `jit` could trace. Arguments may be pytrees with leaves that are not arrays, such as
            functions and None; numbers and NumPy arrays reach it as they are. Results are pytrees of arrays.

    Returns:
        A pytree that is called as `fn` is, and whose leaves are those of `fn`. Made twice of equal functions it is
        equal, so that `jit` does not compile twice.
    """
    return _Vectorised(fn)


def is_vectorised(program: core.ClosedJaxpr) -> bool:
    """Whether no float64 `sin`, `cos`, `tan` or `arctan` of JAX is left in a program, wherever it may hide.

    Args:
        program: What `jax.make_jaxpr` or `jax.jit(fn).trace(...).jaxpr` gives.
    """
    return not any(_is_slow(equation) or _holds_slow(equation) for equation in program.jaxpr.eqns)


class _Vectorised(AbstractModule):
    fn: Callable[..., Any]

    def __call__(self, *args: Any, **kwargs: Any) -> Any:
        if jax.default_backend() != "cpu":
            return self.fn(*args, **kwargs)
        # Without inputs of its own, the traced program closes over the arguments, whatever they are.
        program, shape = jax.make_jaxpr(ft.partial(self.fn, *args, **kwargs), return_shape=True)()
        results = core.jaxpr_as_fun(_rewritten(program))()
        # A result that is one number whatever the arguments comes out as a number.
        arrays = [leaf if isinstance(leaf, jax.Array) else jnp.asarray(leaf, leaf.dtype) for leaf in results]
        return jax.tree.unflatten(jax.tree.structure(shape), arrays)


def _rewritten(part: Any) -> Any:
    """A program with its equations rewritten, wherever it sits in the parameters of an equation."""
    match part:
        case core.ClosedJaxpr():
            return _rewritten_once(part)
        case core.Jaxpr():
            return part.replace(eqns=[_rewritten_equation(equation) for equation in part.eqns])
        case lu.WrappedFun():  # makes the program of a custom derivative, when asked
            return lu.wrap_init(ft.partial(_rewritten_rule, part), debug_info=part.debug_info)
        case tuple():
            items = [_rewritten(item) for item in part]
            return type(part)(*items) if hasattr(part, "_fields") else tuple(items)  # a named tuple stays one
        case _:
            return part


def _rewritten_once(program: core.ClosedJaxpr) -> core.ClosedJaxpr:
    """A program that is called in many places stays one program, which JAX goes through once."""
    if program not in _REWRITTEN:
        _REWRITTEN[program] = core.ClosedJaxpr(_rewritten(program.jaxpr), program.consts)
    return _REWRITTEN[program]


def _rewritten_equation(equation: core.JaxprEqn) -> core.JaxprEqn:
    if _is_slow(equation):
        fast = _fast_equation(equation)
        return equation.replace(primitive=fast.primitive, params=fast.params)
    if equation.primitive in _ENTERED and _holds_slow(equation):
        # `bwd`, the backward pass of a custom derivative, is a function of numbers: it makes no program.
        return equation.replace(params={k: v if k == "bwd" else _rewritten(v) for k, v in equation.params.items()})
    return equation


def _rewritten_rule(rule: lu.WrappedFun, *args: Any) -> tuple[Any, ...]:
    program, *rest = rule.call_wrapped(*args)
    return _rewritten(program), *rest


def _is_slow(equation: core.JaxprEqn) -> bool:
    return equation.primitive in _FAST and getattr(equation.invars[0].aval, "dtype", None) == np.float64


def _holds_slow(equation: core.JaxprEqn) -> bool:
    """Whether there is something to replace in it; a program left as it is keeps what JAX has cached for it."""
    inner = (e for program in core.jaxprs_in_params(equation.params) for e in program.eqns)
    return any(_is_slow(e) or _holds_slow(e) for e in inner)


def _fast_equation(equation: core.JaxprEqn) -> core.JaxprEqn:
    """The one equation that a call of the fast function is."""
    aval: Any = equation.invars[0].aval
    return _call_of_fast(equation.primitive, aval.shape, bool(aval.weak_type))


@ft.cache
def _call_of_fast(primitive: core.Primitive, shape: tuple[int, ...], is_weak: bool) -> core.JaxprEqn:
    operand = jax.ShapeDtypeStruct(shape, np.float64, weak_type=is_weak)
    with jax.enable_x64(True):
        (equation,) = jax.make_jaxpr(_FAST[primitive])(operand).eqns
    return equation

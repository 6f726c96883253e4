"""Whether the derivatives of a reference, or of a funnel, are those of its value."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from qsmc_jax.base.checks import is_traced, require, show
from qsmc_jax.base.precision import entry_point
from qsmc_jax.model.kinks import as_times
from qsmc_jax.model.references import AbstractReference, Constant, Recorded, Smooth, SumOfSines
from qsmc_jax.tracing.traceable import described, is_number, once_per_structure, trace

_EXACT = (Constant, Recorded, SumOfSines, Smooth)  # by their formulas
_TIMES = 512  # at most half of them one for each piece
_GOLDEN = 0.5 * (5.0**0.5 - 1.0)
# Formulas that differ by rounding agree to far more digits; numbers rounded by hand, such as 3.14, to fewer.
_AGREEMENT = 1e-6
_ROUNDING = 1e-12


def require_derivatives(reference: AbstractReference, order: int) -> None:
    """Raises unless a reference has derivatives up to an order, each one number, and those below it continuous.

    Args:
        reference: The reference.
        order: The order of the plant.
    """
    _require_derivatives((reference, order))
    if isinstance(reference, Recorded):
        reference.check_order(order)


@once_per_structure
def _require_derivatives(pair: tuple[AbstractReference, int]) -> None:
    reference, order = pair
    owner, time = f"`{type(reference).__name__}`", jax.ShapeDtypeStruct((), float)
    name = f"`derivatives` of {owner}"
    _, result = trace(name, "a time and an order", reference, lambda r, t: tuple(r.derivatives(t, order)), time)
    require(
        len(result) == order + 1 and all(map(is_number, result)),
        f"{name} must return {order + 1} numbers for order {order}, but returns {described(result)}.",
    )
    trace(f"`break_times` of {owner}", "nothing", reference, lambda r: as_times(r.break_times))


def require_consistent(reference: AbstractReference, order: int, t1: Any) -> None:
    """Raises unless each derivative of a reference is the derivative in time of the one before; traced numbers pass.

    Asked at some hundred times, and inside each piece between break times. At a kink or jump there is nothing
    to compare. What JAX can't differentiate passes.

    Args:
        reference: The reference.
        order: Its highest derivative that is used.
        t1: The horizon [s].
    """
    if isinstance(reference, _EXACT):
        return

    def components(reference: AbstractReference, t: Any) -> Any:
        return reference.derivatives(t, order)

    why = "Mend `derivatives`, or let `qj.references.Smooth(fn)` compute them."
    require_slopes(reference, components, t1, f"of `{type(reference).__name__}`", why)


def require_slopes(owner: Any, components: Callable[[Any, Any], Any], t1: Any, name: str, mend: str) -> None:
    """Raises unless each component is the derivative in time of the one before; traced numbers pass.

    Args:
        owner: What has them, with `break_times`.
        components: Value and derivatives of it at a time [s].
        t1: The horizon [s].
        name: What they are of, as messages say it.
        mend: What can be done.
    """
    if is_traced(owner, t1):
        return
    compared = _compared(owner, components, float(t1))
    if compared is None:
        return
    ts, values, slopes = compared
    for k in range(values.shape[1] - 1):
        given, found = values[:, k + 1], slopes[:, k]
        is_number = np.isfinite(given) & np.isfinite(found) & np.isfinite(values[:, k])
        scale = np.max(np.abs(np.where(is_number, [given, found], 0.0)))
        # A difference that in the whole horizon would not come to a digit of what is differentiated is rounding.
        rounding = _ROUNDING * np.max(np.abs(np.where(is_number, values[:, k], 0.0))) / float(t1)
        difference = np.where(is_number, np.abs(given - found), 0.0)
        worst = int(np.argmax(difference))
        require(
            bool(difference[worst] <= _AGREEMENT * scale + rounding),
            f"Derivative {k + 1} {name} must be the derivative in time of "
            f"{f'derivative {k}' if k else 'its value'}, but at t = {show(ts[worst])} s it is {show(given[worst])} "
            f"instead of {show(found[worst])}. {mend}",
        )


@entry_point
def _compared(owner: Any, components: Callable[[Any, Any], Any], t1: float) -> tuple[Any, Any, Any] | None:
    """Times, components and their slopes, a row a time; None if JAX can't differentiate them."""
    declared = np.asarray(as_times(owner.break_times))
    inner = np.sort(declared[(declared > 0.0) & (declared < t1)])[: _TIMES // 2 - 1]
    edges = np.concatenate([[0.0], inner, [t1]])
    inside = edges[:-1] + _GOLDEN * np.diff(edges)  # seldom a round number, at which a formula may be guarded
    spread = t1 * ((np.arange(2, _TIMES - len(inside) + 2) * _GOLDEN) % 1.0)  # evenly, but in step with no period
    ts = np.concatenate([inside, spread])
    try:
        values, slopes = _with_slopes(owner, components, ts)
    except (TypeError, ValueError):  # a function of which only the reverse derivative is known, or a call out of JAX
        return None
    return ts, values, slopes


@eqx.filter_jit
def _with_slopes(owner: Any, components: Callable[[Any, Any], Any], ts: Any) -> tuple[Any, Any]:
    def at(t: Any) -> Any:
        return jnp.stack([jnp.asarray(value, dtype=float) for value in components(owner, t)])

    return jax.vmap(lambda t: jax.jvp(at, (t,), (jnp.ones_like(t),)))(ts)

"""Whether what users wrote is finite, before anything is solved."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import entry_point
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.components import components
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.model.unseen import is_consistent, is_known, is_own
from qsmc_jax.multivariable import MultivariableLoop

_INSTANTS = 257


def is_ours(loop: ClosedLoop | MultivariableLoop) -> bool:
    """Whether plant, reference and disturbance are all the library's.

    Args:
        loop: The loop.
    """
    if isinstance(loop, MultivariableLoop):
        return False
    is_plain = isinstance(loop.reference, AbstractReference) and is_consistent(loop.reference)
    return is_known(loop.plant) and is_plain and is_own(loop.disturbance)


def require_finite_functions(loop: ClosedLoop | MultivariableLoop, x0: Any, t1: RealScalarLike) -> None:
    """Raises if a function of the loop is not finite at some time of the horizon, at the start's state.

    Traced numbers pass, and so does what the library brings: its numbers are checked by its constructors.

    Args:
        loop: The loop.
        x0: The start, n numbers.
        t1: The horizon [s].
    """
    if is_ours(loop) or is_traced(loop, x0, t1):
        return
    ts = np.linspace(0.0, float(t1), _INSTANTS)
    for name, values in _values(loop, x0, ts).items():
        is_bad = ~np.isfinite(values)
        if np.any(is_bad):
            at, value = ts[is_bad][0], values[is_bad][0]
            where = f" and x = {show(x0)}" if f"of `{type(loop.plant).__name__}`" in name else ""
            raise InputError(
                f"{name} must be finite, but is {show(value)} at t = {show(at)} s{where}. Guard what it divides by, "
                "takes the root or the logarithm of: `jnp.where(is_fine, x, 1.0)` inside the function."
            )


@entry_point
def _values(loop: ClosedLoop | MultivariableLoop, x0: Any, ts: Float[np.ndarray, " times"]) -> dict[str, Any]:
    own, of_channels = _evaluated(loop, jnp.asarray(x0), jnp.asarray(ts))
    names = {
        f"`{method}` of `{type(body).__name__}`": values
        for body, found in zip(loop.bodies, own, strict=True)
        for method, values in found.items()
    }
    several = len(loop.channels) > 1
    for i, (channel, (disturbance, desired)) in enumerate(zip(loop.channels, of_channels, strict=True)):
        of = f" of channel {i}" if several else ""
        names[f"`{type(channel.disturbance).__name__}`, a disturbance{of},"] = disturbance
        for order, values in enumerate(desired):
            names[f"Derivative {order} of `{type(channel.reference).__name__}`, a reference{of},"] = values
    return names


@eqx.filter_jit
def _evaluated(loop: ClosedLoop | MultivariableLoop, x0: Float[Array, " n"], ts: Float[Array, " times"]) -> Any:
    def at(t: Array) -> Any:
        x, d = loop.start(x0), loop.channels[0].disturbed(t)
        signals = [(channel.disturbance(t), channel.whole.desired(t, x)) for channel in loop.channels]
        starts = x, x[loop.plant.states :]
        own = [
            {name: component(body, t, start[: body.states], d) for name, component in components(body).items()}
            for body, start in zip(loop.bodies, starts, strict=False)
        ]
        return jax.tree.map(lambda value: jnp.asarray(value, float), (own, signals))

    return jax.vmap(at)(ts)

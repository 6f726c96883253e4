"""Which functions of a loop can only be probed within a step, not enclosed."""

import jax
import jax.numpy as jnp

from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.enclosures.unseen import Nodes, Step, Unseen, unseen
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.components import components
from qsmc_jax.model.unseen import is_known, unseen_in_reference, unseen_in_signal
from qsmc_jax.multivariable import MultivariableLoop
from qsmc_jax.simulation.guard import unseen_in_funnel

_NODES = Nodes((0.0, 0.5, 1.0), few=(0.0, 0.5, 1.0))


def probed_functions(loop: ClosedLoop | MultivariableLoop) -> tuple[str, ...]:
    """Functions that the guard could only look at in some thirty instants of a step, with the operations to blame.

    Args:
        loop: The loop.

    Returns:
        A text for each, such as "`drift` of `Mine` (`custom_call`)"; none for most loops.
    """
    found: dict[str, tuple[str, ...]] = {}

    def look(t0: jax.Array, t1: jax.Array, x: tuple[jax.Array, ...]) -> jax.Array:
        step = Step(t0, t1, _NODES)
        parts = [part for each in loop.channels for part in _signals(each, step)]
        for signal in () if loop.implementation is None else loop.implementation.unmatched:
            parts.append((f"`{type(signal).__name__}`", unseen_in_signal(signal, step)))
        for body in loop.bodies:
            for name, each in () if is_known(body) else components(body).items():
                state = x[: body.states]
                path = lambda t, body=body, each=each, x=state: each(body, t, tuple(xi * t for xi in x), t)  # noqa: E731
                parts.append((f"`{name}` of `{type(body).__name__}`", unseen(path, step)))
        for name, part in parts:
            found[name] = tuple(sorted({*found.get(name, ()), *part.probed}))
        return jnp.zeros(())

    number = jax.ShapeDtypeStruct((), float)
    with in_64_bits():
        jax.eval_shape(look, number, number, (number,) * loop.states)
    listed = {name: ", ".join(f"`{operation}`" for operation in names) for name, names in found.items() if names}
    return tuple(f"{name} ({operations})" for name, operations in listed.items())


def _signals(loop: ClosedLoop, step: Step) -> list[tuple[str, Unseen]]:
    funnel = loop.control.funnel
    return [
        (f"`{type(loop.disturbance).__name__}`", unseen_in_signal(loop.disturbance, step)),
        (f"`derivatives` of `{type(loop.reference).__name__}`", unseen_in_reference(loop.reference, loop.order, step)),
        (f"`{type(funnel).__name__}`", unseen_in_funnel(funnel, step, is_rate=True)),
    ]


def said_of_probed(loop: ClosedLoop | MultivariableLoop) -> str:
    """A sentence on what could only be probed; empty if all was enclosed."""
    names = probed_functions(loop)
    if not names:
        return ""
    return (
        f"Only probed between the steps' stages, not enclosed: {', '.join(names)}. What is narrower than a thirtieth "
        "of a step may hide there."
    )

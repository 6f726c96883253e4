"""What a plant or a reference model computes, one number at a time, whatever form it has."""

from collections.abc import Callable
from typing import Any, TypeAlias

from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.model.reference_model import AbstractReferenceModel
from qsmc_jax.model.state_space import AbstractStateSpace

Body: TypeAlias = AbstractPlant | AbstractStateSpace | AbstractReferenceModel
# A number of a plant, a time, a state and the value of the disturbance.
Component: TypeAlias = Callable[[Any, Any, Any, Any], Any]


def components(plant: Body) -> dict[str, Component]:
    """The numbers that a plant computes, by the methods that return them: `drift`, or `vector_field[0]`.

    Args:
        plant: The plant, or a reference model, to which disturbances do not matter.
    """
    if isinstance(plant, AbstractPlant):
        return {"drift": lambda plant, t, x, d: plant.drift(t, x), "gain": lambda plant, t, x, d: plant.gain(t, x)}
    if isinstance(plant, AbstractReferenceModel):
        found: dict[str, Component] = {"output": lambda model, t, x, d: model.output(t, x)}
        for i in range(plant.states):
            found[f"vector_field[{i}]"] = lambda model, t, x, d, i=i: model.vector_field(t, x)[i]
        return found
    channels = range(len(plant.relative_degrees))
    if len(channels) == 1:
        found = {"output": lambda plant, t, x, d: plant.output(t, x)}
    else:
        found = {f"output[{k}]": lambda plant, t, x, d, k=k: plant.output(t, x)[k] for k in channels}
    for i in range(plant.states):
        found[f"vector_field[{i}]"] = lambda plant, t, x, d, i=i: plant.vector_field(t, x, _all(plant, d))[i]
        for j in channels:
            name = f"input_matrix[{i}]" if len(channels) == 1 else f"input_matrix[{i}][{j}]"
            found[name] = lambda plant, t, x, d, i=i, j=j: plant.column(t, x, j)[i]
    return found


def _all(plant: AbstractStateSpace, d: Any) -> Any:
    """The value of the disturbance for all channels, given one for all of them or each."""
    several = len(plant.relative_degrees)
    return d if several == 1 or isinstance(d, tuple) else (d,) * several

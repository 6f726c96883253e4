"""What a plant computes, one number at a time, whatever form it has."""

from collections.abc import Callable
from typing import Any, TypeAlias

from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.model.state_space import AbstractStateSpace

# A number of a plant, a time, a state and the value of the disturbance.
Component: TypeAlias = Callable[[Any, Any, Any, Any], Any]


def components(plant: AbstractPlant | AbstractStateSpace) -> dict[str, Component]:
    """The numbers that a plant computes, by the methods that return them: `drift`, or `vector_field[0]`.

    Args:
        plant: The plant.
    """
    if isinstance(plant, AbstractPlant):
        return {"drift": lambda plant, t, x, d: plant.drift(t, x), "gain": lambda plant, t, x, d: plant.gain(t, x)}
    found: dict[str, Component] = {"output": lambda plant, t, x, d: plant.output(t, x)}
    for i in range(plant.states):
        found[f"vector_field[{i}]"] = lambda plant, t, x, d, i=i: plant.vector_field(t, x, d)[i]
        found[f"input_matrix[{i}]"] = lambda plant, t, x, d, i=i: plant.input_matrix(t, x)[i]
    return found

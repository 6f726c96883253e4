"""The parameters to be tuned, and the smooth map between their bounds and the unit cube."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require
from qsmc_jax.display.scales import spans_decade
from qsmc_jax.study.specs import check_values
from qsmc_jax.study.study import Study, require_study


@dataclasses.dataclass(frozen=True)
class Bounds:
    """Names with their bounds; a coordinate is linear in the number, or in its logarithm if the bounds are far apart.

    Attributes:
        names: The parameters.
        low: Their lower bounds.
        high: Their upper bounds.
        is_logarithmic: Which of them are searched in the logarithm.
    """

    names: tuple[str, ...]
    low: Float[np.ndarray, " names"]
    high: Float[np.ndarray, " names"]
    is_logarithmic: np.ndarray

    def gains(self, v: Float[np.ndarray, " names"]) -> dict[str, float]:
        """The numbers at a point of the unit cube, by name."""
        low, high = self._straight(self.low), self._straight(self.high)
        x = low + v * (high - low)
        x = np.where(self.is_logarithmic, np.exp(np.where(self.is_logarithmic, x, 0.0)), x)
        return dict(zip(self.names, np.clip(x, self.low, self.high).tolist(), strict=True))

    def slopes(self, v: Float[np.ndarray, " names"]) -> Float[np.ndarray, " names"]:
        """The derivative of each number by its coordinate."""
        x = np.array(list(self.gains(v).values()))
        return (self._straight(self.high) - self._straight(self.low)) * np.where(self.is_logarithmic, x, 1.0)

    def point(self, study: Study) -> Float[np.ndarray, " names"]:
        """Where the study stands in the unit cube."""
        default = {spec.name: spec.nominal for spec in study.specs}
        return self.place({name: float({**default, **study.values}[name]) for name in self.names})

    def place(self, gains: Mapping[str, float]) -> Float[np.ndarray, " names"]:
        """The point of the unit cube with the given numbers: `gains` backwards."""
        low, high = self._straight(self.low), self._straight(self.high)
        return (self._straight(np.array([gains[name] for name in self.names])) - low) / (high - low)

    def _straight(self, x: Float[np.ndarray, " names"]) -> Float[np.ndarray, " names"]:
        """What the coordinate is linear in: the number or its logarithm."""
        return np.where(self.is_logarithmic, np.log(np.where(self.is_logarithmic, x, 1.0)), x)


def bounds_of(study: Study, names: tuple[str, ...]) -> Bounds:
    """The bounds of parameters of a study.

    Raises:
        InputError: A name does not exist, is drawn rather than a parameter, is no single number, or comes twice.
    """
    require_study(study)
    require(len(names) > 0, "Argument `parameters` must name at least one parameter of the study.")
    require(len(set(names)) == len(names), f"Argument `parameters` must name each once, but is {list(names)}.")
    specs = {spec.name: spec for spec in study.specs}
    own = [spec.name for spec in study.specs if spec.kind == "parameter"]
    for name in names:
        check_values(study.specs, {name: specs[name].nominal if name in specs else 0.0})
        spec = specs[name]
        require(
            spec.kind == "parameter" and spec.shape == (),
            f"Argument `parameters` must name parameters, but `{name}` is a {spec.kind} of shape {spec.shape}. "
            f"Parameters: {', '.join(own) or 'none'}. Use `draw.parameter(name, default, bounds=...)`.",
        )
        require(
            bool(np.all(np.isfinite(spec.bounds))),
            f"Parameter `{name}` must have finite bounds that depend on no other name, but has {spec.bounds}.",
        )
    low, high = np.array([specs[name].bounds for name in names]).T
    return Bounds(names, low, high, np.array([spans_decade(*specs[name].bounds) for name in names]))

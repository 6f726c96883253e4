"""The parameters to be tuned, and the smooth map between their bounds and the unit cube."""

import dataclasses
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float

from qsmc_jax.base.checks import require
from qsmc_jax.study.draw import check_values
from qsmc_jax.study.study import Study

# Bounds further apart than this are searched in the logarithm.
_DECADE = 10.0


@dataclasses.dataclass(frozen=True)
class Box:
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
        return dict(zip(self.names, np.clip(self._numbers(v), self.low, self.high).tolist(), strict=True))

    def slopes(self, v: Float[np.ndarray, " names"]) -> Float[np.ndarray, " names"]:
        """The derivative of each number by its coordinate."""
        ratio = np.log(np.where(self.is_logarithmic, self.high / np.where(self.low == 0.0, 1.0, self.low), 1.0))
        return np.where(self.is_logarithmic, self._numbers(v) * ratio, self.high - self.low)

    def point(self, study: Study) -> Float[np.ndarray, " names"]:
        """Where the study stands in the unit cube."""
        default = {spec.name: spec.nominal for spec in study.specs}
        return self.place({name: float({**default, **study.values}[name]) for name in self.names})

    def place(self, gains: Mapping[str, float]) -> Float[np.ndarray, " names"]:
        """The point of the unit cube with the given numbers: `gains` backwards."""
        x = np.array([gains[name] for name in self.names])
        low = np.where(self.is_logarithmic, self.low, 1.0)
        ratio = np.where(self.is_logarithmic, self.high / low, 2.0)
        geometric = np.log(np.where(self.is_logarithmic, x, 1.0) / low) / np.log(ratio)
        return np.where(self.is_logarithmic, geometric, (x - self.low) / (self.high - self.low))

    def _numbers(self, v: np.ndarray) -> np.ndarray:
        low = np.where(self.is_logarithmic, self.low, 1.0)
        ratio = np.where(self.is_logarithmic, self.high, 1.0) / low
        return np.where(self.is_logarithmic, low * ratio**v, self.low + v * (self.high - self.low))


def box_of(study: Study, names: tuple[str, ...]) -> Box:
    """The bounds of parameters of a study.

    Raises:
        ValueError: A name does not exist, is drawn rather than a parameter, is no single number, or comes twice.
    """
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
    return Box(names, low, high, (low > 0.0) & (high > _DECADE * low))

"""The distributions of single numbers: each a method with its checks, its inverse CDF in quantiles.py."""

import functools as ft
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Array

from qsmc_jax.base.checks import is_traced, require, require_finite, require_nonnegative, require_shape, show
from qsmc_jax.base.module import as_float64
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.study import quantiles, tabulated
from qsmc_jax.study.coordinates import AbstractCoordinates
from qsmc_jax.study.specs import require_fixed, require_inside

# Standard deviations from the mean to an interval, beyond which the probability of the interval underflows.
_REACH = 37.0


class AbstractDistributions(AbstractCoordinates):
    """Named numbers that are drawn alone, each by the inverse CDF at a coordinate of its own."""

    def uniform(self, name: str, low: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Uniform on [low, high].

        Args:
            name: The name, a column of the result.
            low: Smallest value.
            high: Largest value, above `low`.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.25]).uniform("mass", 2.0, 4.0))
            2.5
        """
        low, high = self._interval(name, "low", low, "high", high)
        return self._take(name, "uniform", shape, (low, high), quantiles.uniform, low, high)

    def log_uniform(self, name: str, low: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Uniform in the logarithm on [low, high].

        Args:
            name: The name, a column of the result.
            low: Smallest value, positive.
            high: Largest value, above `low`.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> round(float(qj.Draw([0.5]).log_uniform("frequency", 0.1, 10.0)), 12)
            1.0
        """
        low, high = self._interval(name, "low", self._positive(name, "low", low), "high", high)
        return self._take(name, "log_uniform", shape, (low, high), quantiles.log_uniform, low, high)

    def normal(self, name: str, mean: RealScalarLike, std: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Normal.

        Args:
            name: The name, a column of the result.
            mean: Mean.
            std: Standard deviation, positive.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.975]).normal("bias", mean=0.0, std=1.0).round(4))
            1.96
        """
        mean, std = self._number(name, "mean", mean), self._positive(name, "std", std)
        return self._take(name, "normal", shape, (-math.inf, math.inf), quantiles.normal, mean, std)

    def truncated_normal(
        self,
        name: str,
        mean: RealScalarLike,
        std: RealScalarLike,
        low: RealScalarLike,
        high: RealScalarLike,
        *,
        shape: tuple[int, ...] = (),
    ) -> Any:
        """Normal, conditioned on [low, high].

        For one side only, put the other 40 standard deviations away.

        Args:
            name: The name, a column of the result.
            mean: Mean before the cut.
            std: Standard deviation before the cut, positive.
            low: Smallest value.
            high: Largest value, above `low`; [low, high] no more than 37 standard deviations from the mean.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.5]).truncated_normal("angle", mean=0.0, std=1.0, low=-2.0, high=2.0))
            0.0
        """
        mean, std = self._number(name, "mean", mean), self._positive(name, "std", std)
        low, high = self._interval(name, "low", low, "high", high)
        reach = _REACH * std
        self._check(
            (low - mean <= reach) & (mean - high <= reach), ft.partial(_require_mass, name, mean, std, low, high)
        )
        return self._take(
            name, "truncated_normal", shape, (low, high), quantiles.truncated_normal, mean, std, low, high
        )

    def lognormal(
        self, name: str, median: RealScalarLike, log_std: RealScalarLike, *, shape: tuple[int, ...] = ()
    ) -> Any:
        """Lognormal: its logarithm is normal.

        Args:
            name: The name, a column of the result.
            median: Median, positive: the exponential of the logarithm's mean.
            log_std: Standard deviation of the logarithm, positive; if small, about the relative standard deviation.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.975]).lognormal("friction", median=0.01, log_std=0.2).round(6))
            0.014799
        """
        median, log_std = self._positive(name, "median", median), self._positive(name, "log_std", log_std)
        return self._take(name, "lognormal", shape, (0.0, math.inf), quantiles.lognormal, median, log_std)

    def triangular(
        self, name: str, low: RealScalarLike, mode: RealScalarLike, high: RealScalarLike, *, shape: tuple[int, ...] = ()
    ) -> Any:
        """Triangular on [low, high].

        Args:
            name: The name, a column of the result.
            low: Smallest value.
            mode: Where its peak is, low <= mode <= high.
            high: Largest value, above `low`.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.5]).triangular("delay", 0.0, 1.0, 2.0))
            1.0
        """
        low, high = self._interval(name, "low", low, "high", high)
        mode = self._number(name, "mode", mode)
        self._check((low <= mode) & (mode <= high), ft.partial(require_inside, f"mode` of `{name}", mode, (low, high)))
        return self._take(name, "triangular", shape, (low, high), quantiles.triangular, low, mode, high)

    def exponential(self, name: str, mean: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Exponential.

        Args:
            name: The name, a column of the result.
            mean: Mean, positive.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.5]).exponential("gap", mean=2.0).round(4))
            1.3863
        """
        mean = self._positive(name, "mean", mean)
        return self._take(name, "exponential", shape, (0.0, math.inf), quantiles.exponential, mean)

    def weibull(self, name: str, k: RealScalarLike, scale: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Weibull, from 0 on.

        Args:
            name: The name, a column of the result.
            k: Its shape, positive; 1 is an exponential, 2 a Rayleigh distribution.
            scale: The value that is not exceeded with probability 1 - 1/e, positive.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.5]).weibull("gust", k=2.0, scale=8.0).round(4))
            6.6604
        """
        k, scale = self._positive(name, "k", k), self._positive(name, "scale", scale)
        return self._take(name, "weibull", shape, (0.0, math.inf), quantiles.weibull, k, scale)

    def gamma(self, name: str, k: RealScalarLike, scale: RealScalarLike, *, shape: tuple[int, ...] = ()) -> Any:
        """Gamma, with mean `k * scale`.

        By a table that is exact to 1e-13; see `from_scipy`.

        Args:
            name: The name, a column of the result.
            k: Its shape, from about 0.06 to 1e7, a fixed number.
            scale: Scale, positive.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.5]).gamma("load", k=2.0, scale=3.0).round(4))
            5.035
        """
        table, support = tabulated.gamma(self._fixed(name, "k", k)), (0.0, math.inf)
        _require_table(name, table, k=k)
        scale = self._positive(name, "scale", scale)
        return self._take(name, "gamma", shape, support, quantiles.tabulated, table, *support, 0.0, scale)

    def beta(
        self,
        name: str,
        a: RealScalarLike,
        b: RealScalarLike,
        low: RealScalarLike = 0.0,
        high: RealScalarLike = 1.0,
        *,
        shape: tuple[int, ...] = (),
    ) -> Any:
        """Beta on [low, high], with mean `low + (high - low) * a / (a + b)`.

        By a table that is exact to 1e-13; see `from_scipy`.

        Args:
            name: The name, a column of the result.
            a: Its first exponent, from about 0.06 to 1e4, a fixed number.
            b: Its second exponent, likewise.
            low: Smallest value.
            high: Largest value, above `low`.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.5]).beta("grip", a=2.0, b=2.0, low=0.2, high=1.0).round(4))
            0.6
        """
        table = tabulated.beta(self._fixed(name, "a", a), self._fixed(name, "b", b))
        low, high = self._interval(name, "low", low, "high", high)
        _require_table(name, table, a=a, b=b)
        return self._take(name, "beta", shape, (low, high), quantiles.tabulated, table, 0.0, 1.0, low, high - low)

    def from_scipy(self, name: str, frozen: Any, *, shape: tuple[int, ...] = ()) -> Any:
        """Any continuous distribution of `scipy.stats`, with its arguments.

        JAX has no such quantile functions: SciPy's is tabulated once, between the probabilities 2**-53 and 1 - 2**-53,
        as polynomials of degree 15 on pieces that are halved until the relative error is at most 1e-13 in the value or
        in the odds u / (1 - u); in the upper half, where a coordinate has no more digits, the probability may be missed
        by 2.2e-16, and wherever SciPy's own function is no better, by 1e-14. Its arguments must be fixed numbers.

        Args:
            name: The name, a column of the result.
            frozen: The distribution. Make it once, outside of the scenario.
            shape: Shape of independent numbers.

        Raises:
            InputError: It is no such distribution, or its quantile function is too rough.

        Examples:
            >>> import scipy.stats
            >>> import qsmc_jax as qj
            >>> gumbel = scipy.stats.gumbel_r(loc=8.0, scale=2.0)
            >>> float(qj.Draw([0.99]).from_scipy("gust", gumbel)) - gumbel.ppf(0.99) < 1e-12
            True
        """
        table, support = tabulated.frozen(name, frozen)
        return self._take(name, "from_scipy", shape, support, quantiles.tabulated, table, *support)

    def choice(
        self,
        name: str,
        values: Sequence[Any] | np.ndarray | Array,
        weights: Sequence[Any] | np.ndarray | Array | None = None,
        *,
        shape: tuple[int, ...] = (),
    ) -> Any:
        """One of `values`.

        Args:
            name: The name, a column of the result.
            values: What it may be, at least one number.
            weights: How likely each is, fixed numbers that are not negative, need not add up to 1, but not all 0; None
                if they are equally likely.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.75]).choice("load", [1.0, 2.0, 5.0], weights=[7, 2, 1]))
            2.0
        """
        array = as_float64(values)
        require(
            array.ndim == 1 and array.size > 0,
            f"Argument `values` of `{name}` must be a list of at least one number, but has shape {array.shape}.",
        )
        self._check((abs(array) < math.inf).all(), ft.partial(require_finite, f"values` of `{name}", array))
        edges = None if weights is None else _cell_ends(name, weights, len(array))
        return self._pick(name, "choice", shape, array, edges)

    def sign(self, name: str, *, shape: tuple[int, ...] = ()) -> Any:
        """-1 or +1, equally likely.

        Args:
            name: The name, a column of the result.
            shape: Shape of independent numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> float(qj.Draw([0.25]).sign("side"))
            -1.0
        """
        return self._pick(name, "sign", shape, np.array([-1.0, 1.0]))

    def _pick(self, name: str, kind: str, shape: tuple[int, ...], values: Any, edges: np.ndarray | None = None) -> Any:
        """One of some values."""
        has_width = slice(None) if edges is None else np.diff(edges, prepend=0.0, append=1.0) > 0.0
        levels = () if is_traced(values) else tuple(values[has_width].tolist())
        bounds = values.min(), values.max()
        return self._take(name, kind, shape, bounds, quantiles.choice, values, edges, levels=levels)


def _cell_ends(name: str, weights: Any, count: int) -> np.ndarray:
    """Where in [0, 1] one value ends and the next begins."""
    require_fixed(f"weights` of `{name}", weights)
    weights = as_float64(weights)
    require_shape(f"weights` of `{name}", weights, (count,), "a number for each value")
    require_nonnegative(f"weights` of `{name}", weights)
    sums = np.cumsum(weights)
    require(bool(sums[-1] > 0.0), f"Argument `weights` of `{name}` must not be 0 throughout.")
    return sums[:-1] / sums[-1]


def _require_table(name: str, table: tabulated.Tabulated | None, **given: Any) -> None:
    """Raises if a quantile function is too steep or rough to be tabulated."""
    arguments = " and ".join(f"`{argument}` {show(value)}" for argument, value in given.items())
    require(
        table is not None,
        f"Argument `{next(iter(given))}` of `{name}` must give a quantile function that can be tabulated to 1e-13, but "
        f"with {arguments} it is too steep or SciPy's too rough. From 0.06 to 1e4 all do.",
    )


def _require_mass(name: str, mean: Any, std: Any, low: Any, high: Any) -> None:
    """Raises if the interval is so far out in a tail that its probability underflows."""
    distance = max(low - mean, mean - high) / std
    require(
        bool(distance <= _REACH),
        f"Argument `mean` of `{name}` must be within {_REACH:g} standard deviations of [low, high], but is "
        f"{distance:.6g} away. Use another distribution.",
    )

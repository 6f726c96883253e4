"""Numbers that are drawn together: rows of data, correlated normals, and a Gaussian copula."""

import contextlib
import math
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from jaxtyping import Array

from qsmc_jax.base.checks import require, require_finite, require_list, require_shape
from qsmc_jax.base.module import as_float64
from qsmc_jax.study import quantiles
from qsmc_jax.study.coordinates import AbstractCoordinates
from qsmc_jax.study.copula import Copula, correlation_factor, factor_of
from qsmc_jax.study.specs import require_fixed


class AbstractJoint(AbstractCoordinates):
    """Named numbers that are drawn together."""

    def empirical(self, name: str, rows: Sequence[Any] | np.ndarray | Array, *, shape: tuple[int, ...] = ()) -> Any:
        """One of the rows of some data, each equally likely: numbers of one row stay together.

        A row takes one coordinate. Rows are sorted, the first column first, so that their order does not count.

        Args:
            name: The name; of several columns, `name[0]`, `name[1]` and so on are columns of the result.
            rows: The data: a list of numbers, or one of rows of equal length; fixed numbers.
            shape: Shape of independent rows.

        Examples:
            >>> import qsmc_jax as qj
            >>> speed, height = qj.Draw([0.9]).empirical("wave", [[3.0, 0.4], [7.0, 1.5], [5.0, 1.1]])
            >>> float(speed), float(height)
            (7.0, 1.5)
        """
        require_fixed(f"rows` of `{name}", rows)
        data = as_float64(rows)
        is_table = data.ndim in (1, 2) and data.size > 0
        require(is_table, f"Argument `rows` of `{name}` must be numbers, or rows of them, but has shape {data.shape}.")
        require_finite(f"rows` of `{name}", data)
        columns = data.reshape(len(data), -1)
        data = data[np.lexsort(columns.T[::-1])]
        return self._take(name, "empirical", shape, (data.min(), data.max()), quantiles.choice, data)

    def multivariate_normal(
        self,
        names: Sequence[str],
        mean: Sequence[Any] | np.ndarray | Array,
        covariance: Sequence[Any] | np.ndarray | Array,
    ) -> tuple[Any, ...]:
        """Normal numbers that are correlated.

        A name that is fixed at a number does not move the others: they are not conditioned on it.

        Args:
            names: A name for each, a column of the result.
            mean: A mean for each.
            covariance: Their covariance matrix, symmetric, positive definite, fixed numbers.

        Returns:
            The numbers, in the order of the names.

        Examples:
            >>> import qsmc_jax as qj
            >>> covariance = [[0.04, 0.01], [0.01, 0.09]]
            >>> mass, drag = qj.Draw([0.5, 0.5]).multivariate_normal(["mass", "drag"], [1.0, 3.0], covariance)
            >>> float(mass), float(drag)
            (1.0, 3.0)
        """
        require_list("names", names)
        listed, means = ", ".join(map(str, names)), as_float64(mean)
        require_shape(f"mean` of `{listed}", means, (len(names),), "a number for each name")
        factor = factor_of(f"covariance` of `{listed}", covariance, len(names))
        scores, drawn = [], []
        for i, name in enumerate(names):
            centre = self._number(name, "mean", means[i]) + sum(w * z for w, z in zip(factor[i], scores, strict=False))
            u = self._coordinates(name, (), quantiles.normal, centre, factor[i, i])
            scores.append(quantiles.score(u))
            value, bounds = centre + factor[i, i] * scores[-1], (-math.inf, math.inf)
            drawn.append(self._keep(name, "multivariate_normal", value, bounds, size=1))
        return tuple(drawn)

    @contextlib.contextmanager
    def gaussian_copula(self, correlation: Sequence[Any] | np.ndarray | Array) -> Iterator[None]:
        r"""Correlates the numbers that are drawn under it, whatever their distributions, by a Gaussian copula.

        Each keeps its distribution, and takes a coordinate as it would alone. The correlation is that of normal scores;
        Spearman's rank correlation is $6 / \pi \arcsin(\rho / 2)$. A name that is fixed does not move the others.

        Args:
            correlation: The correlation matrix, a row for each number in the order of drawing: symmetric, positive
                definite, 1 on its diagonal, fixed numbers.

        Examples:
            >>> import qsmc_jax as qj
            >>> draw = qj.Draw([0.9, 0.5])
            >>> with draw.gaussian_copula([[1.0, 0.8], [0.8, 1.0]]):
            ...     mass = draw.uniform("mass", 1.0, 2.0)
            ...     drag = draw.lognormal("drag", median=3.0, log_std=0.1)
            >>> round(float(mass), 6), round(float(drag), 4)
            (1.9, 3.3240)
        """
        require(self._copula is None, "A copula must not stand under another: give one correlation matrix for all.")
        self._copula = copula = Copula(correlation_factor(correlation))
        yield
        self._copula = None
        require(
            copula.left == 0,
            f"Argument `correlation` must have a row for every number that is drawn under it, but has {copula.left} "
            "more.",
        )

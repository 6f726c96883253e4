"""Disturbances that switch at known times."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from qsmc_jax.base.checks import is_traced, require, require_finite, require_positive, show
from qsmc_jax.base.module import float_field
from qsmc_jax.base.types import RealScalarLike
from qsmc_jax.model.disturbances.disturbance import AbstractDisturbance, largest_bound, require_disturbances
from qsmc_jax.model.kinks import as_times


class Piecewise(AbstractDisturbance):
    r"""One disturbance after another: piece k rules on $[t_k, t_{k+1})$, in absolute time, the first before $t_1$.

    $\bar d$ is the largest of the pieces' bounds.

    Attributes:
        times: Switching times $t_1 \le t_2 \le \dots$ [s]; of two equal ones the later wins.
        pieces: The disturbances, one more than there are times. Each must be finite outside its own interval too.

    Examples:
        The disturbance of Example 2 of the paper:

        >>> from math import pi
        >>> from qsmc_jax.model.disturbances import Piecewise, Sine
        >>> d = Piecewise([6.0, 9.0], (Sine(0.5, pi / 2), Sine(1.0, pi), Sine(1.0, pi, pi / 2) - 1.0))
        >>> [round(float(d(t)), 3) for t in (1.0, 6.5, 9.0)], float(d.bound)
        ([0.5, 1.0, -2.0], 2.0)
    """

    times: Float[Array, " switches"] = float_field()
    pieces: tuple[AbstractDisturbance, ...] = eqx.field(converter=tuple)

    def __check_init__(self):
        _require_sorted("times", self.times)
        require_disturbances("pieces", self.pieces)
        _require_one_more("pieces", len(self.pieces), "times", np.size(self.times))

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        value = self.pieces[0](t)
        for k, piece in enumerate(self.pieces[1:]):
            value = jnp.where(t >= self.times[k], piece(t), value)
        return value

    @property
    def bound(self) -> RealScalarLike:
        return largest_bound(self.pieces)

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return jnp.concatenate([self.times, *(as_times(piece.break_times) for piece in self.pieces)])


class Telegraph(AbstractDisturbance):
    r"""Piecewise constant: level $v_k$ on $[t_k, t_{k+1})$, level $v_0$ before $t_1$; $\bar d = \max_k |v_k|$.

    Attributes:
        switch_times: Switching times $t_1 \le t_2 \le \dots$ [s]; unused ones at the end hold `inf`.
        levels: Levels $v_0, v_1, \dots$, one more than there are switching times.

    Examples:
        >>> import qsmc_jax as qj
        >>> d = qj.disturbances.Telegraph(switch_times=[1.0, 2.0], levels=[0.5, -0.5, 0.0])
        >>> [float(d(t)) for t in (0.0, 1.0, 2.5)]
        [0.5, -0.5, 0.0]
    """

    switch_times: Float[Array, " switches"] = float_field()
    levels: Float[Array, " levels"] = float_field()

    def __check_init__(self):
        _require_sorted("switch_times", self.switch_times)
        require_finite("levels", self.levels)
        _require_one_more("levels", np.size(self.levels), "switch_times", np.size(self.switch_times))

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        # Counting vectorises over lanes, where a binary search would loop.
        return jnp.asarray(self.levels)[jnp.sum(t >= self.switch_times)]

    @property
    def bound(self) -> RealScalarLike:
        return jnp.max(jnp.abs(self.levels))

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return jnp.asarray(self.switch_times)


class SmoothSteps(AbstractDisturbance):
    r"""Levels joined by ramps twice continuously differentiable, $d(t) = \sum_{k=0}^{K} v_k (S_k(t) - S_{k+1}(t))$.

    $S_0 = 1$, $S_{K+1} = 0$ and $S_k(t) = S((t - t_k)/\tau)$ with the quintic smoothstep
    $S(s) = 6 s^5 - 15 s^4 + 10 s^3$, s clipped to [0, 1]: ramp k starts at $t_k$ and is complete at $t_k + \tau$.
    S grows and the times are sorted, so the weights $S_k - S_{k+1}$ are not negative, and they sum to one: d is always
    a weighted mean of the levels, and $\bar d = \max_k |v_k|$ holds even where ramps overlap.

    Attributes:
        times: Starts of the ramps $t_1 \le t_2 \le \dots$ [s], finite.
        levels: Levels $v_0, v_1, \dots$, one more than there are times.
        rise_time: Duration of a ramp $\tau$ [s], positive.

    Examples:
        >>> import qsmc_jax as qj
        >>> d = qj.disturbances.SmoothSteps(times=[1.0], levels=[0.0, 2.0], rise_time=1.0)
        >>> [float(d(t)) for t in (1.0, 1.5, 2.0)]
        [0.0, 1.0, 2.0]
    """

    times: Float[Array, " switches"] = float_field()
    levels: Float[Array, " levels"] = float_field()
    rise_time: Float[Array, ""] = float_field()

    def __check_init__(self):
        require_finite("times", self.times)
        _require_sorted("times", self.times)
        require_finite("levels", self.levels)
        require_positive("rise_time", self.rise_time)
        _require_one_more("levels", np.size(self.levels), "times", np.size(self.times))

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        s = jnp.clip((t - self.times) / self.rise_time, 0.0, 1.0)
        ramps = s**3 * (10.0 + s * (6.0 * s - 15.0))
        weights = jnp.concatenate([jnp.ones(1), ramps]) - jnp.concatenate([ramps, jnp.zeros(1)])
        return jnp.sum(self.levels * weights)

    @property
    def bound(self) -> RealScalarLike:
        return jnp.max(jnp.abs(self.levels))

    @property
    def break_times(self) -> Float[Array, " breaks"]:
        return jnp.concatenate([self.times, self.times + self.rise_time])


def _require_sorted(name: str, times: Any) -> None:
    if not is_traced(times):
        values = np.ravel(times)
        ok = not np.any(np.isnan(values)) and bool(np.all(values[:-1] <= values[1:]))
        require(ok, f"Argument `{name}` must be sorted, but is {show(times)}. Sort it, and what follows it.")


def _require_one_more(name: str, count: int, times_name: str, times_count: int) -> None:
    require(
        count == times_count + 1,
        f"Argument `{name}` must have {times_count + 1} entries, one more than `{times_name}`, but has {count}.",
    )

"""Recorded data as a function of time: a polynomial on each interval between samples."""

import functools as ft
import importlib
import math
import operator
from collections.abc import Callable
from pathlib import Path
from typing import Any, ClassVar, Literal, TypeAlias, get_args

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from qsmc_jax.base.checks import is_traced, require, require_finite, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.module import AbstractModule, as_float64, float_field
from qsmc_jax.base.types import BoolScalarLike, RealScalarLike
from qsmc_jax.model.csv_columns import read_columns
from qsmc_jax.numerics.places import place, place_on_grid

Kind: TypeAlias = Literal["hold", "linear", "pchip", "cubic"]
Beyond: TypeAlias = Literal["refuse", "hold"]

# How many derivatives are continuous; -1 if the value itself jumps.
_SMOOTHNESS = {"hold": -1, "linear": 0, "pchip": 1, "cubic": 2}
# Within this part of their size times are one and the same up to rounding; the solver keeps apart what is farther.
_ROUNDING = 1e-12
# Part of the spacing by which a sample may be off an even grid.
_UNEVEN = 0.25


class Recording(AbstractModule):
    r"""A measured signal: samples $v_i$ at times $t_i$, and what is between them.

    `"hold"` keeps a sample until the next, `"linear"` draws lines, `"pchip"` monotone cubics that never pass the
    samples (one continuous derivative), `"cubic"` a spline with two. All are a polynomial
    $\sum_k c_{k,i} (t - t_i)^k$ between samples, whose coefficients are made once. It costs the same for a record of
    any length if samples are even, within a quarter of their spacing; else its logarithm.

    A disturbance or a reference is made of it: `qj.disturbances.Recorded(recording)`,
    `qj.references.Recorded(recording)`. Values that are traced can be held or joined by lines.

    Attributes:
        times: Times of the samples [s], increasing, at least two.
        coefficients: $c_{k,i}$, lowest power first, before the first sample, from each sample on, and after the last.
        kind: What is between samples.
        beyond: Outside the record: `"refuse"` (a horizon beyond it is refused, and where it can't be known, the
            signal is NaN) or `"hold"` (the first and last sample stay).
        is_even: Whether the samples lie on an even grid.

    Raises:
        InputError: Times are not increasing, a number is not finite, shapes do not fit, or there are fewer than two.

    Examples:
        >>> import qsmc_jax as qj
        >>> wind = qj.Recording([0.0, 0.1, 0.2], [1.0, 3.0, 2.0], kind="linear")
        >>> round(float(wind(0.05)), 12), float(wind.bound), wind.smoothness
        (2.0, 3.0, 0)

    Source: Fritsch and Carlson (1980), Monotone piecewise cubic interpolation; de Boor (1978), A practical guide to
        splines. Both by SciPy, with its end conditions (not-a-knot for `"cubic"`).
    """

    hint: ClassVar[str] = "Make one: `qj.Recording(times, values)`, or `qj.Recording.from_csv(path, time=, value=)`."

    times: Float[Array, " samples"] = float_field()
    coefficients: Float[Array, "powers pieces"] = float_field()
    kind: Kind = eqx.field(static=True)
    beyond: Beyond = eqx.field(static=True)
    is_even: bool = eqx.field(static=True)

    def __init__(self, times: Any, values: Any, kind: Kind = "linear", beyond: Beyond = "refuse"):
        for name, value, known in (("kind", kind, get_args(Kind)), ("beyond", beyond, get_args(Beyond))):
            require(value in known, f"Argument `{name}` must be one of {list(known)}, but is {value!r}.")
        times, values = as_float64(times), as_float64(values)
        _require_samples(times, values)
        is_smooth = _SMOOTHNESS[kind] > 0
        require(
            not (is_smooth and is_traced(times, values)),
            f'Argument `kind` must be "hold" or "linear" for values that are traced, but is {kind!r}: what SciPy makes '
            "of them is numbers.",
        )
        self.times, self.kind, self.beyond = times, kind, beyond
        self.coefficients = _coefficients(times, values, kind, beyond)
        self.is_even = not is_traced(times) and _is_even(times)

    @classmethod
    def from_csv(
        cls,
        path: str | Path,
        *,
        time: str | int = 0,
        value: str | int = 1,
        kind: Kind = "linear",
        beyond: Beyond = "refuse",
    ) -> "Recording":
        r"""A recording of two columns of a text file, separated by commas.

        Args:
            path: The file, in UTF-8.
            time: Column of the times [s], increasing: its name in the first row, or its number, from 0.
            value: Column of the values.
            kind: What is between samples.
            beyond: What is outside the record.

        Raises:
            InputError: The file can't be read, a column is missing, or a cell is empty, no number or not finite, or
                times are not increasing: with file, column and row.

        Examples:
            >>> import tempfile
            >>> from pathlib import Path
            >>> import qsmc_jax as qj
            >>> with tempfile.TemporaryDirectory() as folder:
            ...     path = Path(folder) / "wind.csv"
            ...     _ = path.write_text("t,speed\n0.0,3.0\n0.5,4.0\n")
            ...     wind = qj.Recording.from_csv(path, time="t", value="speed", kind="hold")
            >>> float(wind(0.2)), float(wind.end)
            (3.0, 0.5)
        """
        return cls(*read_columns(path, time, value), kind=kind, beyond=beyond)

    @property
    def smoothness(self) -> int:
        """How many of its derivatives are continuous; -1 if the value jumps."""
        return _SMOOTHNESS[self.kind] if self.beyond == "refuse" else min(_SMOOTHNESS[self.kind], 0)

    @property
    def degree(self) -> int:
        """Degree of its polynomials."""
        return np.shape(self.coefficients)[0] - 1

    @property
    def end(self) -> RealScalarLike:
        """Time of the last sample [s]."""
        return self.times[-1]

    def __call__(self, t: RealScalarLike) -> RealScalarLike:
        """The signal at time `t` [s]; at a jump, what follows."""
        return self.derivatives(t, 0)[0]

    def derivatives(self, t: RealScalarLike, order: int) -> tuple[RealScalarLike, ...]:
        """The signal and its first derivatives at time `t` [s]; at a jump of one, what follows.

        Args:
            t: Time [s].
            order: Highest derivative, not negative.
        """
        start, piece = self._piece(t)
        values = _polynomial(piece, t - start, order)
        if self.beyond == "hold":
            return values
        return tuple(jnp.where(self._covers(t), value, jnp.nan) for value in values)

    def piece(self, t: RealScalarLike) -> Callable[[RealScalarLike], RealScalarLike]:
        """The polynomial that the signal is around a time: a function of little, right as far as the next samples.

        Args:
            t: Time [s].
        """
        start, piece = self._piece(t)
        return lambda s: _polynomial(piece, s - start, 0)[0]

    def _piece(self, t: RealScalarLike) -> tuple[Array, list[Array]]:
        """The polynomial at time `t`: where it starts, and its coefficients."""
        times = jnp.asarray(self.times)
        i = (place_on_grid if self.is_even else place)(times, t)
        # Row by row, so that each is looked up in a table of its own.
        return times[jnp.maximum(i - 1, 0)], [jnp.asarray(row)[i] for row in self.coefficients]

    def covers(self, horizon: RealScalarLike) -> Bool[Array, ""]:
        """Whether it says what the signal is from the start of a run on.

        Args:
            horizon: Until when [s].
        """
        return jnp.asarray(self.beyond == "hold") | (self._covers(0.0) & self._covers(horizon))

    def _covers(self, t: RealScalarLike) -> Bool[Array, ""]:
        start, end = self.times[0], self.times[-1]
        slack = _ROUNDING * (jnp.abs(start) + jnp.abs(end))
        return jnp.asarray((t >= start - slack) & (t <= end + slack))

    @property
    def bound(self) -> RealScalarLike:
        """The largest absolute value in the record: of its samples, and where a cubic turns between them."""
        starts, length = jnp.asarray(self.coefficients)[0], jnp.diff(jnp.asarray(self.times))
        largest = jnp.max(jnp.abs(starts))
        if self.degree < 2:
            return largest
        piece = [jnp.asarray(row)[1:-1] for row in self.coefficients]
        turns = _turns(*piece[1:])
        inside = jnp.stack([_polynomial(piece, jnp.clip(s, 0.0, length), 0)[0] for s in turns])
        return jnp.maximum(largest, jnp.max(jnp.abs(inside)))

    def steepest(self, m: int) -> RealScalarLike:
        """A bound of a derivative between samples, by the sizes of its coefficients.

        Args:
            m: Order of the derivative, not negative.
        """
        length = jnp.diff(jnp.asarray(self.times))
        sizes = [jnp.abs(jnp.asarray(row)[1:-1]) for row in self.coefficients]
        return jnp.max(_polynomial(sizes, length, m)[m])


def recordings_in(tree: Any) -> list[Recording]:
    """All recordings that a pytree holds."""
    leaves = jax.tree.leaves(tree, is_leaf=lambda node: isinstance(node, Recording))
    return [leaf for leaf in leaves if isinstance(leaf, Recording)]


def is_recorded(tree: Any, horizon: RealScalarLike) -> BoolScalarLike:
    """Whether what is recorded in a pytree covers all times up to a horizon [s]."""
    return ft.reduce(operator.and_, [one.covers(horizon) for one in recordings_in(tree)], jnp.asarray(True))


def require_recorded(tree: Any, horizon: RealScalarLike) -> None:
    """Raises unless what is recorded in a pytree covers all times up to a horizon [s]; traced numbers pass."""
    for one in recordings_in(tree):
        if is_traced(one.times, horizon) or one.beyond == "hold":
            continue
        start, end = float(one.times[0]), float(one.times[-1])
        is_late, wanted = start > _ROUNDING * (abs(start) + abs(end)), show(as_float64(horizon))
        require(
            not is_late,
            f"Argument `times` of a recording must begin at 0 s or before, as runs do, but begins at {show(start)} s. "
            'Shift them, or give `beyond="hold"`: the first sample then stands for what was before.',
        )
        require(
            float(horizon) <= end + _ROUNDING * (abs(start) + abs(end)),
            f"Argument `t1` must not lie beyond a recording that ends at {show(as_float64(end))} s, but is {wanted}. "
            'Shorten the horizon, or give the recording `beyond="hold"`: its last sample then stays.',
        )


def _require_samples(times: Any, values: Any) -> None:
    shape = np.shape(times)
    require(
        len(shape) == 1 and shape[0] >= 2,
        f"Argument `times` must be a list of at least two numbers, but has shape {shape}.",
    )
    require(
        np.shape(values) == shape,
        f"Argument `values` must have shape {shape} (one per time), but has shape {np.shape(values)}.",
    )
    require_finite("times", times)
    require_finite("values", values)
    if not is_traced(times):
        gaps = np.diff(times) > _ROUNDING * np.maximum(np.abs(times[1:]), np.abs(times[:-1]))
        if not np.all(gaps):
            i = int(np.argmin(gaps))
            raise InputError(
                f"Argument `times` must be increasing, but entry {i + 1} is {show(times[i + 1])} after "
                f"{show(times[i])}. Sort them, and keep one sample a time."
            )


def _is_even(times: np.ndarray) -> bool:
    grid = np.linspace(times[0], times[-1], len(times))
    return bool(np.max(np.abs(times - grid)) <= _UNEVEN * (grid[1] - grid[0]))


def _coefficients(times: Any, values: Any, kind: Kind, beyond: Beyond) -> Any:
    """Lowest power first: the piece before the record, those within, and the one after it."""
    xp: Any = jnp if is_traced(times, values) else np
    if kind in ("pchip", "cubic"):
        scipy = importlib.import_module("scipy.interpolate")  # here, for all commands would wait for it
        make = {"pchip": scipy.PchipInterpolator, "cubic": scipy.CubicSpline}[kind]
        inner = make(times, values).c[::-1]
    else:
        slopes = xp.diff(values) / xp.diff(times)
        inner = xp.stack([values[:-1], slopes] if kind == "linear" else [values[:-1]])
    first, last = inner[:, :1], _shifted(xp, inner[:, -1:], times[-1] - times[-2])
    if beyond == "hold" or kind == "hold":
        nothing = xp.zeros_like(first[1:])
        first, last = (xp.concatenate([xp.reshape(v, (1, 1)), nothing]) for v in (values[0], values[-1]))
    return xp.concatenate([first, inner, last], axis=1)


def _shifted(xp: Any, piece: Any, length: Any) -> Any:
    """The coefficients of a polynomial about the end of its interval."""
    powers = range(len(piece))
    return xp.stack([sum(math.comb(j, k) * piece[j] * length ** (j - k) for j in powers if j >= k) for k in powers])


def _polynomial(piece: list[Any], s: Any, order: int) -> tuple[Any, ...]:
    """A polynomial and its first derivatives, by Horner's rule."""
    found = []
    for k in range(order + 1):
        value = jnp.zeros_like(s)
        for j in range(len(piece) - 1, k - 1, -1):
            value = value * s + math.perm(j, k) * piece[j]
        found.append(value)
    return tuple(found)


def _turns(c1: Any, c2: Any, c3: Any) -> tuple[Any, Any]:
    """Where cubics turn, if at all; without loss of digits."""
    q = -(c2 + jnp.copysign(jnp.sqrt(jnp.maximum(c2**2 - 3.0 * c1 * c3, 0.0)), c2))
    quotient = lambda a, b: a / jnp.where(b == 0.0, 1.0, b)  # noqa: E731
    return quotient(q, 3.0 * c3), quotient(c1, q)

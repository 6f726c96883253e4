r"""A traced loop over boxes: values, derivatives, and how fast the faces of a tube would have to move at least.

A program is a list of operations on numbers, in order: `["input", name]`, `["const", hex]`, `["add", i, j]`, ... with i
and j places before. Over a box its value is found by natural interval evaluation, and by the mean value form

$F(x) \in F(x_0) + \sum_i \partial_i F(B) (x_i - x_{0,i})$ for x and $x_0$ in the box B,

with derivatives by the chain rule in interval arithmetic, which holds for Lipschitz functions with Clarke's derivative
(Lebourg), so for `abs`, `max` and `min` too. $x_0$ is Baumann's centre, a corner where something is monotone, which
costs nothing then. Both hold, so does the narrower.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from qsmc_jax.proof.arithmetic import MINUS, ONE, PI, ZERO, Arithmetic, Interval, point

# What an operation is made of: its value, and its derivatives by each operand.
_VALUES: dict[str, Callable[..., Interval]] = {
    "add": lambda ar, a, b: ar.add(a, b),
    "sub": lambda ar, a, b: ar.sub(a, b),
    "mul": lambda ar, a, b: ar.mul(a, b),
    "div": lambda ar, a, b: ar.div(a, b),
    "max": lambda ar, a, b: ar.max(a, b),
    "min": lambda ar, a, b: ar.min(a, b),
    "neg": lambda ar, a: ar.neg(a),
    "abs": lambda ar, a: ar.abs(a),
    "sqrt": lambda ar, a: ar.sqrt(a),
    "exp": lambda ar, a: ar.exp(a),
    "log": lambda ar, a: ar.log(a),
    "sin": lambda ar, a: ar.sin(a),
    "cos": lambda ar, a: ar.cos(a),
    "tan": lambda ar, a: ar.tan(a),
    "atan": lambda ar, a: ar.atan(a),
}
_PARTIALS: dict[str, Callable[..., tuple[Interval, ...]]] = {
    "add": lambda ar, v, a, b: (ONE, ONE),
    "sub": lambda ar, v, a, b: (ONE, MINUS),
    "mul": lambda ar, v, a, b: (b, a),
    "div": lambda ar, v, a, b: (ar.div(ONE, b), ar.neg(ar.div(v, b))),
    "max": lambda ar, v, a, b: (_part(ar, a, b), _part(ar, b, a)),
    "min": lambda ar, v, a, b: (_part(ar, b, a), _part(ar, a, b)),
    "neg": lambda ar, v, a: (MINUS,),
    "abs": lambda ar, v, a: (_sign(ar, a),),
    "sqrt": lambda ar, v, a: (ar.div(point(0.5), v),),
    "exp": lambda ar, v, a: (v,),
    "log": lambda ar, v, a: (ar.div(ONE, a),),
    "sin": lambda ar, v, a: (ar.cos(a),),
    "cos": lambda ar, v, a: (ar.neg(ar.sin(a)),),
    "tan": lambda ar, v, a: (ar.add(ONE, ar.power(v, 2)),),
    "atan": lambda ar, v, a: (ar.div(ONE, ar.add(ONE, ar.power(a, 2))),),
}
OPERATIONS = frozenset({*_VALUES, "input", "const", "power"})


def _part(ar: Arithmetic, a: Interval, b: Interval) -> Interval:
    """How much of max(a, b) is a: 1, 0, or anything between where that is not settled."""
    return Interval(ar.xp.where(a.lo > b.hi, 1.0, 0.0), ar.xp.where(b.lo > a.hi, 0.0, 1.0))


def _sign(ar: Arithmetic, a: Interval) -> Interval:
    return Interval(ar.xp.where(a.lo > 0.0, 1.0, -1.0), ar.xp.where(a.hi < 0.0, -1.0, 1.0))


class Dual(NamedTuple):
    """A value with its derivatives by some inputs; those that are not there are 0."""

    value: Interval
    slopes: Mapping[str, Interval]


def evaluated(
    ar: Arithmetic, program: Sequence[Sequence[Any]], inputs: Mapping[str, Interval], by: Sequence[str] = ()
) -> list[Dual]:
    """All results of a program over boxes.

    Args:
        ar: The arithmetic.
        program: The operations.
        inputs: Boxes of the inputs, by name.
        by: Inputs by which derivatives are wanted.
    """
    found: list[Dual] = []
    for name, *given in program:
        if name == "input":
            found.append(Dual(inputs[given[0]], {given[0]: ONE} if given[0] in by else {}))
        elif name == "const":
            found.append(Dual(point(float.fromhex(given[0])), {}))
        elif name == "power":
            operand, exponent = found[given[0]], int(given[1])
            lower = ONE if exponent == 1 else ar.power(operand.value, exponent - 1)
            slopes = _chained(ar, [operand], [ar.mul(point(float(exponent)), lower)]) if operand.slopes else {}
            found.append(Dual(ar.power(operand.value, exponent), slopes))
        else:
            operands = [found[place] for place in given]
            values = [each.value for each in operands]
            value = _VALUES[name](ar, *values)
            is_fixed = not any(each.slopes for each in operands)
            slopes = {} if is_fixed else _chained(ar, operands, _PARTIALS[name](ar, value, *values))
            found.append(Dual(value, slopes))
    return found


def _chained(ar: Arithmetic, operands: Sequence[Dual], partials: Sequence[Interval]) -> dict[str, Interval]:
    """The chain rule."""
    slopes: dict[str, Interval] = {}
    for operand, partial in zip(operands, partials, strict=True):
        for name, slope in operand.slopes.items():
            term = slope if partial is ONE else partial if slope is ONE else ar.mul(partial, slope)
            slopes[name] = ar.add(slopes[name], term) if name in slopes else term
    return slopes


class Loop(NamedTuple):
    r"""A loop in the coordinates of a tube: $z = (\sigma - m) / \rho$, and the errors E but for the highest.

    Attributes:
        order: Order n of the plant.
        c: Coefficients of the surface.
        names: The uncertain numbers.
        program: Operations of the loop at an instant, of `t`, `z`, `e0`, ..., and the names.
        places: Where in it are `drive` (rate of sigma without d and the tangent, less m' + z rho'), `gain` (what the
            tangent is multiplied by), `rho`, `sigma`, `bound` (of |d|), `plant_gain`, `law_gain`, `offset`, `highest`,
            `residual` (no d).
        start: Operations of the start, of the names.
        starts: Where in it are z and E.
        constant: Numbers of which funnel and reference are made, whose rates are worked out for constant ones.
    """

    order: int
    c: tuple[float, ...]
    names: tuple[str, ...]
    program: Sequence[Sequence[Any]]
    places: Mapping[str, int]
    start: Sequence[Sequence[Any]]
    starts: Sequence[int]
    constant: tuple[str, ...]


class Mode(NamedTuple):
    """A function of time, t**power exp(-rate t) times the cosine or sine of an angle, with its matrix C.

    Attributes:
        power: Power of t.
        rate: How fast it decays [1/s], positive.
        frequency: Angular frequency [rad/s]; 0 for none.
        is_sine: Whether it has the sine.
        c: The matrix, by rows.
    """

    power: int
    rate: float
    frequency: float
    is_sine: bool
    c: np.ndarray

    @property
    def function(self) -> tuple[int, float, float, bool]:
        """What it is of time."""
        return (self.power, self.rate, self.frequency, self.is_sine)


class Frame(NamedTuple):
    r"""How errors are boxed: $E = \Phi(t) E(0) + Q^{-1} v$, with $\Phi = \sum_k C_k f_k$ near $e^{A t}$ and boxes of v.

    The companion matrix A of the surface has $\dot E = A E + B \sigma$. So, exactly,
    $\dot v = M v + b \sigma + Q (A \Phi - \dot\Phi) E(0)$ with $M = Q A Q^{-1}$, $b = Q B$, whatever Q and $\Phi$ are.
    The last term is small if $\Phi$ is what it should be: what starts are, errors remember without a loss.

    Attributes:
        q: Q, lower triangular, by rows.
        inverse: Its inverse.
        m: M.
        b: b, the last column of Q.
        modes: The functions of $\Phi$, with their matrices.
        misses: For each of them the matrix of $Q (A \Phi - \dot\Phi)$.
    """

    q: list[list[Interval]]
    inverse: list[list[Interval]]
    m: list[list[Interval]]
    b: list[Interval]
    modes: Sequence[Mode]
    misses: list[list[list[Interval]]]


def frame_of(ar: Arithmetic, rows: np.ndarray, modes: Sequence[Mode], c: Sequence[float]) -> Frame:
    """The frame of a lower triangular matrix, all in intervals; entries above the diagonal do not count."""
    size = range(len(c))
    q = [[point(float(rows[i][j])) if j <= i else ZERO for j in size] for i in size]
    inverse = [[ZERO for _ in size] for _ in size]
    for j in size:
        for i in size[j:]:
            done = total(ar, [ar.mul(q[i][k], inverse[k][j]) for k in size[j:i]])
            inverse[i][j] = ar.div(ar.sub(ONE if i == j else ZERO, done), q[i][i])
    a = [[ONE if j == i + 1 else ZERO for j in size] for i in size[:-1]]
    a += [[point(-float(each)) for each in c] for _ in size[-1:]]
    m = product(ar, product(ar, q, a), inverse)
    matrices = [[[point(float(each)) for each in row] for row in mode.c] for mode in modes]
    rates = _rates(ar, modes, matrices)
    misses = [
        product(
            ar,
            q,
            [
                [ar.sub(x, y) for x, y in zip(*both, strict=True)]
                for both in zip(product(ar, a, c_k), rate, strict=True)
            ],
        )
        for c_k, rate in zip(matrices, rates, strict=True)
    ]
    return Frame(q, inverse, m, [row[-1] for row in q], modes, misses)


def _rates(ar: Arithmetic, modes: Sequence[Mode], matrices: list[list[list[Interval]]]) -> list[list[list[Interval]]]:
    """The matrices of the rate of the sum of the modes, by mode: a mode's rate is made of itself and others."""
    places = {mode.function: k for k, mode in enumerate(modes)}
    found = [[[ZERO for _ in row] for row in matrix] for matrix in matrices]
    for (power, rate, frequency, is_sine, _), matrix in zip(modes, matrices, strict=True):
        parts = [(-rate, (power, rate, frequency, is_sine))]
        if power:
            parts.append((float(power), (power - 1, rate, frequency, is_sine)))
        if frequency:
            parts.append((frequency if is_sine else -frequency, (power, rate, frequency, not is_sine)))
        for factor, function in parts:
            k = places[function]
            found[k] = [
                [ar.add(x, ar.mul(point(factor), y)) for x, y in zip(*both, strict=True)]
                for both in zip(found[k], matrix, strict=True)
            ]
    return found


def product(ar: Arithmetic, a: list[list[Interval]], b: list[list[Interval]]) -> list[list[Interval]]:
    """The product of two matrices."""
    return [
        [total(ar, [ar.mul(x, row[j]) for x, row in zip(each, b, strict=True)]) for j in range(len(b))] for each in a
    ]


def flow(ar: Arithmetic, frame: Frame, t: Interval) -> tuple[list[list[Interval]], list[list[Interval]]]:
    r"""$\Phi$ and $Q (A \Phi - \dot\Phi)$ over an interval of times that are not negative."""
    functions = [_function(ar, mode, t) for mode in frame.modes]
    size = range(len(frame.q))

    def summed(matrices: Sequence[Sequence[Sequence[Interval]]]) -> list[list[Interval]]:
        pairs = list(zip(functions, matrices, strict=True))
        return [[total(ar, [ar.mul(f, matrix[i][j]) for f, matrix in pairs]) for j in size] for i in size]

    return summed([[[point(float(each)) for each in row] for row in mode.c] for mode in frame.modes]), summed(
        frame.misses
    )


def _function(ar: Arithmetic, mode: Mode, t: Interval) -> Interval:
    """A mode's function of time; t**k exp(-rate t) falls from t = k / rate on, to 0."""

    def at(times: Interval) -> Interval:
        decay = ar.exp(ar.mul(point(-mode.rate), times))
        return ar.mul(ar.power(times, mode.power), decay) if mode.power else decay

    known, first = at(t), at(point(t.lo))
    falls = (ar.mul(point(mode.rate), point(t.lo)).lo >= mode.power) & (mode.rate >= 0.0)
    high = ar.xp.where(falls, first.hi, known.hi)
    size = Interval(ar.xp.where(ar.xp.isnan(known.lo) & falls, 0.0, ar.xp.maximum(known.lo, 0.0)), high)
    if not mode.frequency:
        return size
    angle = ar.mul(point(mode.frequency), t)
    return ar.mul(size, ar.sin(angle) if mode.is_sine else ar.cos(angle))


def total(ar: Arithmetic, terms: Sequence[Interval]) -> Interval:
    """The sum."""
    found = ZERO
    for term in terms:
        found = term if found is ZERO else ar.add(found, term)
    return found


def applied(ar: Arithmetic, matrix: Sequence[Sequence[Interval]], vector: Sequence[Interval]) -> list[Interval]:
    """A matrix times a vector."""
    return [total(ar, [ar.mul(a, v) for a, v in zip(row, vector, strict=True)]) for row in matrix]


class Slab(NamedTuple):
    r"""Boxes of what a tube holds between two knots.

    Attributes:
        t: Times.
        faces: The lower and the upper face of z.
        v: Lower and upper faces of the coordinates of the frame.
        values: The uncertain numbers, by name.
        start: Errors at the start.
        flow: $\Phi$.
        misses: $Q (A \Phi - \dot\Phi) E(0)$.
    """

    t: Interval
    faces: tuple[Interval, Interval]
    v: list[tuple[Interval, Interval]]
    values: Mapping[str, Interval]
    start: list[Interval]
    flow: list[list[Interval]]
    misses: list[Interval]

    @property
    def spans(self) -> list[Interval]:
        """The coordinates of the frame from face to face."""
        return [Interval(low.lo, high.hi) for low, high in self.v]

    def errors(self, ar: Arithmetic, frame: Frame) -> list[Interval]:
        """A box of the errors but for the highest."""
        parts = applied(ar, self.flow, self.start), applied(ar, frame.inverse, self.spans)
        return [ar.add(a, b) for a, b in zip(*parts, strict=True)]


def inside(ar: Arithmetic, loop: Loop, frame: Frame, slab: Slab) -> dict[str, Interval]:
    """The named results of the loop over the whole of a slab, and its input `u`, from edge to edge."""
    z = Interval(slab.faces[0].lo, slab.faces[1].hi)
    errors = {f"e{i}": e for i, e in enumerate(slab.errors(ar, frame))}
    results = evaluated(ar, loop.program, {"t": slab.t, "z": z, **errors, **slab.values})
    found = {name: results[place].value for name, place in loop.places.items()}
    found["u"] = ar.add(found["offset"], ar.neg(ar.mul(found["law_gain"], tangent(ar, z))))
    return {**errors, **found}


def tangent(ar: Arithmetic, z: Interval) -> Interval:
    """tan(pi z / 2)."""
    return ar.tan(ar.mul(ar.mul(PI, point(0.5)), z))


def face_rates(ar: Arithmetic, loop: Loop, frame: Frame, slab: Slab, sides: Any, z: Interval) -> Any:
    """How fast z may go outward on its faces at most, at any disturbance in its bound.

    Args:
        ar: The arithmetic.
        loop: The loop.
        frame: The frame.
        slab: The slab.
        sides: -1 for lower faces and 1 for upper ones, along the first axis.
        z: The faces, along the same axis.
    """
    place, errors = loop.places, slab.errors(ar, frame)
    names, end = [f"e{i}" for i in range(len(errors))], len(loop.program)
    # side (drive - gain tangent) + |bound|, over rho
    program = [
        *loop.program,
        *(["input", "tangent"], ["input", "side"]),
        ["mul", place["gain"], end],
        ["sub", place["drive"], end + 2],
        ["mul", end + 1, end + 3],
        ["abs", place["bound"]],
        ["add", end + 4, end + 5],
        ["div", end + 6, place["rho"]],
    ]
    # Where the gain is not negative, the tangent resists least at the inner end of a face.
    least = tangent(ar, point(ar.xp.where(sides > 0.0, z.lo, z.hi)))
    fixed = {"t": slab.t, "z": z, "tangent": least, "side": point(sides)}
    box = {**slab.values, **dict(zip(names, errors, strict=True))}
    results = evaluated(ar, program, {**fixed, **box}, by=[*names, *loop.names])
    value, slopes = results[-1]
    at = {name: _centre(ar, box[name], slopes.get(name, ZERO)) for name in loop.names}
    by_error = [[slopes.get(name, ZERO) for name in names]]
    parts = [(slab.flow, slab.start), (frame.inverse, slab.spans)]
    moves, reached = [], []
    for matrix, numbers in parts:  # E is a sum of two images of boxes, and a slope by E one by each of these numbers
        turned = product(ar, by_error, matrix)[0] if names else []
        centre = [_centre(ar, box, slope) for box, slope in zip(numbers, turned, strict=True)]
        moves += [ar.mul(slope, ar.sub(n, at)) for slope, n, at in zip(turned, numbers, centre, strict=True)]
        reached.append(applied(ar, matrix, centre))
    for name, a, b in zip(names, *reached, strict=True):
        near = ar.add(a, b)
        at[name] = point(ar.xp.clip(0.5 * (near.lo + near.hi), box[name].lo, box[name].hi))
        moves.append(ar.mul(slopes.get(name, ZERO), ar.sub(near, at[name])))
    middle = evaluated(ar, program, {**fixed, **at})[-1].value
    moves += [ar.mul(slopes[name], ar.sub(box[name], at[name])) for name in loop.names if name in slopes]
    form = ar.add(middle, total(ar, moves)).hi
    is_regular = (results[place["rho"]].value.lo > 0.0) & (results[place["gain"]].value.lo >= 0.0)
    return ar.xp.where(is_regular, ar.xp.where(form < value.hi, form, value.hi), ar.xp.nan)


def _centre(ar: Arithmetic, box: Interval, slope: Interval) -> Interval:
    """The point of a box for which the mean value form of this slope has the least upper bound (Baumann)."""
    up, down = ar.xp.maximum(slope.hi, 0.0), ar.xp.maximum(-slope.lo, 0.0)
    share = ar.xp.where(up + down > 0.0, up / ar.xp.where(up + down > 0.0, up + down, 1.0), 0.5)
    return point(ar.xp.clip(box.lo + share * (box.hi - box.lo), box.lo, box.hi))


def frame_rates(ar: Arithmetic, frame: Frame, slab: Slab, sigma: Interval) -> list[Interval]:
    """For each coordinate of the frame the infimum of its rate on its lower face, and the supremum on its upper one."""
    found = []
    for j, row in enumerate(frame.m):
        rest = [ar.mul(a, span) for k, (a, span) in enumerate(zip(row, slab.spans, strict=True)) if k != j]
        push = total(ar, [*rest, ar.mul(frame.b[j], sigma), slab.misses[j]])
        low, high = (ar.add(ar.mul(row[j], face), push) for face in slab.v[j])
        found.append(Interval(low.lo, high.hi))
    return found

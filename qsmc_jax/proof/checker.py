r"""The checker of proofs: NumPy, arithmetic.py and field.py, no JAX. It trusts nothing of how a proof was found.

**What is proved.** A tube gives, at knots in time, faces $Z^- < Z^+$ of $z = (\sigma - m)/\rho$ and of coordinates v of
the errors but the highest, $E = \Phi(t) E(0) + Q^{-1} v$, joined by lines. If, on each slab between two knots,
the upper face of each rises at least as fast as that number can, anywhere on that face, for any uncertain number in its
box and any disturbance $|d| \le \bar d$, and lower faces likewise, then a run that starts in the tube stays in it.

*Proof.* Let f, g be locally Lipschitz in the state, and all faces be moved outward by $\varepsilon e^{Lt}$. The bounds
of the rates are found by inclusion, so they hold on the moved faces too, where they are larger by at most
$L' \varepsilon e^{Lt}$, for they depend on the faces in a Lipschitz way. With $L > L'$ the moved faces outrun every
run that touches them: none crosses, for every $\varepsilon > 0$. Since the tube is bounded and lies in $|z| < 1$, where
the law is smooth, the run exists as long as the tube does. Nothing is asked of how disturbances and numbers of a box
depend on time or state, but that they are measurable and solutions exist; only numbers of which funnel and reference
are made are constant, since the rates of these are worked out so. $\square$

**How it branches.** The uncertainty set is cut by a binary tree of (number, place) whose leaves are boxes, each with a
tube of its own up to a common time; so the boxes cover it by construction, for numbers that do not vary from one box
to another: those by which it is cut are constant. From then on one tube, the trunk, holds them
all for the whole set; a last slab that reaches to infinity, if there is one, has constant faces.
"""

import json
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from qsmc_jax.proof.arithmetic import ONE, ZERO, Arithmetic, Interval, point
from qsmc_jax.proof.field import (
    OPERATIONS,
    Frame,
    Loop,
    Mode,
    Slab,
    applied,
    evaluated,
    face_rates,
    flow,
    frame_of,
    frame_rates,
    inside,
    product,
)

FORMAT = 1
PROOF, TUBES = "proof.json", "tubes.npz"
PROVED, NOT_PROVED = "PROVED", "NOT_PROVED"
# Slabs that are looked at together: as many as fit a processor's cache.
_TOGETHER = 4096
_SIDES = np.array([-1.0, 1.0])
_PLACES = {"drive", "gain", "rho", "sigma", "bound", "plant_gain", "law_gain", "offset", "highest", "residual"}


class RefusedError(ValueError):
    """A proof that does not hold, with the reason."""


class Tube(NamedTuple):
    """Faces at knots, for some boxes.

    Attributes:
        times: Knots [s] by box, K + 1 each.
        z: Faces of z by box, knot, and side.
        v: Faces of the coordinates of errors by box, knot, coordinate and side.
    """

    times: np.ndarray
    z: np.ndarray
    v: np.ndarray

    def of(self, boxes: Any, knots: Any = slice(None)) -> "Tube":
        """The tubes of some boxes between some knots."""
        return Tube(self.times[boxes, knots], self.z[boxes, knots], self.v[boxes, knots])


class Certificate(NamedTuple):
    r"""What is to be checked.

    Attributes:
        loop: The loop.
        domain: Ends of each uncertain number.
        tree: Cuts of the domain, in preorder: [number, place] or, for a leaf, [].
        frame: Q, by rows.
        modes: The functions of $\Phi$.
        leaves: The tubes of the leaves.
        trunk: The tube of all from then on.
        tail: The slab to infinity; None if there is none.
    """

    loop: Loop
    domain: np.ndarray
    tree: list[list[Any]]
    frame: np.ndarray
    modes: list[Mode]
    leaves: Tube
    trunk: Tube
    tail: Tube | None


class Bounds(NamedTuple):
    """What holds for every run up to `until`."""

    peak_u: float
    peak_ratio: float
    peak_errors: list[float]
    least_gain: float
    until: float


def require(holds: Any, reason: str) -> None:
    """Raises `RefusedError` unless something holds throughout; NaN holds nothing."""
    if not np.all(holds):
        raise RefusedError(reason)


def leaves_of(domain: np.ndarray, tree: Sequence[Sequence[Any]]) -> Iterator[np.ndarray]:
    """The boxes of a tree's leaves, in order: a cut gives its lower part first."""
    waiting = [np.array(domain, float)]
    for cut in tree:
        require(len(waiting) > 0, "the tree of boxes has more nodes than cuts")
        box = waiting.pop()
        if not cut:
            yield box
            continue
        number, place = int(cut[0]), float(cut[1])
        require(0 <= number < len(box) and box[number, 0] < place < box[number, 1], "a cut lies outside its box")
        lower, upper = box.copy(), box.copy()
        lower[number, 1] = upper[number, 0] = place
        waiting += [upper, lower]
    require(not waiting, "the tree of boxes is not complete")


def named(loop: Loop, boxes: np.ndarray) -> dict[str, Interval]:
    """Boxes, by row, as intervals by name."""
    return {name: Interval(boxes[:, i, :1], boxes[:, i, 1:]) for i, name in enumerate(loop.names)}


def slab_of(ar: Arithmetic, loop: Loop, frame: Frame, tube: Tube, boxes: np.ndarray) -> Slab:
    """What a tube holds between its knots: the hull of two neighbours, face by face."""

    def face(knots: np.ndarray) -> Interval:
        return Interval(np.minimum(knots[:, :-1], knots[:, 1:]), np.maximum(knots[:, :-1], knots[:, 1:]))

    faces = face(tube.z[..., 0]), face(tube.z[..., 1])
    v = [(face(tube.v[:, :, j, 0]), face(tube.v[:, :, j, 1])) for j in range(tube.v.shape[2])]
    t, start = Interval(tube.times[:, :-1], tube.times[:, 1:]), start_of(ar, loop, boxes)[1]
    phi, misses = flow(ar, frame, t)
    return Slab(t, faces, v, named(loop, boxes), start, phi, applied(ar, misses, start))


def _slopes(ar: Arithmetic, faces: np.ndarray, times: np.ndarray) -> np.ndarray:
    """How fast faces move outward at least, by side along the last axis; exactly 0 where one does not move."""
    first, last = faces[:, :-1] * _SIDES, faces[:, 1:] * _SIDES
    span = ar.sub(point(times[:, 1:]), point(times[:, :-1]))
    shape = (*span.lo.shape, *(1,) * (faces.ndim - 2))
    slope = ar.div(ar.sub(point(last), point(first)), Interval(span.lo.reshape(shape), span.hi.reshape(shape)))
    return np.where(first == last, 0.0, slope.lo)


class Margins(NamedTuple):
    """By how much faces outrun what is inside: the tube holds where no number is negative. Shapes as in `Tube`."""

    z: np.ndarray
    v: np.ndarray

    @property
    def hold(self) -> Any:
        """Where they do, by box and slab; NaN does not."""
        return (self.z >= 0.0).all(axis=2) & (self.v >= 0.0).all(axis=(2, 3))


def margins(
    ar: Arithmetic, loop: Loop, frame: Frame, tube: Tube, boxes: np.ndarray
) -> tuple[Margins, dict[str, Interval]]:
    """How well some tubes hold, slab by slab, and what the loop does inside."""
    slab = slab_of(ar, loop, frame, tube, boxes)
    found = inside(ar, loop, frame, slab)
    faces = Interval(*(np.stack(ends) for ends in zip(*slab.faces, strict=True)))
    rates = face_rates(ar, loop, frame, slab, _SIDES[:, None, None], faces)
    z, v = _slopes(ar, tube.z, tube.times) - np.moveaxis(rates, 0, -1), _slopes(ar, tube.v, tube.times)
    for j, rate in enumerate(frame_rates(ar, frame, slab, found["sigma"])):
        v[..., j, 0] += rate.lo
        v[..., j, 1] -= rate.hi
    return Margins(z, v), found


def start_of(ar: Arithmetic, loop: Loop, boxes: np.ndarray) -> tuple[Interval, list[Interval]]:
    """Where runs of some boxes start: z, and the errors but the highest."""
    results = evaluated(ar, loop.start, named(loop, boxes))
    whole = np.zeros((len(boxes), 1))  # what depends on no number is the same in all boxes
    z, *errors = (Interval(*(end + whole for end in results[place].value)) for place in loop.starts)
    return z, errors


def first_of(ar: Arithmetic, loop: Loop, frame: Frame, boxes: np.ndarray) -> tuple[Interval, list[Interval]]:
    """What tubes have to hold at time 0: z, and v = Q (1 - Phi(0)) E(0), almost 0."""
    z, errors = start_of(ar, loop, boxes)
    phi = flow(ar, frame, point(np.zeros((1, 1))))[0]
    rest = [[ar.sub(ONE if i == j else ZERO, x) for j, x in enumerate(row)] for i, row in enumerate(phi)]
    return z, applied(ar, product(ar, frame.q, rest), errors)


def verify(certificate: Certificate) -> Bounds:
    """Checks everything and returns what follows.

    Raises:
        RefusedError: It does not hold, or is not what it should be.
    """
    with np.errstate(all="ignore"):
        return _verify(certificate)


def _verify(certificate: Certificate) -> Bounds:
    ar, loop = Arithmetic(), certificate.loop
    leaves, trunk, tail = certificate.leaves, certificate.trunk, certificate.tail
    _require_loop(loop)
    boxes = np.stack(list(leaves_of(certificate.domain, certificate.tree)))
    require(np.isfinite(certificate.domain) & (certificate.domain[:, :1] <= certificate.domain), "the domain is no box")
    frame = frame_of(ar, certificate.frame, certificate.modes, loop.c)
    require(leaves.times[:, 0] == 0.0, "the tubes do not start at 0")
    require(len(leaves.z) == len(boxes), "there is not one tube for each box")
    z, v = first_of(ar, loop, frame, boxes)
    require(_within(z, leaves.z[:, 0]), "a run starts outside of its tube")
    require([_within(e, leaves.v[:, 0, j]) for j, e in enumerate(v)], "a run starts with errors outside of its tube")
    found, each = [], max(1, _TOGETHER // leaves.times.shape[1])
    for i in range(0, len(boxes), each):
        found += _holds(ar, loop, frame, leaves.of(slice(i, i + each)), boxes[i : i + each], "a leaf")
    whole = certificate.domain[None]
    _require_follows(leaves, trunk)
    found += _holds(ar, loop, frame, trunk, whole, "the trunk")
    if tail is not None:
        require(tail.times.shape == (1, 2) and tail.times[0, 1] == np.inf, "the last slab does not reach to infinity")
        require([np.array_equal(a[:, 0], a[:, 1]) for a in (tail.z, tail.v)], "faces move in the last slab")
        _require_follows(trunk, tail)
        found += _holds(ar, loop, frame, tail, whole, "the last slab")
    until = float(trunk.times[0, -1]) if tail is None else float("inf")
    worst = np.max(np.array(found), axis=0)
    return Bounds(float(worst[0]), float(worst[1]), [float(e) for e in worst[3:]], float(-worst[2]), until)


def _holds(ar: Arithmetic, loop: Loop, frame: Frame, tube: Tube, boxes: np.ndarray, where: str) -> list[list[float]]:
    """Raises unless some tubes hold, part by part; returns what they bound."""
    require(tube.times.ndim == 2 and len(tube.times) == len(boxes), f"{where} has knots of the wrong shape")
    shape = tube.times.shape
    require(tube.z.shape == (*shape, 2), f"{where} has faces of the wrong shape")
    require(tube.v.shape == (*shape, loop.order - 1, 2), f"{where} has errors of the wrong shape")
    require(tube.times[:, 1:] > tube.times[:, :-1], f"the knots of {where} are not in order")
    require((np.abs(tube.z) < 1.0).all() and (tube.z[..., 0] <= tube.z[..., 1]).all(), f"{where} is not in the funnel")
    require((tube.v[..., 0] <= tube.v[..., 1]) & np.isfinite(tube.v).all(axis=-1), f"{where} has faces that cross")
    found = []
    for i in range(0, shape[1] - 1, _TOGETHER):
        part = tube.of(slice(None), slice(i, i + _TOGETHER + 1))
        held, results = margins(ar, loop, frame, part, boxes)
        if not held.hold.all():
            first = np.min(part.times[:, :-1][~held.hold])
            raise RefusedError(f"{where} does not hold: a face is too slow at t = {first:.6g} s")
        errors = [*(results[f"e{i}"] for i in range(loop.order - 1)), results["highest"]]
        gain = results["plant_gain"]
        sizes = [ar.abs(results["u"]).hi, np.max(np.abs(part.z)), -gain.lo, *(ar.abs(e).hi for e in errors)]
        numbers = [float(np.max(size)) for size in sizes]
        require(np.isfinite(numbers), f"{where} has a bound that is not finite")
        require(gain.lo > 0.0, f"{where} holds states where the gain may be 0, or of the wrong sign")
        found.append(numbers)
    return found


def _within(interval: Interval, faces: np.ndarray) -> Any:
    return np.all((faces[:, :1] <= interval.lo) & (interval.hi <= faces[:, 1:]))


def _require_follows(before: Tube, after: Tube) -> None:
    """Raises unless one tube begins where others end, and holds them all."""
    require(before.times[:, -1] == after.times[0, 0], "there is a gap in time between two tubes")
    for a, b in ((before.z[:, -1], after.z[:, 0]), (before.v[:, -1], after.v[:, 0])):
        require(
            (b[..., 0] <= a[..., 0]).all() and (a[..., 1] <= b[..., 1]).all(), "a tube does not hold those before it"
        )


def _require_loop(loop: Loop) -> None:
    """Raises unless the programs are made of known operations, each of results before it."""
    known = {"t", "z", *(f"e{i}" for i in range(loop.order - 1)), *loop.names}
    require(len(known) == 2 + loop.order - 1 + len(loop.names), "two inputs have the same name")
    require(len(loop.c) == loop.order - 1 and len(loop.starts) == loop.order, "the order of the loop is not clear")
    for program, inputs in ((loop.program, known), (loop.start, set(loop.names))):
        for here, (name, *given) in enumerate(program):
            require(name in OPERATIONS, f"operation `{name}` is not known")
            if name == "input":
                require(given[0] in inputs, f"input `{given[0]}` is not known")
            elif name != "const":
                places = given[:1] if name == "power" else given
                require([0 <= int(place) < here for place in places], "an operation comes before its operand")
                require(name != "power" or given[1] >= 1, "a power is below 1")
    require(set(loop.constant) <= set(loop.names), "a number that has to be constant is not there")
    require(set(loop.places) == _PLACES, "the results of the loop are not those wanted")
    require([0 <= p < len(loop.program) for p in loop.places.values()], "a result is not there")
    require([0 <= p < len(loop.start) for p in loop.starts], "a start is not there")


def read(folder: Path) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """The content of a folder: what is claimed of what, and arrays of knots.

    Raises:
        RefusedError: It can't be read.
    """
    try:
        content = json.loads((folder / PROOF).read_text(encoding="utf-8"))
        if not (folder / TUBES).exists():
            return content, {}
        with np.load(folder / TUBES, allow_pickle=False) as found:
            return content, {name: found[name] for name in found.files}
    except Exception as error:  # noqa: BLE001  # whatever a damaged file may raise
        raise RefusedError(f"it can't be read: {type(error).__name__}: {error}") from None


def certificate_of(content: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Certificate:
    """The certificate that a folder holds; numbers are texts that name doubles exactly."""
    numbers = np.vectorize(float.fromhex, otypes=[float])
    raw = content["loop"]
    plain = {name: tuple(raw[name]) for name in ("names", "constant")}
    loop = Loop(**{**raw, **plain, "c": tuple(map(float.fromhex, raw["c"]))})
    size = (loop.order - 1, loop.order - 1)
    frame = numbers(content["frame"]).reshape(size) if loop.order > 1 else np.zeros(size)
    modes = [Mode(m[0], float.fromhex(m[1]), float.fromhex(m[2]), m[3], numbers(m[4])) for m in content["modes"]]
    domain = numbers(content["domain"]).reshape(-1, 2) if loop.names else np.zeros((0, 2))
    tree = [[cut[0], float.fromhex(cut[1])] if cut else [] for cut in content["tree"]]
    tubes = {
        part: Tube(*(arrays[f"{part}_{name}"] for name in Tube._fields))
        for part in ("leaves", "trunk", "tail")
        if f"{part}_times" in arrays
    }
    return Certificate(loop, domain, tree, frame, modes, tubes["leaves"], tubes["trunk"], tubes.get("tail"))


def check(content: Mapping[str, Any], arrays: Mapping[str, np.ndarray]) -> Bounds:
    """Checks what a folder holds: its tubes, and that what it claims is what follows from them.

    Args:
        content: What it claims of what.
        arrays: Knots of its tubes.

    Raises:
        RefusedError: It does not hold.
    """
    try:
        require(content["format"] == FORMAT, f"it has format {content['format']}, this version reads {FORMAT}")
        require(content["verdict"] == PROVED, "it says itself that nothing is proved")
        bounds = verify(certificate_of(content, arrays))
        claims = content["claims"]
    except RefusedError:
        raise
    except Exception as error:  # noqa: BLE001  # a damaged certificate may fail anywhere
        raise RefusedError(f"it can't be checked: {type(error).__name__}: {error}") from None
    follows = claims_of(bounds)
    wrong = [name for name in {**claims, **follows} if claims.get(name) != follows.get(name)]
    require(not wrong, f"what it claims of {', '.join(wrong)} is not what follows from its tubes")
    return bounds


def claims_of(bounds: Bounds) -> dict[str, Any]:
    """Bounds as texts that name doubles exactly."""
    hexed = lambda value: [each.hex() for each in value] if isinstance(value, list) else value.hex()  # noqa: E731
    return {name: hexed(value) for name, value in bounds._asdict().items()}


if __name__ == "__main__":
    try:
        print(check(*read(Path(sys.argv[1]))))  # noqa: T201
    except RefusedError as refusal:
        print(f"The proof does not hold: {refusal}.", file=sys.stderr)  # noqa: T201
        sys.exit(2)

"""The search for a proof: a tree of boxes, a tube for each, and one for all that follows."""

import dataclasses
import math
from typing import Any

import numpy as np

from qsmc_jax.control.error_bounds import poles
from qsmc_jax.proof.arithmetic import Arithmetic
from qsmc_jax.proof.checker import Certificate, Margins, Tube, first_of, margins, slab_of
from qsmc_jax.proof.field import Loop, frame_of, inside
from qsmc_jax.proof.frames import frame_for, modes_for
from qsmc_jax.proof.guess import SIZES, SLABS, Faces, Guess, Pace
from qsmc_jax.proof.traced import UnprovenError

# Batches of slabs of a box at most up to the time from which one tube holds all, and of that one after it.
_BATCHES, _MOST = 8, 48
# The first and the longest slab, as a share of the horizon; how slabs grow, as a share of the time; and how far a face
# may move in one, as a share of its distance from the funnel's edge.
_FIRST, _LONGEST, _GROWTH, _MOVE = 1e-6, 1.0 / 2048, 1.0 / 24, 0.04
# Which boxes are cut together: those whose bound is so near to the worst.
_NEAR = 0.9
# Slabs that are checked together.
_TOGETHER = 8192
# Where the bound of the input has fallen to this share of its peak, boxes need not be told apart any more.
_CALM = 0.5
# How much finer the tubes of a proof are than those by which it is looked for; how fine where the checker says that one
# does not hold, in turn; and how coarse where faces only have to come to rest.
_FINE, _FINER, _COARSE = 0.25, (1.0, 0.25, 0.06), 8.0
# How much wider a tube is made that does not move any more, in turn.
_WIDER, _LEAST = (1e-9, 1e-6, 1e-3, 1e-2), 0.2


@dataclasses.dataclass
class Leaf:
    """A box, its tube up to the time where boxes are joined, the bound of its input, and what it was cut into."""

    box: np.ndarray
    bound: float = math.inf
    tube: Tube | None = None
    cut: tuple[int, float] | None = None
    parts: "tuple[Leaf, ...]" = ()

    def leaves(self) -> "list[Leaf]":
        """Those that are not cut, in order."""
        return [leaf for part in self.parts for leaf in part.leaves()] if self.parts else [self]

    def tree(self) -> list[list[Any]]:
        """All cuts, in preorder."""
        return [list(self.cut), *(cut for part in self.parts for cut in part.tree())] if self.cut else [[]]


class Search:
    """Looks for a certificate.

    Args:
        loop: The loop.
        domain: Ends of its uncertain numbers.
        horizon: Until when [s].
    """

    def __init__(self, loop: Loop, domain: np.ndarray, horizon: float):
        self.loop, self.domain, self.horizon = loop, domain, horizon
        self.rows, self.modes = frame_for(loop.c), modes_for(loop.c)
        self._ar = Arithmetic()
        self._frame = frame_of(self._ar, self.rows, self.modes, loop.c)
        self._pace = Pace(_FIRST * horizon, _GROWTH, _LONGEST * horizon, _MOVE)
        self._guess = Guess(loop, self._frame)

    def run(self, boxes: int, target: float) -> Certificate:
        """A certificate of at most so many boxes; of fewer if the bound of the input is at most the target before.

        Raises:
            UnprovenError: None is found.
        """
        with np.errstate(all="ignore"):
            self._require_begin()
            until, calm = self._first()
            root = Leaf(self.domain)
            self._bound([root], until)
            self._branch(root, until, boxes, max(target, calm))
            self._refine(root.leaves(), until)
            leaves = self._leaves(root.leaves(), until)
            trunk = self._trunk(leaves)
            return Certificate(
                self.loop, self.domain, root.tree(), self.rows, self.modes, leaves, trunk, self._tail(trunk)
            )

    def _refine(self, leaves: list[Leaf], until: float) -> None:
        """Gives boxes finer tubes, the worst first, until the bound is that of a finer one."""
        leaves, worst = sorted(leaves, key=lambda leaf: -leaf.bound), -math.inf
        for i in range(0, len(leaves), SIZES[-1]):
            if leaves[i].bound <= worst:
                return
            self._bound(leaves[i : i + SIZES[-1]], until, _FINE)
            worst = max(worst, *(leaf.bound for leaf in leaves[i : i + SIZES[-1]]))

    def _leaves(self, leaves: list[Leaf], until: float) -> Tube:
        """Tubes of the boxes that hold."""
        found = [self._finer(leaf.box, (0.0, until)) if leaf.tube is None else leaf.tube for leaf in leaves]
        most, boxes = max(tube.times.shape[1] for tube in found), np.array([leaf.box for leaf in leaves])
        each = max(1, _TOGETHER // most)
        for i in range(0, len(leaves), each):
            part = _joined([_filled(tube, most) for tube in found[i : i + each]])
            for k in np.flatnonzero(~self._margins(part, boxes[i : i + each]).hold.all(axis=1)):
                found[i + k] = self._finer(boxes[i + k], (0.0, until))
                most = max(most, found[i + k].times.shape[1])
        return _joined([_filled(tube, most) for tube in found])

    def _finer(self, box: np.ndarray, span: tuple[float, float], start: Faces | None = None) -> Tube:
        """A tube of a box of which the checker says that it holds, as fine as need be."""
        start, reason = self._starts(box[None]) if start is None else start, ""
        for finer in _FINER:
            tube, u = self._along(start, box, span, self._pace.finer(finer))
            if tube.times[0, -1] < span[1]:
                raise UnprovenError(_reason(tube, u))
            held = self._margins(tube, box[None]).hold[0]
            if held.all():
                return tube
            reason = (
                f"{int(np.sum(~held))} slabs are refused, the first at t = {tube.times[0, int(np.argmin(held))]:.6g} s"
            )
        raise UnprovenError(f"no tube was found that holds: {reason}")

    def _starts(self, boxes: np.ndarray) -> Faces:
        """Faces at time 0."""
        z, v = first_of(self._ar, self.loop, self._frame, boxes)
        faces = lambda interval: np.stack([np.broadcast_to(end[:, 0], len(boxes)) for end in interval], -1)  # noqa: E731
        return faces(z), np.stack([faces(each) for each in v], 1) if v else np.zeros((len(boxes), 0, 2))

    def _require_begin(self) -> None:
        """Raises where it can be told at once that there is no proof."""
        for root in poles(np.asarray(self.loop.c, float)):
            if not root.imag < -root.real:
                raise UnprovenError(
                    f"the surface has the roots {root.real:.4g} +- {root.imag:.4g}j: boxes of errors grow where these "
                    "swing faster than they decay. Choose `c` with an imaginary part below the real one"
                )
        whole = self.domain[None]
        z, v = self._starts(whole)
        size = float(np.max(np.abs(z)))
        if not size < 1.0:
            raise UnprovenError(
                f"starts may lie outside the funnel, up to |sigma| / rho = {size:.4g} (condition C1). Start nearer, or "
                "in a wider funnel"
            )
        now = Tube(np.zeros((1, 2)), np.stack([z, z], 1), np.stack([v, v], 1))
        gain = inside(self._ar, self.loop, self._frame, slab_of(self._ar, self.loop, self._frame, now, whole))[
            "plant_gain"
        ]
        low, high = float(np.min(gain.lo)), float(np.max(gain.hi))
        if not low > 0.0:
            what = "has the wrong sign" if high < 0.0 else "may be 0" if math.isfinite(low) else "is not bounded"
            raise UnprovenError(f"the gain {what} at the start: times `gain_sign` it lies in [{low:.4g}, {high:.4g}]")

    def _first(self) -> tuple[float, float]:
        """When boxes are joined, and the bound of the input from then on, by one tube for all."""
        tube, u = self._along(self._starts(self.domain[None]), self.domain, (0.0, self.horizon), self._pace)
        if tube.times.shape[1] == 1:
            raise UnprovenError(_reason(tube, u))
        times, u = tube.times[0], np.append(u, np.inf if tube.times[0, -1] < self.horizon else 0.0)
        later = np.maximum.accumulate(u[::-1])[::-1]
        calm = np.flatnonzero(later <= _CALM * later[0]) if np.isfinite(later[0]) else []
        first = int(calm[0]) if len(calm) else len(times) - 1
        first = min(first, SLABS * _BATCHES // 2)
        return float(times[first]), float(later[first]) if len(calm) and first == calm[0] else 0.0

    def _worth(self, until: float, leaf: Leaf) -> np.ndarray:
        """What halving each number is worth in a box, for each width of it as a share of the domain's."""
        halves = []
        for number, middle in enumerate(leaf.box.mean(axis=1)):
            halves += _halves(leaf.box, number, float(middle))
        self._bound(halves, until)
        bounds = np.array([half.bound for half in halves]).reshape(-1, 2).max(axis=1)
        sizes = leaf.box[:, 1] - leaf.box[:, 0]
        widths = self.domain[:, 1] - self.domain[:, 0]
        gain = np.where(np.isfinite(bounds), np.maximum(leaf.bound - bounds, 1e-6), 1e-9)
        gain = np.where(np.isfinite(gain), gain, 1.0)
        return np.where(sizes > 0.0, gain * widths / np.where(sizes > 0.0, sizes, 1.0), 0.0)

    def _bound(self, leaves: list[Leaf], until: float, finer: float = 1.0) -> None:
        """Gives boxes their tubes, and bounds of their inputs, infinite where a tube leaves the funnel."""
        pace, slabs = self._pace.finer(finer), SLABS * math.ceil(_BATCHES / finer)
        for size, i in _batches(len(leaves)):
            part = leaves[i : i + size]
            boxes = np.array([leaf.box for leaf in part])
            tubes, u = self._guess.along(self._starts(boxes), boxes, (0.0, until), pace, slabs)
            for k, leaf in enumerate(part):
                leaf.tube = _used(tubes.of(slice(k, k + 1)))
                is_whole = leaf.tube.times[0, -1] == until
                leaf.bound = float(np.max(u[k, : leaf.tube.times.shape[1] - 1])) if is_whole else math.inf
                leaf.tube = leaf.tube if is_whole else None

    def _branch(self, root: Leaf, until: float, boxes: int, target: float) -> None:
        """Cuts the worst boxes where it pays most, until there are enough or the target is met."""
        widths = np.maximum(self.domain[:, 1] - self.domain[:, 0], 2.0**-1022)
        while len(leaves := root.leaves()) < boxes:
            worst = sorted((leaf for leaf in leaves if leaf.bound > target), key=lambda leaf: -leaf.bound)
            if not worst:
                break
            least = _NEAR * worst[0].bound if math.isfinite(worst[0].bound) else math.inf
            chosen = [leaf for leaf in worst if leaf.bound >= least][: min(boxes - len(leaves), SIZES[-1] // 2)]
            worth = self._worth(until, chosen[0])
            if not np.any(worth > 0.0):
                break
            for leaf in chosen:
                number = int(np.argmax(worth * (leaf.box[:, 1] - leaf.box[:, 0]) / widths))
                middle = float(0.5 * (leaf.box[number, 0] + leaf.box[number, 1]))
                leaf.cut, leaf.parts = (number, middle), _halves(leaf.box, number, middle)
            self._bound([part for leaf in chosen for part in leaf.parts], until)

    def _margins(self, tube: Tube, boxes: np.ndarray) -> Margins:
        return margins(self._ar, self.loop, self._frame, tube, boxes)[0]

    def _along(self, start: Faces, box: np.ndarray, span: tuple[float, float], pace: Pace) -> tuple[Tube, np.ndarray]:
        """One tube of a box, as far as it goes, and bounds of |u| slab by slab."""
        tube, u = self._guess.along(start, box[None], span, pace, SLABS * _MOST)
        tube = _used(tube)
        return tube, u[0, : tube.times.shape[1] - 1]

    def _trunk(self, leaves: Tube) -> Tube:
        """One tube for all boxes from their end to the horizon."""
        first, last = float(leaves.times[0, -1]), self.horizon
        start = _hull(leaves.z[:, -1]), _hull(leaves.v[:, -1])
        return self._finer(self.domain, (first, last if last > first else first * (1.0 + 2.0**-20)), start)

    def _tail(self, trunk: Tube) -> Tube | None:
        """Faces that need not move any more from the end of the trunk on; None if none are found."""
        begin, whole = float(trunk.times[0, -1]), self.domain[None]
        start = trunk.z[:, -1], trunk.v[:, -1]
        rest = self._guess.steady(start, whole, begin, self.horizon, self._pace.finer(_COARSE))
        # Each coordinate follows the next, and the last the sliding variable: the first needs most room.
        shares = _LEAST, np.linspace(1.0, 0.5, trunk.v.shape[2], endpoint=False)
        for more in _WIDER:
            ends = []
            for a, b, share in zip(start, rest, shares, strict=True):
                low, high = np.minimum(a[..., 0], b[..., 0]), np.maximum(a[..., 1], b[..., 1])
                room = share * more * (high - low)
                ends.append(np.stack([low - room, high + room], -1))
            still = Tube(np.array([[begin, math.inf]]), *(np.stack([each, each], 1) for each in ends))
            if np.all(np.abs(still.z) < 1.0) and self._margins(still, whole).hold.all():
                return still
        return None


def _halves(box: np.ndarray, number: int, middle: float) -> tuple[Leaf, Leaf]:
    """The two parts of a box that is cut."""
    lower, upper = box.copy(), box.copy()
    lower[number, 1] = upper[number, 0] = middle
    return Leaf(lower), Leaf(upper)


def _used(tube: Tube) -> Tube:
    """A tube without the slabs that are empty, or in which it leaves the funnel."""
    inside = np.all(np.isfinite(tube.z), axis=(0, 2)) & np.all(np.abs(tube.z) < 1.0, axis=(0, 2))
    is_used = np.append(True, np.diff(tube.times[0]) > 0.0) & np.logical_and.accumulate(inside)
    return tube.of(slice(None), slice(0, int(np.sum(is_used))))


def _filled(tube: Tube, slabs: int) -> Tube:
    """The same tube with so many knots: further ones lie on its faces, within its longest slabs."""
    while (more := slabs - tube.times.shape[1]) > 0:
        longest = np.sort(np.argsort(np.diff(tube.times[0]))[-more:])
        tube = Tube(*(np.insert(x, longest + 1, 0.5 * (x[:, longest] + x[:, longest + 1]), axis=1) for x in tube))
    return tube


def _joined(tubes: list[Tube]) -> Tube:
    """The tubes of several boxes as one."""
    return Tube(*(np.concatenate(each) for each in zip(*tubes, strict=True)))


def _batches(count: int) -> list[tuple[int, int]]:
    """Sizes and places of batches for so many boxes."""
    size = min((each for each in SIZES if each >= count), default=SIZES[-1])
    return [(size, i) for i in range(0, count, size)]


def _hull(faces: np.ndarray) -> np.ndarray:
    """Faces that hold those of all boxes."""
    return np.stack([faces[..., 0].min(axis=0), faces[..., 1].max(axis=0)], -1)[None]


def _reason(tube: Tube, u: np.ndarray) -> str:
    """Where a tube ends that leaves the funnel."""
    last = f", where the bound of |u| is {u[-1]:.4g}" if len(u) else ""
    return (
        f"no tube was found beyond t = {tube.times[0, -1]:.6g} s{last}: the drift is not bounded there, or the gain "
        "may be 0, or boxes are too large. More boxes may help"
    )

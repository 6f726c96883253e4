"""What acts on the sliding variable at most while a run is in its funnel, whatever keeps it there."""

from typing import NamedTuple

import numpy as np

from qsmc_jax.base.checks import require
from qsmc_jax.base.errors import InputError
from qsmc_jax.control.error_bounds import poles
from qsmc_jax.proof.arithmetic import ZERO, Arithmetic, Interval, point
from qsmc_jax.proof.checker import Tube, first_of, margins, slab_of
from qsmc_jax.proof.field import Frame, Loop, Slab, evaluated, frame_of, frame_rates, total
from qsmc_jax.proof.frames import frame_for, modes_for
from qsmc_jax.proof.traced import UnprovenError, traced
from qsmc_jax.study.study import Study, require_study

# The first slab as a share of the horizon; how slabs grow, as a share of the time; the longest as a share of the
# horizon, and of the time in which the fastest root decays; and how many there may be.
_FIRST, _GROWTH, _LONGEST, _FAST, _MOST = 1e-6, 1.0 / 24, 1.0 / 512, 0.1, 20_000
# Slopes of a slab are found by so many evaluations; what is added to one, and of it.
_ROUNDS, _ROOM, _SHARE = 6, 1e-9, 1e-6
_SIDES = np.array([-1.0, 1.0])


class ResidualBound(NamedTuple):
    """Bounds that are certain while a run is in its funnel, as the sufficient limits of `qj.thresholds` want them.

    Attributes:
        residual: Bound W on |w|, in units of the sliding variable per second, the disturbance and the law's offset
            included.
        gain_bounds: Least and largest gain with the law's, times `gain_sign`.
        ratio0: Bound on |sigma - m| / rho at the start [-].
        until: Until when all this holds [s]: the horizon.

    Examples:
        >>> import qsmc_jax as qj
        >>> qj.ResidualBound(2.0, (0.5, 1.0), 0.1, 20.0).gain_bounds
        (0.5, 1.0)
    """

    residual: float
    gain_bounds: tuple[float, float]
    ratio0: float
    until: float


def residual_bound(study: Study) -> ResidualBound:
    r"""Bounds of residual, gain and start that are certain for every run of a study while it is in its funnel.

    Whatever law keeps it there, sampled, limited or switching: so `qj.thresholds.sufficient_period`,
    `sufficient_saturation` and `qj.controllers.Sign.for_bound` can be asked. The set of errors that a sliding variable
    in its funnel may cause is boxed slab by slab in interval arithmetic, as in `qj.certify`, which covers the same
    loops, and whose bounds are tighter but hold under the ideal law alone.

    Args:
        study: The study; what its draws may give is the uncertainty set.

    Returns:
        The bounds.

    Raises:
        InputError: The study has what no proof covers; or something is not bounded.

    Examples:
        An integrator with |d| <= 0.5 that follows sin t, whose rate is up to 1:

        >>> import qsmc_jax as qj
        >>> class Integrator(qj.AbstractPlant):
        ...     order = 1
        ...     def drift(self, t, x):
        ...         return 0.0
        ...     def gain(self, t, x):
        ...         return 2.0
        >>> def scenario(draw):
        ...     law = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0=2.0, mu=1.0, rho_inf=1.0))
        ...     wave, d = qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Constant(0.5)
        ...     loop = qj.ClosedLoop(Integrator(), wave, d, law)
        ...     return qj.Scenario(loop, x0=[draw.uniform("x0", -0.5, 0.5)], t1=10.0)
        >>> study = qj.Study(scenario, bandwidth=1.5)
        >>> found = qj.residual_bound(study)
        >>> round(found.residual, 6), found.gain_bounds, round(found.ratio0, 6)
        (1.5, (2.0, 2.0), 0.166667)
        >>> funnel = study.nominal.loop.control.funnel
        >>> qj.thresholds.sufficient_period(found.residual, found.gain_bounds, funnel, found.ratio0).period > 0.0
        True

    Source: derived here, as for `qj.certify` with the faces of the sliding variable at the funnel's edges.
    """
    require_study(study)
    try:
        loop, domain, horizon = traced(study)
    except UnprovenError as error:
        raise InputError(f"Argument `study` must be covered by proofs: {error}.") from None
    ar = Arithmetic()
    frame = frame_of(ar, frame_for(loop.c), modes_for(loop.c), loop.c)
    with np.errstate(all="ignore"):
        z, start = first_of(ar, loop, frame, domain[None])
        tube = _errors(ar, loop, frame, domain[None], start, _knots(loop, horizon))
        held = margins(ar, loop, frame, tube, domain[None])[0].v >= 0.0
        found = _inside(ar, loop, frame, tube, domain[None])
    residual, bound, gain = (found[name] for name in ("residual", "bound", "gain"))
    total = ar.add(ar.abs(residual), ar.abs(bound)).hi
    numbers = float(np.max(total)), float(np.min(gain.lo)), float(np.max(gain.hi)), float(np.max(ar.abs(z).hi))
    require(
        bool(np.all(held)) and bool(np.all(np.isfinite(numbers))),
        "Argument `study` must have a residual that is bounded in the funnel, but none was found. The drift or the "
        "gain may be infinite there; or roots of the surface swing faster than they decay, so that boxes of errors "
        "grow.",
    )
    return ResidualBound(numbers[0], numbers[1:3], numbers[3], horizon)


def _knots(loop: Loop, horizon: float) -> np.ndarray:
    """Times between which errors are boxed."""
    fastest = max((abs(root) for root in poles(np.asarray(loop.c, float))), default=0.0)
    longest = min(_LONGEST * horizon, _FAST / fastest if fastest else np.inf)
    longest = max(longest, horizon / _MOST)
    found = [0.0]
    while found[-1] < horizon:
        found.append(min(horizon, found[-1] + min(_FIRST * horizon + _GROWTH * found[-1], longest)))
    return np.array(found)


def _errors(
    ar: Arithmetic, loop: Loop, frame: Frame, boxes: np.ndarray, start: list[Interval], times: np.ndarray
) -> Tube:
    """Boxes of the errors' coordinates from knot to knot, if sigma is anywhere in the funnel."""
    size = len(start)
    v = np.array([[np.min(each.lo), np.max(each.hi)] for each in start]).reshape(size, 2)
    # What pushes them depends on time alone: all slabs at once.
    at_rest = _tube(times[None], np.zeros((1, len(times), size, 2)))
    sigma = _inside(ar, loop, frame, at_rest, boxes)["sigma"]
    pushes = [sigma, *slab_of(ar, loop, frame, at_rest, boxes).misses]
    ends = [[np.broadcast_to(end, (1, len(times) - 1))[0] for end in push] for push in pushes]
    found = [v]
    for k, span in enumerate(np.diff(times)):
        first, *misses = (Interval(low[k], high[k]) for low, high in ends)
        v = v + span * _slopes(ar, frame, v, span, first, misses) * _SIDES
        found.append(v)
    return _tube(times[None], np.stack(found)[None])


def _slopes(
    ar: Arithmetic, frame: Frame, v: np.ndarray, span: float, sigma: Interval, misses: list[Interval]
) -> np.ndarray:
    """How fast faces have to move outward in a slab."""
    slope = np.zeros_like(v)
    for turn in range(_ROUNDS if len(v) else 0):
        after = v + span * slope * _SIDES
        low, high = np.minimum(v, after), np.maximum(v, after)
        faces = [(Interval(a[0], b[0]), Interval(a[1], b[1])) for a, b in zip(low, high, strict=True)]
        slab = Slab(ZERO, (ZERO, ZERO), faces, {}, [], [], misses)
        rates = np.array([[-rate.lo, rate.hi] for rate in frame_rates(ar, frame, slab, sigma)])
        rates = rates + _ROOM + _SHARE * np.abs(rates)
        slope = rates if turn < _ROUNDS // 2 else np.maximum(slope, rates)
    return slope


def _tube(times: np.ndarray, v: np.ndarray) -> Tube:
    """A tube whose faces of z are the funnel's edges."""
    return Tube(times, np.broadcast_to(_SIDES, (*times.shape, 2)), v)


def _inside(ar: Arithmetic, loop: Loop, frame: Frame, tube: Tube, boxes: np.ndarray) -> dict[str, Interval]:
    """The named results of the loop in each slab, anywhere in the funnel."""
    slab = slab_of(ar, loop, frame, tube, boxes)
    errors = {f"e{i}": e for i, e in enumerate(slab.errors(ar, frame))}
    inputs = {"t": slab.t, "z": Interval(-1.0, 1.0), **errors, **slab.values}
    names = ["z", *errors, *loop.names]
    results = evaluated(ar, loop.program, inputs, by=names)
    middles = {name: point(0.5 * (inputs[name].lo + inputs[name].hi)) for name in names}
    centre = evaluated(ar, loop.program, inputs | middles)
    found = {}
    for name, place in loop.places.items():  # the narrower of natural evaluation and mean value form
        value, slopes = results[place]
        moves = [ar.mul(slope, ar.sub(inputs[each], middles[each])) for each, slope in slopes.items()]
        form = ar.add(centre[place].value, total(ar, moves))
        narrower = form.lo > value.lo, form.hi < value.hi  # NaN is not
        found[name] = Interval(*(np.where(*each) for each in zip(narrower, form, value, strict=True)))
    return found

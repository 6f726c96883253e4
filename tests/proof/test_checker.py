"""The checker against exact solutions and 100 digits: it accepts what is so, and nothing else."""

import math

import mpmath
import numpy as np
import pytest

from proof import proofs
from qsmc_jax.proof.arithmetic import Arithmetic, Interval
from qsmc_jax.proof.checker import Certificate, RefusedError, Tube, slab_of, verify
from qsmc_jax.proof.field import face_rates, frame_of, frame_rates, inside
from qsmc_jax.proof.frames import frame_for, modes_for
from qsmc_jax.proof.traced import traced

NARROW, BEGIN, END = 1e-6, 0.5, 0.05


def exact(t, gain, width, begin):
    """z of s' = -g tan(pi z / 2), s = width z: sin(pi z / 2) decays."""
    decayed = math.sin(0.5 * math.pi * begin) * np.exp(-0.5 * math.pi * gain * t / width)
    return np.arcsin(decayed) / (0.5 * math.pi)


def tube_around_the_solution(above, below):
    """A certificate of one run without a disturbance, whose faces are so far from its exact solution."""
    study = proofs.still(reach=0.6).substitute(d=0.0, x0=BEGIN)
    loop, domain, _ = traced(study)
    times = np.linspace(0.0, END, 100_001)
    z = exact(times, 1.0, proofs.WIDTH, BEGIN)
    room = np.stack([-below(times), above(times)], -1)
    half = len(times) // 2
    none, faces = np.zeros((1, half + 1, 0, 2)), (z[:, None] + room)[None]
    first, last = (Tube(times[None, part], faces[:, part], none) for part in (slice(0, half + 1), slice(half, None)))
    return Certificate(loop, domain, [[]], frame_for(loop.c), modes_for(loop.c), first, last, None)


def wide(times):
    return np.full_like(times, NARROW)


def test_a_tube_so_narrow_as_a_millionth_around_the_exact_solution_holds():
    bounds = verify(tube_around_the_solution(wide, wide))
    assert bounds.peak_ratio == pytest.approx(BEGIN, abs=2 * NARROW)
    assert bounds.until == END


@pytest.mark.parametrize("side", ["above", "below"])
def test_a_tube_that_the_exact_solution_leaves_by_a_millionth_is_refused(side):
    """Its face begins right, and is beyond the solution by a millionth in the end."""

    def crossing(times):
        return NARROW - 2.0 * NARROW * times / END

    faces = {"above": wide, "below": wide} | {side: crossing}
    with pytest.raises(RefusedError, match="does not hold"):
        verify(tube_around_the_solution(**faces))


def test_a_tube_that_starts_narrower_than_the_runs_is_refused():
    with pytest.raises(RefusedError, match="starts outside"):
        verify(tube_around_the_solution(lambda t: 0.0 * t - 1e-9, wide))


def pendulum(t, x, p):
    """Example 1: drift, gain, funnel and its rate, reference and derivatives, bound of d; from the paper."""
    length, m, k = p["length"], p["mass"], p["friction"]
    drift = -mpmath.mpf(9.8) / length * mpmath.sin(x[0]) - k / m * x[1] + mpmath.sin(x[1])
    decay = mpmath.mpf(3.0)
    rho = 4 * mpmath.exp(-decay * t) + mpmath.mpf(0.05)
    desired = [mpmath.sin(t), mpmath.cos(t), -mpmath.sin(t)]
    return drift, 1 / (m * length**2), rho, -decay * (rho - mpmath.mpf(0.05)), desired, mpmath.mpf(0.5)


def fourth(t, x, p):
    """Example 2 likewise."""
    drift = p["drift_scale"] * (x[2] * mpmath.sin(2 * x[1]) + x[0] * mpmath.cos(x[3]))
    rho = p["rho0"] * mpmath.exp(-p["mu"] * t) + p["rho_inf"]
    quarter = mpmath.mpf(math.pi / 2)

    def wave(k):
        turned = k * mpmath.pi / 2
        return mpmath.sin(t + turned) + mpmath.mpf(0.5) ** k * mpmath.sin(t / 2 + quarter + turned)

    rate = -p["mu"] * (rho - p["rho_inf"])
    return drift, p["gain_scale"] * (2 - mpmath.sin(x[3])), rho, rate, [wave(k) for k in range(5)], mpmath.mpf(1.5)


def between(rng, interval, i=0):
    """A number of an interval, often one of its ends."""
    low, high = (float(np.ravel(end)[i if np.size(end) > 1 else 0]) for end in interval)
    return mpmath.mpf(float(np.clip(rng.choice([low, high, rng.uniform(low, high)]), low, high)))


def phi(frame, t):
    """The flow that the errors remember their start by, and its rate."""

    def at(t):
        total = mpmath.zeros(len(frame.q))
        for power, rate, frequency, is_sine, c in frame.modes:
            wave = 1 if not frequency else mpmath.sin(frequency * t) if is_sine else mpmath.cos(frequency * t)
            total += t**power * mpmath.exp(-mpmath.mpf(rate) * t) * wave * mpmath.matrix(np.asarray(c).tolist())
        return total

    step = mpmath.mpf(10) ** -30
    return at(t), (at(t + step) - at(t - step)) / (2 * step)


@pytest.mark.parametrize(
    ("number", "plant", "count"),
    [
        (1, pendulum, 20),
        (2, fourth, 20),
        pytest.param(1, pendulum, 1000, marks=pytest.mark.slow),
        pytest.param(2, fourth, 250, marks=pytest.mark.slow),
    ],
)
def test_no_rate_in_a_random_slab_is_beyond_its_bound(number, plant, count):
    """Against the paper's formulas with 100 digits, for slabs of all widths, at any point of them."""
    rng, ar = np.random.default_rng([number, count]), Arithmetic()
    loop, domain, _ = traced(proofs.example(number))
    frame = frame_of(ar, frame_for(loop.c), modes_for(loop.c), loop.c)
    size = loop.order - 1
    for _ in range(count):
        scale = 10.0 ** rng.uniform(-6.0, 0.0)
        ends = np.sort(rng.uniform(0.0, 1.0, (len(loop.names), 2)), axis=1)
        ends[:, 1] = ends[:, 0] + scale * (ends[:, 1] - ends[:, 0])
        box = domain[:, :1] + ends * (domain[:, 1:] - domain[:, :1])
        t = rng.choice([0.0, rng.uniform(0.0, 1.0), rng.uniform(0.0, 20.0)])
        if rng.random() < 0.5:  # all that is wide is the face
            box[:, 1] = box[:, 0]
        times = np.array([[t, t + 0.1 * scale * rng.uniform() * rng.integers(2)]])
        small, moves = 0.01 * scale * rng.integers(2), rng.uniform(-1.0, 1.0, 2)
        z = np.sort(rng.uniform(-0.98, 0.98, 2)) + np.array([[[0.0], [0.02 * scale]]]) * moves
        v = np.sort(rng.normal(0.0, 0.3, (1, 1, size, 2)), axis=-1) + small * rng.normal(0.0, 1.0, (1, 2, size, 2))
        v = np.stack([v.min(axis=-1), v.max(axis=-1)], -1)
        slab = slab_of(ar, loop, frame, Tube(times, z, v), box[None])
        with mpmath.workdps(100):
            holds_at_a_point(rng, ar, plant, loop, frame, slab)


def holds_at_a_point(rng, ar, plant, loop, frame, slab):
    sides = np.array([-1.0, 1.0])
    faces = Interval(*(np.stack(ends) for ends in zip(*slab.faces, strict=True)))
    upmost = face_rates(ar, loop, frame, slab, sides[:, None, None], faces).ravel()
    rates, found = frame_rates(ar, frame, slab, inside(ar, loop, frame, slab)["sigma"]), inside(ar, loop, frame, slab)
    size = range(loop.order - 1)
    t, p = between(rng, slab.t), {name: between(rng, each) for name, each in slab.values.items()}
    start = mpmath.matrix([between(rng, each) for each in slab.start])
    flow, flow_rate = phi(frame, t)
    q = mpmath.matrix([[mpmath.mpf(float(each.lo)) for each in row] for row in frame.q])
    c = [mpmath.mpf(each) for each in loop.c]
    for side, z, upper in ((-1, slab.faces[0], upmost[0]), (1, slab.faces[1], upmost[1])):
        v = mpmath.matrix([between(rng, each) for each in slab.spans])
        e = list(flow * start + mpmath.lu_solve(q, v))
        z = between(rng, z)
        _, _, rho, rho_rate, desired, bound = plant(t, [0] * loop.order, p)
        sigma = z * rho
        e.append(sigma - mpmath.fdot(c, e))
        x = [a + b for a, b in zip(e, desired[:-1], strict=True)]
        drift, gain = plant(t, x, p)[:2]
        u = -mpmath.tan(mpmath.pi * z / 2)
        for d in (-bound, bound, 0):
            rate = drift + gain * u + d - desired[-1] + mpmath.fdot(c, e[1:])
            assert side * (rate - z * rho_rate) / rho <= mpmath.mpf(float(upper))
        bounds = found["u"]
        assert float(bounds.lo.ravel()[0]) <= u <= float(bounds.hi.ravel()[0])
    for j in size:  # on one face of each coordinate, anywhere within the others
        for k, limit in ((0, rates[j].lo), (1, rates[j].hi)):
            v = mpmath.matrix([between(rng, each) for each in slab.spans])
            v[j] = between(rng, slab.v[j][k])
            e = flow * start + mpmath.lu_solve(q, v)
            highest = between(rng, Interval(slab.faces[0].lo, slab.faces[1].hi)) * rho - mpmath.fdot(c, list(e))
            moves = mpmath.matrix([*list(e)[1:], highest]) - flow_rate * start
            rate = (q * moves)[j]
            limit = mpmath.mpf(float(np.ravel(limit)[0]))
            assert rate >= limit if k == 0 else rate <= limit

"""The entry points: a proof for a study, and proofs read and checked again."""

import math
from pathlib import Path
from typing import Any

import numpy as np

from qsmc_jax.base.checks import require, require_count
from qsmc_jax.base.errors import InputError
from qsmc_jax.proof.checker import (
    FORMAT,
    NOT_PROVED,
    PROVED,
    Certificate,
    RefusedError,
    Tube,
    check,
    claims_of,
    read,
    verify,
)
from qsmc_jax.proof.field import Loop
from qsmc_jax.proof.result import Proof
from qsmc_jax.proof.search import Search
from qsmc_jax.proof.traced import UnprovenError, traced
from qsmc_jax.study.study import Study, require_study


def certify(study: Study, boxes: int = 64, target: float | None = None) -> Proof:
    r"""Bounds that are certain for every run of a study, by a proof that can be checked.

    They are of the input, the funnel ratio, the errors and the gain.
    For all starts and uncertain numbers within what the study's distributions can give, and for every measurable
    disturbance within its bound, also one that depends on the state: the sliding variable stays in its funnel, and the
    bounds hold. Probabilities play no part. Numbers of the plant, and of the law's gain, may vary in time, unless boxes
    are told apart by them; those of funnel and reference are constant along a run: `constant` of the result names them.

    A tube is guessed in floating point, and checked slab by slab in interval arithmetic with outward rounding. The
    result is NOT_PROVED, with the reason, where none is found that holds: this says nothing against the loop.

    Covered are ideal loops of a chain of integrators under `QuasiSlidingControl`, with a fixed surface, a reference
    that is a function of time, and functions without jumps or cases: so funnels that end at a time, `FiniteTime` and
    `PrescribedTime`, are not. Functions of the study are taken as they compute on real numbers, with its constants as
    the doubles they are; of `derivatives` of the reference each is taken to be the derivative of the one before, as the
    rates of a funnel of one's own are taken for its rates.

    Args:
        study: The study; what its draws may give is the uncertainty set.
        boxes: At most so many boxes of starts and parameters are told apart: more give a tighter bound of the input.
        target: The bound of |u| that is enough; None for the best that so many boxes give.

    Returns:
        The verdict with its bounds; `print` it, `save` it for `qsmc check`.

    Raises:
        InputError: The study has what no proof covers, or a draw without bounds; the message names it.

    Examples:
        >>> import qsmc_jax as qj
        >>> class Tank(qj.AbstractPlant):
        ...     order = 1
        ...     def drift(self, t, x):
        ...         return -x[0]
        ...     def gain(self, t, x):
        ...         return 1.0
        >>> def scenario(draw):
        ...     law = qj.QuasiSlidingControl(qj.SlidingSurface([]), qj.Funnel(rho0=1.0, mu=1.0, rho_inf=0.2))
        ...     loop = qj.ClosedLoop(Tank(), qj.references.Constant(0.0), qj.disturbances.Constant(0.5), law)
        ...     return qj.Scenario(loop, x0=[draw.uniform("level", -0.5, 0.5)], t1=10.0)
        >>> proof = qj.certify(qj.Study(scenario, bandwidth=0.5), boxes=1)
        >>> proof.verdict, proof.until, proof.peak_u < 0.8
        ('PROVED', inf, True)
    """
    require_study(study)
    require_count("boxes", boxes)
    require(target is None or target > 0.0, f"Argument `target` must be positive, but is {target}.")
    try:
        loop, domain, horizon = traced(study)
        certificate = Search(loop, domain, horizon).run(boxes, -math.inf if target is None else target)
        claims = claims_of(verify(certificate))
    except (UnprovenError, RefusedError) as error:
        return Proof({**_about(study), "verdict": NOT_PROVED, "reason": f"{error}."}, {})
    return Proof(
        {**_about(study), "verdict": PROVED, "reason": "", **_told(certificate), "claims": claims}, _arrays(certificate)
    )


def load_proof(folder: Path, study: Study | None = None) -> Proof:
    """A proof from its folder, checked again from end to end.

    Args:
        folder: Where it was saved.
        study: The study that it should be of; None to take its word.

    Raises:
        InputError: It is no proof, does not hold, or is of another study.
    """
    try:
        content, arrays = read(folder)
        if content["verdict"] == NOT_PROVED:
            str(Proof(content, {}))  # says why
        else:
            check(content, arrays)
        if study is not None:
            _require_same(content, study)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001  # whatever a damaged file may raise
        told = error if isinstance(error, RefusedError) else f"{type(error).__name__}: {error}"
        raise InputError(f"Folder `{folder}` must hold a proof that holds, but does not: {told}.") from None
    return Proof(content, arrays)


def _require_same(content: dict[str, Any], study: Study) -> None:
    """Raises unless a proof is of this study: of its code, its program and its uncertainty set."""
    own = _about(study.substitute(**{name: np.array(value) for name, value in content["values"].items()}))
    differ = [name for name in ("study", "bandwidth") if own[name] != content[name]]
    require(not differ, f"The study must be that of the proof, but differs in: {', '.join(differ)}.")
    if content["verdict"] == PROVED:
        loop, domain, horizon = traced(study.substitute(**{n: np.array(v) for n, v in content["values"].items()}))
        now = {"loop": _loop(loop), "domain": _hexed(domain), "horizon": horizon.hex()}
        differ = [name for name, value in now.items() if value != content[name]]
        require(not differ, f"The study must be that of the proof, but another {', '.join(differ)} is traced.")


def _about(study: Study) -> dict[str, Any]:
    """What a proof is of."""
    values = {name: np.asarray(value).tolist() for name, value in sorted(study.values.items())}
    parts = [list(part) for part in study.contents]
    return {"format": FORMAT, "study": parts, "bandwidth": study.bandwidth, "values": values}


def _told(certificate: Certificate) -> dict[str, Any]:
    """A certificate but for its arrays, as JSON has it."""
    tree = [[cut[0], float(cut[1]).hex()] if cut else [] for cut in certificate.tree]
    modes = [[m.power, m.rate.hex(), m.frequency.hex(), m.is_sine, _hexed(np.asarray(m.c))] for m in certificate.modes]
    frame, horizon = _hexed(certificate.frame), float(certificate.trunk.times[0, -1]).hex()
    boxes = {"domain": _hexed(certificate.domain), "tree": tree}
    return {"loop": _loop(certificate.loop), **boxes, "frame": frame, "modes": modes, "horizon": horizon}


def _loop(loop: Loop) -> dict[str, Any]:
    told = loop._asdict()
    plain = {"names": list(loop.names), "places": dict(loop.places), "constant": list(loop.constant)}
    return {**told, "c": [each.hex() for each in loop.c], **plain}


def _hexed(array: np.ndarray) -> list[list[str]]:
    return [[float(each).hex() for each in row] for row in array]


def _arrays(certificate: Certificate) -> dict[str, np.ndarray]:
    """The knots, by the names of files."""
    found: dict[str, np.ndarray] = {}
    tubes: dict[str, Tube | None] = {"leaves": certificate.leaves, "trunk": certificate.trunk, "tail": certificate.tail}
    for part, tube in tubes.items():
        found |= {} if tube is None else {f"{part}_{name}": each for name, each in tube._asdict().items()}
    return found

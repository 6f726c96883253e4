"""A study as what is to be proved: its loop as a program, its uncertain numbers as a box."""

import math
from typing import Any

import jax
import numpy as np

from qsmc_jax.base.checks import is_traced, require, show
from qsmc_jax.base.errors import InputError
from qsmc_jax.base.precision import in_64_bits
from qsmc_jax.control.law import QuasiSlidingControl
from qsmc_jax.loop import ClosedLoop
from qsmc_jax.model.plants import AbstractPlant
from qsmc_jax.model.references import AbstractReference
from qsmc_jax.proof.arithmetic import Arithmetic, Interval
from qsmc_jax.proof.field import Loop, evaluated
from qsmc_jax.proof.flatten import Flattener, live
from qsmc_jax.study.draw import Draw
from qsmc_jax.study.specs import RECORDED, DrawSpec
from qsmc_jax.study.study import Scenario, Study

PLACES = ("drive", "gain", "rho", "sigma", "bound", "plant_gain", "law_gain", "offset", "highest", "residual")


class UnprovenError(Exception):
    """Why nothing is proved, in words."""


def traced(study: Study) -> tuple[Loop, np.ndarray, float]:
    """The loop of a study as a program, the ends of its uncertain numbers, and its horizon.

    Args:
        study: The study.

    Raises:
        InputError: The study has what a proof does not cover, by name.
        UnprovenError: An operation has no enclosure, by name.
    """
    loop, law, _ = _covered(study.nominal)
    order, drawn = loop.order, [spec for spec in study.specs if _is_free(study, spec)]
    made = Flattener()
    places = {spec.name: made.inputs(spec.columns, spec.shape) for spec in drawn}
    errors = [f"e{i}" for i in range(order - 1)]
    inputs = [made.inputs([name]) for name in ("t", "z", *errors)]
    stand_ins = {name: jax.ShapeDtypeStruct(each.shape, np.float64) for name, each in places.items()}
    number = jax.ShapeDtypeStruct((), np.float64)
    with in_64_bits():
        field = jax.make_jaxpr(lambda t, z, e, values: _field(study, t, z, e, values))(
            number, number, (number,) * (order - 1), stand_ins
        )
        start = jax.make_jaxpr(lambda values: _start(study, values))(stand_ins)
        moving = jax.make_jaxpr(lambda t, values: _moving(study, t, values))(number, stand_ins)
        given = [places[name] for name in sorted(places)]
        found = dict(zip(PLACES, (int(each) for each in made.run(field, [*inputs, *given])), strict=True))
        begins = [int(each) for each in made.run(start, given)]
        moved = live(made.operations, [int(each) for each in made.run(moving, [inputs[0], *given])])[0]
    found["bound"] = made.number(_bound(made, found["bound"], drawn))
    program, at = live(made.operations, list(found.values()))
    begin, (horizon, *starts) = live(made.operations, begins)
    _require_known(program + begin)
    require(begin[horizon][0] == "const", "Argument `study` must have a fixed horizon `t1` for a proof, but draws it.")
    names = [each for spec in drawn for each in spec.columns if ["input", each] in program or ["input", each] in begin]
    domain = np.array([_ends(spec) for spec in drawn for each in spec.columns if each in names]).reshape(-1, 2)
    c = tuple(float(each) for each in np.asarray(law.surface.c))
    constant = tuple(name for name in names if ["input", name] in moved)
    made_of = Loop(order, c, tuple(names), program, dict(zip(PLACES, at, strict=True)), begin, starts, constant)
    return made_of, domain, float.fromhex(begin[horizon][1])


def _bound(made: Flattener, place: int, drawn: list[DrawSpec]) -> float:
    """The bound of the disturbance, whatever is drawn: one number, so that draws for it alone do not count."""
    program, (bound,) = live(made.operations, [place])
    _require_known(program)
    ends = {name: _ends(spec) for spec in drawn for name in spec.columns if ["input", name] in program}
    values = {name: Interval(np.float64(low), np.float64(high)) for name, (low, high) in ends.items()}
    with np.errstate(all="ignore"):
        found = float(np.max(np.abs(evaluated(Arithmetic(), program, values)[bound].value)))
    require(math.isfinite(found), f"Argument `study` must have a bounded disturbance, but its bound may be {found:g}.")
    return found


def _covered(scenario: Scenario) -> tuple[ClosedLoop, QuasiSlidingControl, AbstractPlant]:
    """The loop of a scenario, with its law and its plant, if a proof covers such loops."""
    loop, what = scenario.loop, None
    if not isinstance(loop, ClosedLoop):
        what = "has several inputs"
    elif loop.implementation is not None:
        what = "has an implementation: it is sampled"
    elif not isinstance(loop.plant, AbstractPlant):
        what = f"has a plant in its own coordinates, `{type(loop.plant).__name__}`"
    elif not isinstance(loop.reference, AbstractReference):
        what = f"has a reference model, `{type(loop.reference).__name__}`"
    elif not isinstance(loop.control, QuasiSlidingControl):
        what = f"has another law, `{type(loop.control).__name__}`"
    if what is not None:
        raise InputError(
            f"Argument `study` must be of an ideal loop under `QuasiSlidingControl`, of a plant that is a chain of "
            f"integrators, to be certified, but {what}. Proofs do not cover that; `qj.verify` does."
        )
    assert isinstance(loop, ClosedLoop)
    assert isinstance(loop.control, QuasiSlidingControl)
    assert isinstance(loop.plant, AbstractPlant)
    return loop, loop.control, loop.plant


def _is_free(study: Study, spec: DrawSpec) -> bool:
    return spec.is_drawn and spec.kind != RECORDED and spec.name not in study.values


def _ends(spec: DrawSpec) -> tuple[float, float]:
    """The support of what is drawn under a name."""
    low, high = spec.bounds
    if math.isfinite(low) and math.isfinite(high):
        return low, high
    if spec.kind in ("uniform", "log_uniform", "truncated_normal", "triangular", "beta", "choice", "sign", "empirical"):
        raise InputError(
            f"Name `{spec.name}` must have fixed bounds for a proof, but they depend on other names. Draw a factor "
            "between fixed bounds instead, and multiply."
        )
    raise InputError(
        f"Name `{spec.name}` must be bounded for a proof, but is drawn by `{spec.kind}` from [{show(low)}, "
        f"{show(high)}]. Draw it truncated, by `draw.truncated_normal` or `draw.uniform`: what is proved holds then at "
        "a probability of at least 1 - P(a number lies outside), for the numbers as they are drawn here."
    )


def _scenario(study: Study, values: dict[str, Any]) -> Scenario:
    scenario = study.scenario(Draw(np.full(study.dimension, 0.5), {**study.numbers, **values}))
    require(
        not is_traced(_covered(scenario)[1].surface.c),
        "Argument `study` must have a fixed sliding surface for a proof, but draws its coefficients. Fix them by -S.",
    )
    return scenario


def _field(study: Study, t: Any, z: Any, e: tuple[Any, ...], values: dict[str, Any]) -> tuple[Any, ...]:
    """The loop at an instant; in the order of `PLACES`."""
    loop, law, plant = _covered(_scenario(study, values))
    (rho, rho_rate), (centre, centre_rate) = law.funnel.width_and_rate(t), law.funnel.centre_and_rate(t)
    sigma = centre + z * rho
    highest = sigma - law.surface((*e, 0.0))
    errors, desired = (*e, highest), loop.desired(t)
    x = loop.state(errors, desired)
    gain, law_gain = plant.gain(t, x), law.gain / rho if law.is_scaled else law.gain
    residual = plant.drift(t, x) - desired[loop.order] + law.surface((*errors[1:], 0.0))
    drive = residual + gain * law.offset - (centre_rate + z * rho_rate)
    plant_gain = law.gain_sign * gain
    found = drive, plant_gain * law_gain, rho, sigma, loop.disturbance.bound, plant_gain
    acting = residual + gain * law.offset
    return _numbers(*found, law.gain_sign * law_gain, law.offset, highest, acting)


def _moving(study: Study, t: Any, values: dict[str, Any]) -> tuple[Any, ...]:
    """What moves in time by itself: funnel and desired output, whose rates are worked out."""
    loop, law, _ = _covered(_scenario(study, values))
    return _numbers(*law.funnel.width_and_rate(t), *law.funnel.centre_and_rate(t), *loop.desired(t))


def _start(study: Study, values: dict[str, Any]) -> tuple[Any, ...]:
    """Horizon, z and all errors but the highest at the start."""
    scenario = _scenario(study, values)
    loop, law, _ = _covered(scenario)
    errors = loop.errors(0.0, tuple(scenario.x0[i] for i in range(loop.order)))
    z = (law.surface(errors) - law.funnel.centre_and_rate(0.0)[0]) / law.funnel.width_and_rate(0.0)[0]
    return _numbers(scenario.t1, z, *errors[:-1])


def _numbers(*values: Any) -> tuple[Any, ...]:
    return tuple(jax.numpy.asarray(value, float).reshape(()) for value in values)


def _require_known(program: list[list[Any]]) -> None:
    """Raises unless every operation has an enclosure."""
    unknown = sorted({each[1] for each in program if each[0] == "unknown"})
    if unknown:
        listed = ", ".join(f"`{name}`" for name in unknown)
        raise UnprovenError(
            f"the scenario computes by {listed}, for which there is no enclosure that is proved. Smooth functions of "
            "`jax.numpy` have one; jumps, cases, tables and loops have not"
        )

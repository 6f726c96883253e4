"""The likely mistakes of a newcomer, each made on purpose. Run as a program it prints what was said to each.

As a program of its own, since under the tests annotations are checked at every call and would speak first.
"""

import json
import math

import jax.numpy as jnp
import numpy as np

import qsmc_jax as qj

PENDULUM, SINE, CALM = qj.plants.InvertedPendulum(), qj.references.SumOfSines([1.0], [1.0]), qj.disturbances.Zero()
SURFACE, FUNNEL = qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05)
CONTROL = qj.QuasiSlidingControl(SURFACE, FUNNEL)


def loop(plant=PENDULUM, reference=SINE, disturbance=CALM, control=CONTROL, implementation=None):
    return qj.ClosedLoop(plant, reference, disturbance, control, implementation)


def scenario(draw):
    mass = draw.uniform("mass", 0.008, 0.012)
    return qj.Scenario(loop(qj.plants.InvertedPendulum(mass)), x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=2.0)


STUDY = qj.Study(scenario, bandwidth=0.1)


def tunable(draw):
    return qj.Scenario(qj.paper.example1(), x0=[0.9, 0.9], t1=draw.parameter("t1", 2.0, bounds=(1.0, 3.0)))


TUNABLE = qj.Study(tunable, bandwidth=0.1)


def with_mu(use):
    """A study of which the funnel's mu is what `use` makes of a drawn number."""

    def drawn(draw):
        funnel = qj.Funnel(4.0, use(draw.uniform("m", 1.0, 2.0)), 0.05)
        return qj.Scenario(loop(control=qj.QuasiSlidingControl(SURFACE, funnel)), x0=[0.9, 0.9], t1=2.0)

    return qj.Study(drawn, bandwidth=0.1)


def plant(**methods):
    """A plant of order 2 with the given methods."""
    own = {"order": 2, "drift": lambda self, t, x: -x[0], "gain": lambda self, t, x: 1.0, **methods}
    return type("Mine", (qj.AbstractPlant,), own)()


class Push(qj.AbstractDisturbance):
    """A disturbance by any function of time, and the times that it declares."""

    function: object
    times: object = ()

    def __call__(self, t):
        return self.function(t)

    @property
    def bound(self):
        return 1.0

    @property
    def break_times(self):
        return self.times


class Turn(qj.AbstractReference):
    """A reference whose derivatives any function of time and order gives."""

    function: object

    def derivatives(self, t, order):
        return self.function(t, order)


def branch(t):
    return 1.0 if t > 1.0 else 0.0


INSTEAD = "must be written with `jax.numpy`, not `numpy` or `math`, with `jnp.where` in place of a Python `if`"
MISTAKES = {
    "unknown kind of recording": (
        lambda: qj.Recording([0.0, 1.0], [0.0, 1.0], kind="spline"),
        r"`kind` must be one of \['hold', 'linear', 'pchip', 'cubic'\], but is 'spline'",
    ),
    "recording that repeats": (
        lambda: qj.Recording([0.0, 1.0], [0.0, 1.0], beyond="repeat"),
        r"`beyond` must be one of \['refuse', 'hold'\], but is 'repeat'",
    ),
    "numbers as a recording": (
        lambda: qj.disturbances.Recorded([0.0, 1.0]),
        r"`recording` of `Recorded` must be of class `Recording`, .*`qj.Recording\(times, values\)`",
    ),
    "plant in numpy": (lambda: plant(drift=lambda self, t, x: -np.sin(x[0])), f"`drift` of `Mine` {INSTEAD}"),
    "plant in math": (lambda: plant(drift=lambda self, t, x: -math.sin(x[0])), f"`drift` of `Mine` {INSTEAD}"),
    "plant with if": (
        lambda: plant(gain=lambda self, t, x: branch(x[0])),
        "JAX traces it with stand-ins for a time and a state of 2",
    ),
    "drift without t": (
        lambda: plant(drift=lambda self, x: -x[0]),
        r"`drift` of `Mine` must take a time and a state of 2 numbers .* 3 were given",
    ),
    "state too short": (
        lambda: plant(drift=lambda self, t, x: x[2]),
        r"a state of 2 numbers x\[0\] ... x\[1\] .*, but calling it says",
    ),
    "drift of all states": (
        lambda: plant(drift=lambda self, t, x: jnp.stack([x[1], -x[0]])),
        r"`drift` of `Mine` must return one number, but returns shape \(2,\)",
    ),
    "drift with a jump": (
        lambda: qj.simulate(loop(plant(drift=lambda self, t, x: -jnp.sign(x[1]))), [0.9, 0.9], 2.0),
        r"`drift` of `Mine` must be continuous in the state, but jumps from 1 to -1 at t = 0, x = \(0, 0\).*"
        r"`qj.smoothed.sign\(v, width\)`",
    ),
    "relay in the gain": (
        lambda: qj.simulate(loop(plant(gain=lambda self, t, x: jnp.where(x[0] > 0.5, 2.0, 1.0))), [0.9, 0.9], 2.0),
        r"`gain` of `Mine` must be continuous in the state, but jumps from 1 to 2 at t = 0, x = \(0.5, 0\)",
    ),
    "friction of no width": (lambda: qj.smoothed.sign(1.0, 0.0), "`width` must be positive, but is 0. Take a small"),
    "disturbance in numpy": (lambda: Push(np.sin), f"`Push`, a disturbance, {INSTEAD}"),
    "disturbance with if": (lambda: Push(branch), "JAX traces it with stand-ins for a time and for its arrays"),
    "disturbance a vector": (
        lambda: Push(lambda t: jnp.stack([t, t])),
        r"`Push`, a disturbance, must return one number, but returns shape \(2,\)",
    ),
    "reference in numpy": (
        lambda: loop(reference=Turn(lambda t, order: (np.sin(t), 1.0, 2.0))),
        f"`derivatives` of `Turn` {INSTEAD}",
    ),
    "reference too short": (
        lambda: loop(reference=Turn(lambda t, order: (t, 1.0))),
        "`derivatives` of `Turn` must return 3 numbers for order 2, but returns 2 of them",
    ),
    "reference with a wrong derivative": (
        lambda: qj.Scenario(loop(reference=Turn(lambda t, order: (jnp.sin(t), jnp.cos(t), 0.0))), [0.9, 0.9], 2.0),
        "Derivative 2 of `Turn` must be the derivative in time of derivative 1, but at t = .* s it is 0 instead of",
    ),
    "smooth in numpy": (lambda: qj.references.Smooth(np.sin), f"Argument `fn` of `Smooth` {INSTEAD}"),
    "smooth a number": (lambda: qj.references.Smooth(1.0), "must be a function of time, but calling it says"),
    "list for a number": (
        lambda: qj.plants.InvertedPendulum(mass=[0.1, 0.2]),
        r"`mass` of `InvertedPendulum` must be a single number, but has shape \(2,\)",
    ),
    "amplitudes for an amplitude": (
        lambda: qj.disturbances.Sine([0.1, 0.2], 1.0),
        r"`amplitude` of `Sine` must be a single number, but has shape \(2,\)",
    ),
    "abstract class for plant": (
        lambda: loop(plant=qj.AbstractPlant),
        "but is the class `AbstractPlant` itself. Derive from `qj.AbstractPlant`",
    ),
    "disturbance without t": (
        lambda: type("Mine", (Push,), {"__call__": lambda self: 0.0})(jnp.sin),
        "`Mine`, a disturbance, must take a time .*, but calling it says",
    ),
    "reference without order": (
        lambda: loop(reference=type("Mine", (Turn,), {"derivatives": lambda self, t: (t,)})(jnp.sin)),
        "`derivatives` of `Mine` must take a time and an order .*, but calling it says",
    ),
    "class for plant": (
        lambda: loop(plant=qj.plants.InvertedPendulum),
        r"`plant` of `ClosedLoop` must be .* but is the class `InvertedPendulum` itself. Call it: `InvertedPendulum\(",
    ),
    "plant and reference swapped": (
        lambda: loop(plant=SINE, reference=PENDULUM),
        "`plant` of `ClosedLoop` must be of class `AbstractPlant`, but is of class `SumOfSines`",
    ),
    "function for reference": (
        lambda: loop(reference=jnp.sin),
        r"`reference` .* A smooth function f\(t\) becomes one by `qj.references.Smooth\(f\)`",
    ),
    "function for disturbance": (
        lambda: loop(disturbance=jnp.sin),
        "`disturbance` of `ClosedLoop` must be of class `AbstractDisturbance`.* Use one of `qj.disturbances`",
    ),
    "number for disturbance": (lambda: loop(disturbance=0.5), "`disturbance` of `ClosedLoop`.* of class `float`"),
    "funnel for control": (lambda: loop(control=FUNNEL), r"Use `qj.QuasiSlidingControl\(surface, funnel\)`"),
    "list for surface": (
        lambda: qj.QuasiSlidingControl([2.0], FUNNEL),
        "`surface` of `QuasiSlidingControl` must be of class `SlidingSurface`, but is of class `list`",
    ),
    "dict for implementation": (
        lambda: loop(implementation={"sample_period": 0.01}),
        "`implementation` of `ClosedLoop` must be of class `Implementation`, but is of class `dict`",
    ),
    "text for number": (
        lambda: qj.Funnel(4.0, "3", 0.05),
        "A number or a list of numbers is wanted, but '3' was given",
    ),
    "plant for loop": (lambda: qj.simulate(PENDULUM, [0.9, 0.9], 1.0), r"`loop` must be .* Make one: `qj.ClosedLoop\("),
    "plant for loop in a scenario": (
        lambda: qj.Scenario(PENDULUM, [0.9, 0.9], 1.0),
        "`loop` of `Scenario` must be of class `ClosedLoop`, but is of class `InvertedPendulum`",
    ),
    "scenario with if": (
        lambda: with_mu(branch),
        f"Argument `scenario` {INSTEAD}.* stand-ins for the numbers it draws",
    ),
    "scenario in numpy": (lambda: with_mu(np.exp), f"Argument `scenario` {INSTEAD}"),
    "scenario with float()": (lambda: with_mu(float), r"without `float\(\)`: .* stand-ins for the numbers it draws"),
    "scenario for study": (
        lambda: qj.verify(scenario, 64),
        r"`study` must be of class `Study`, but is of class `function`. Make one: `qj.Study\(scenario, bandwidth",
    ),
    "loop for study": (lambda: qj.monte_carlo(loop(), 64), "`study` must be of class `Study`"),
    "loop for study in a map": (lambda: qj.robustness_map(loop(), {"mass": [0.01]}, 64), "`study` must be of class"),
    "loop for study in a search": (lambda: qj.critical_value(loop(), "mass", 0.1), "`study` must be of class `Study`"),
    "loop for study in tuning": (lambda: qj.tune(loop(), ["mu"], "mean(energy_u)"), "`study` must be of class `Study`"),
    "one study to compare": (lambda: qj.compare(STUDY, 64), "`studies` must be of class `Mapping`.* Give each a name"),
    "loops to compare": (lambda: qj.compare({"a": loop()}, 64), r"`studies\['a'\]` must be of class `Study`"),
    "runs in exponents": (lambda: qj.verify(STUDY, 1e3), "`runs` must be a whole number, but is 1000.0"),
    "one array of runs": (lambda: qj.verify(STUDY, np.ones(2)), "`runs` must be a whole number, but is array"),
    "runs a truth value": (lambda: qj.verify(STUDY, True), "`runs` must be a whole number, but is True"),
    "no runs": (lambda: qj.verify(STUDY, 0), "`runs` must be at least 1, but is 0"),
    "seed a fraction": (lambda: qj.verify(STUDY, 64, seed=0.5), "`seed` must be a whole number, but is 0.5"),
    "confidence in percent": (lambda: qj.verify(STUDY, 64, confidence=95), "`confidence` must lie strictly between 0"),
    "settings a dict": (
        lambda: qj.verify(STUDY, 64, settings={"rtol": 1e-8}),
        r"`settings` must be of class `SolverSettings`, .* Make one: `qj.SolverSettings\(rtol=1e-8\)`",
    ),
    "sampling a class": (lambda: qj.monte_carlo(STUDY, 64, sampling=qj.Sobol), r"Call it: `Sobol\(\.\.\.\)`"),
    "rule a text": (lambda: qj.verify(STUDY, 64, until="decided"), "`until` must be .* Use one of `qj.stopping`"),
    "name misspelt": (lambda: STUDY.substitute(mas=0.01), "There is no name `mas` .* Did you mean `mass`?"),
    "column misspelt": (
        lambda: qj.Runs({"index": np.arange(2), "peak_ratio": np.ones(2)}, ())["peak_ration"],
        "There is no column `peak_ration`. Did you mean `peak_ratio`?",
    ),
    "metric misspelt": (
        lambda: qj.tune(TUNABLE, ["t1"], "mean(energy)"),
        "`objective` names `energy`, but must name one of .*. Did you mean `energy_u`?",
    ),
    "text for parameters": (
        lambda: qj.tune(STUDY, "mu", "mean(energy_u)"),
        r"`parameters` must be a list, but is a text: write \['mu'\]",
    ),
    "text for constraints": (
        lambda: qj.tune(STUDY, ["mu"], "mean(energy_u)", "worst(peak_u) <= 20"),
        r"`subject_to` must be a list, but is a text: write \['worst\(peak_u\) <= 20'\]",
    ),
    "drawn number tuned": (
        lambda: qj.tune(STUDY, ["mass"], "mean(energy_u)"),
        r"`mass` is a uniform of shape \(\).* Use `draw.parameter\(name, default, bounds",
    ),
}


def said(make):
    """The class and the message of the error that a mistake raises; empty if it raises none."""
    try:
        make()
    except Exception as error:  # noqa: BLE001 - which error it is, is what is asked
        return [type(error).__name__, str(error)]
    return ["", ""]


if __name__ == "__main__":
    print(json.dumps({name: said(make) for name, (make, _) in MISTAKES.items()}))

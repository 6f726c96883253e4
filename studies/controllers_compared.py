"""The quasi-sliding-mode law and what else one would use, on one loop, at one sampling rate, under one input limit.

Question: Example 1 of the paper with an uncertain mass, disturbance and start, sampled every millisecond, the input
    limited to 20: who keeps the funnel, and how much does each chatter?
Claim: all keep it, with bounds as narrow as these. The quasi-sliding-mode law does not chatter: beyond the variation
    that the disturbance asks for, its input varies by 0.03 in eight seconds. The sign law's varies millions of times as
    much; super-twisting's some thousand times, for a fifth of the peak error. With noise of 1e-3 on the rate (`-S
    noise=1e-3`) every input varies, the sign law's a thousand times as much, super-twisting's five times. Funnel
    control and prescribed performance, the other laws with a pole at the edge, are much like it. Boundary layers and PD
    do as well on bounds and a limit that fit, at several times the peak input; but nothing holds them in the funnel.
Rules: surface, funnel, draws and limits are the same for all. What has a slope at zero gets that of the
    quasi-sliding-mode law, pi / (2 rho_inf); the boundary layer appears again with its accuracy at rest. Sign law,
    boundary layers and super-twisting get their gains from bounds on the residual w and its rate, below.
Time: 25 s on two cores, `qsmc compare studies/controllers_compared.py --runs 1000 --out results/compared`.
"""

from collections.abc import Callable
from typing import Any

import qsmc_jax as qj

SAMPLE_PERIOD, SATURATION = 1e-3, 20.0
MASSES = (0.008, 0.012)
GAIN_MIN = 1.0 / (MASSES[1] * 9.8**2)
# w = f - x_des'' + d + c_1 e'. In the funnel |e'| < 2 soon and so |x_2| < 3: gravity 1, friction 1.25 * 3 (k / m is
# 1.25 at most), sin x_2 1, the reference 1, the disturbance 0.5, c_1 |e'| 4.
RESIDUAL = 1.0 + 1.25 * 3.0 + 1.0 + 1.0 + 0.5 + 2.0 * 2.0
# Its rate in the steady phase, where |x_2| < 1.1 and |x_2'| < 1.5, term by term; d has frequencies up to 2, e'' is 0.5.
RESIDUAL_RATE = 1.1 + 1.25 * 1.5 + 1.5 + 1.0 + 0.5 * 2.0 + 2.0 * 0.5

Maker = Callable[[qj.QuasiSlidingControl], Any]


def _boundary_layer_as_accurate(control: qj.QuasiSlidingControl) -> Any:
    amplitude = (RESIDUAL + 1.0) / GAIN_MIN
    return qj.controllers.BoundaryLayer.with_equal_accuracy(control, amplitude, RESIDUAL, GAIN_MIN)


RULES: dict[str, Maker] = {
    "quasi-sliding mode": lambda control: control,
    "sign law": lambda control: qj.controllers.Sign.for_bound(control, RESIDUAL, GAIN_MIN, 1.0),
    "boundary layer, equal slope": lambda control: qj.controllers.BoundaryLayer.with_equal_slope(
        control, (RESIDUAL + 1.0) / GAIN_MIN
    ),
    "boundary layer, equal accuracy": _boundary_layer_as_accurate,
    "super-twisting": lambda control: qj.controllers.SuperTwisting.for_rate(control, RESIDUAL_RATE, GAIN_MIN),
    "prescribed performance": qj.controllers.PrescribedPerformance.with_equal_slope,
    "funnel control": qj.controllers.FunnelControl.with_equal_slope,
    "PD with feedforward": lambda control: qj.controllers.ProportionalDerivative.with_equal_slope(
        control, feedforward=0.01 * 9.8**2
    ),
}


def study(make: Maker) -> qj.Study:
    """The study of one controller."""

    def scenario(draw: qj.Draw) -> qj.Scenario:
        control = make(qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), qj.Funnel(rho0=4.0, mu=3.0, rho_inf=0.05)))
        plant = qj.plants.InvertedPendulum(mass=draw.uniform("mass", *MASSES))
        disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5, frequencies=(0.1, 2.0))
        implementation = qj.Implementation(
            draw.parameter("sample_period", SAMPLE_PERIOD, bounds=(1e-5, 1.0)),
            saturation=draw.parameter("saturation", SATURATION, bounds=(0.1, 1e3)),
            noise=qj.noises.uniform(draw, "measured", [0.0, draw.parameter("noise", 0.0, bounds=(0.0, 1.0))]),
        )
        reference = qj.references.SumOfSines([1.0], [1.0])
        loop = qj.ClosedLoop(plant, reference, disturbance, control, implementation)
        return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=10.0)

    return qj.Study(scenario, bandwidth=0.1)


studies = {name: study(make) for name, make in RULES.items()}

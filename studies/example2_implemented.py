"""Example 2, of order 4, as a computer runs it: everything uncertain, and sampled, saturated, noisy, late and slow.

Question: with how long a period, how low a limit, how much noise, delay and lag is the funnel still kept?
Claim: as it stands it is held. It asks for more than Example 1: one at a time, in all of 64 runs up to a period of
    4 ms, noise of 0.005 on the last state, a delay of 2 ms, a lag of 5 ms, and down to a saturation of 32. What
    breaks first is the start, at some 0.13 s, where the input peaks and the loop is steepest.
Time: two minutes a map on two cores, such as

    qsmc map studies/example2_implemented.py --over sample_period=1e-3:0.05:log:16 --runs 250 --out results/period
    qsmc map studies/example2_implemented.py --over saturation=0.5:60:log:16 --runs 250 --out results/saturation
    qsmc map studies/example2_implemented.py --over noise=1e-3:0.1:log:16 --runs 250 --out results/noise
    qsmc map studies/example2_implemented.py --over delay=5e-4:0.05:log:16 --runs 250 --out results/delay
    qsmc map studies/example2_implemented.py --over lag=1e-3:0.5:log:16 --runs 250 --out results/lag
"""

import math

import qsmc_jax as qj


def scenario(draw: qj.Draw) -> qj.Scenario:
    """Distributions as in example2_uncertain.py; 6 s are four times the reaching time."""
    plant = qj.plants.FourthOrderExample(
        drift_scale=draw.uniform("drift_scale", 0.8, 1.2), gain_scale=draw.uniform("gain_scale", 0.8, 1.2)
    )
    funnel = qj.Funnel(
        rho0=draw.uniform("rho0", 4.5, 6.0),
        mu=draw.uniform("mu", 2.0, 3.5),
        rho_inf=draw.uniform("rho_inf", 0.03, 0.07),
    )
    control = qj.QuasiSlidingControl(qj.SlidingSurface([6.0, 12.0, 8.0]), funnel)
    disturbance = qj.disturbances.random_sines(draw, "sines", bound=0.5, terms=3) + qj.disturbances.random_telegraph(
        draw, "telegraph", bound=1.0, rate=0.2, horizon=20.0
    )
    implementation = qj.Implementation(
        sample_period=draw.parameter("sample_period", 1e-3, bounds=(1e-4, 1.0)),
        saturation=draw.parameter("saturation", 60.0, bounds=(1e-3, 1e6)),
        noise=qj.noises.uniform(draw, "measured", [0.0, 0.0, 0.0, draw.parameter("noise", 1e-3, bounds=(0.0, 1.0))]),
        delay=draw.parameter("delay", 1e-3, bounds=(0.0, 0.1)),
        actuator=qj.actuators.FirstOrderLag(draw.parameter("lag", 2e-3, bounds=(0.0, 10.0))),
        queue=64,
    )
    reference = qj.references.SumOfSines([1.0, 1.0], [1.0, 0.5], [0.0, math.pi / 2])
    loop = qj.ClosedLoop(plant, reference, disturbance, control, implementation)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.5, 0.7, shape=(4,)), t1=6.0)


study = qj.Study(scenario, bandwidth=0.1)

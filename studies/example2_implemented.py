"""Draft."""

import math

import qsmc_jax as qj


def scenario(draw):
    """Draft."""
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

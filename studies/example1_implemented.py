"""Example 1 as a computer runs it: everything uncertain, and sampled, saturated, noisy, late and slow.

draft
"""

import qsmc_jax as qj


def scenario(draw):
    plant = qj.plants.InvertedPendulum(
        mass=draw.uniform("mass", 0.008, 0.012),
        length=draw.uniform("length", 7.84, 11.76),
        friction=draw.uniform("friction", 0.008, 0.012),
        gravity=9.8,
    )
    funnel = qj.Funnel(
        rho0=draw.parameter("rho0", 4.0, bounds=(1.0, 20.0)),
        mu=draw.parameter("mu", 3.0, bounds=(0.5, 10.0)),
        rho_inf=draw.parameter("rho_inf", 0.05, bounds=(0.0005, 0.09)),
    )
    control = qj.QuasiSlidingControl(qj.SlidingSurface([2.0]), funnel)
    disturbance = qj.disturbances.random_sine(draw, "d", bound=0.5, frequencies=(0.1, 10.0))
    implementation = qj.Implementation(
        sample_period=draw.parameter("sample_period", 2e-3, bounds=(1e-4, 1.0)),
        saturation=draw.parameter("saturation", 20.0, bounds=(0.01, 1e6)),
        noise=qj.noises.uniform(draw, "noise_on_rate", [0.0, draw.parameter("noise", 1e-3, bounds=(0.0, 1.0))]),
        delay=draw.parameter("delay", 2e-3, bounds=(0.0, 0.1)),
        actuator=qj.actuators.FirstOrderLag(draw.parameter("lag", 5e-3, bounds=(0.0, 10.0))),
        queue=64,
    )
    loop = qj.ClosedLoop(plant, qj.references.SumOfSines([1.0], [1.0]), disturbance, control, implementation)
    return qj.Scenario(loop, x0=draw.uniform("x0", 0.1, 0.9, shape=(2,)), t1=5.0)


study = qj.Study(scenario, bandwidth=0.1)

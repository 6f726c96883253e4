"""Example 1 as a computer runs it: everything uncertain, and sampled, saturated, noisy, late and slow.

Question: with how long a period, how low a limit, how much noise, delay and lag is the funnel still kept?
Claim: as it stands it is held. One at a time, and the others as they stand, in all of 64 runs up to a period of 0.03 s,
    noise of 0.028 on the rate, a delay of 0.017 s, a lag of 0.13 s, and down to a saturation of 3.7; at 0.08 s, 0.05,
    0.05 s, 0.23 s and 0.7 most runs leave it. The limits of the linearised loop are drawn in.
Time: half a minute a map on two cores, such as

    qsmc map studies/example1_implemented.py --over sample_period=2e-3:0.3:log:24 --runs 500 --out results/period
    qsmc map studies/example1_implemented.py --over saturation=0.2:20:log:24 --runs 500 --out results/saturation
    qsmc map studies/example1_implemented.py --over noise=3e-3:0.3:log:24 --runs 500 --out results/noise
    qsmc map studies/example1_implemented.py --over delay=2e-3:0.1:log:24 --runs 500 --out results/delay
    qsmc map studies/example1_implemented.py --over lag=5e-3:2:log:24 --runs 500 --out results/lag
    qsmc map studies/example1_implemented.py --over sample_period=2e-3:0.3:log:16 --over saturation=0.2:20:log:16
    qsmc critical studies/example1_implemented.py --name sample_period --below 1e-2 --between 2e-3:0.3
"""

import qsmc_jax as qj


def scenario(draw: qj.Draw) -> qj.Scenario:
    """Distributions as in example1_uncertain.py; 5 s are three times the reaching time."""
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

"""Matched disturbances: bounded functions of time, fixed, composed or random."""

from qsmc_jax.model.disturbances.disturbance import (
    AbstractDisturbance as AbstractDisturbance,
    Constant as Constant,
    Scaled as Scaled,
    Sum as Sum,
    no_breaks as no_breaks,
)
from qsmc_jax.model.disturbances.random import (
    random_noise as random_noise,
    random_sine as random_sine,
    random_sines as random_sines,
    random_steps as random_steps,
    random_telegraph as random_telegraph,
)
from qsmc_jax.model.disturbances.switching import (
    Piecewise as Piecewise,
    SmoothSteps as SmoothSteps,
    Telegraph as Telegraph,
)
from qsmc_jax.model.disturbances.waveforms import (
    BandLimitedNoise as BandLimitedNoise,
    Sine as Sine,
    SumOfSines as SumOfSines,
    Zero as Zero,
)

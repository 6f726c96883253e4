"""Matched disturbances: bounded functions of time, fixed, composed or random."""

from qsmc_jax.model.disturbances.disturbance import AbstractDisturbance as AbstractDisturbance
from qsmc_jax.model.disturbances.disturbance import Constant as Constant
from qsmc_jax.model.disturbances.disturbance import Scaled as Scaled
from qsmc_jax.model.disturbances.disturbance import Sum as Sum
from qsmc_jax.model.disturbances.disturbance import no_breaks as no_breaks
from qsmc_jax.model.disturbances.random import random_noise as random_noise
from qsmc_jax.model.disturbances.random import random_sine as random_sine
from qsmc_jax.model.disturbances.random import random_sines as random_sines
from qsmc_jax.model.disturbances.random import random_steps as random_steps
from qsmc_jax.model.disturbances.random import random_telegraph as random_telegraph
from qsmc_jax.model.disturbances.recorded import Recorded as Recorded
from qsmc_jax.model.disturbances.spectra import dryden_gust as dryden_gust
from qsmc_jax.model.disturbances.spectra import iso8608_road as iso8608_road
from qsmc_jax.model.disturbances.spectra import jonswap_waves as jonswap_waves
from qsmc_jax.model.disturbances.spectra import random_spectrum as random_spectrum
from qsmc_jax.model.disturbances.switching import Piecewise as Piecewise
from qsmc_jax.model.disturbances.switching import SmoothSteps as SmoothSteps
from qsmc_jax.model.disturbances.switching import Telegraph as Telegraph
from qsmc_jax.model.disturbances.waveforms import BandLimitedNoise as BandLimitedNoise
from qsmc_jax.model.disturbances.waveforms import Sine as Sine
from qsmc_jax.model.disturbances.waveforms import SumOfSines as SumOfSines
from qsmc_jax.model.disturbances.waveforms import Zero as Zero

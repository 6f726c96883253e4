"""What is measured of a run: the metrics that every run has, and those of one's own."""

from qsmc_jax.metrics.kinds import Custom as Custom
from qsmc_jax.metrics.kinds import Final as Final
from qsmc_jax.metrics.kinds import Integral as Integral
from qsmc_jax.metrics.kinds import Mean as Mean
from qsmc_jax.metrics.kinds import Peak as Peak
from qsmc_jax.metrics.kinds import Variation as Variation
from qsmc_jax.metrics.record import Record as Record
from qsmc_jax.metrics.signals import Signals as Signals
from qsmc_jax.metrics.standard import catalogue as catalogue
from qsmc_jax.metrics.standard import record_of as record_of
from qsmc_jax.metrics.times import FirstTime as FirstTime
from qsmc_jax.metrics.times import LastTime as LastTime

"""Actuators: what stands between the command that is held and the input that the plant gets.

Between two changes of the command their motion is known in closed form, so that none is too fast to be followed.
"""

from qsmc_jax.implementation.actuators.actuator import AbstractActuator as AbstractActuator
from qsmc_jax.implementation.actuators.actuator import AbstractMonotoneActuator as AbstractMonotoneActuator
from qsmc_jax.implementation.actuators.dead_zone import DeadZone as DeadZone
from qsmc_jax.implementation.actuators.lags import FirstOrderLag as FirstOrderLag
from qsmc_jax.implementation.actuators.lags import SecondOrderLag as SecondOrderLag
from qsmc_jax.implementation.actuators.rate_limited import RateLimited as RateLimited

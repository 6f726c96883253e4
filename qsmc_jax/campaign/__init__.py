"""Studies that last: rows in a run folder, block by block, to be resumed, extended, distributed and read again."""

from qsmc_jax.campaign.campaign import prepare as prepare
from qsmc_jax.campaign.campaign import run_campaign as run_campaign
from qsmc_jax.campaign.campaign import work_shard as work_shard
from qsmc_jax.campaign.config import CampaignConfig as CampaignConfig
from qsmc_jax.campaign.difference import difference as difference
from qsmc_jax.campaign.engines import Dask as Dask
from qsmc_jax.campaign.engines import Threads as Threads
from qsmc_jax.campaign.folder import RunFolder as RunFolder
from qsmc_jax.campaign.replay import replay as replay
from qsmc_jax.campaign.status import status_of as status_of

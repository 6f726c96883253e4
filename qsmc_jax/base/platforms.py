"""What is chosen by the platform that JAX computes on: batches, threads, compiler options, rewriting."""

import dataclasses
import os
from collections.abc import Mapping

import jax

# XLA splits no work over cores, which threads do here with whole blocks.
_OPTIONS = {"xla_disable_hlo_passes": "cpu-parallel-task-assigner"}

# Vectors as wide as they come, where XLA for CPUs stays at half the width: a third less time. Only for programs without
# an arctangent of JAX's own, which jaxlib 0.10.2 compiles to wrong numbers at this width.
_WIDE_OPTIONS = {**_OPTIONS, "xla_cpu_prefer_vector_width": "512"}


@dataclasses.dataclass(frozen=True)
class Platform:
    """How batches are solved on one kind of device.

    Attributes:
        block: Runs solved together unless told otherwise, a multiple of 64.
        threads: Blocks solved at the same time unless told otherwise.
        rewrites: Whether sines and the like are replaced by ones that XLA vectorises there.
        options: The compiler's options.
        wide_options: The same for programs in which all of them are replaced.
    """

    block: int
    threads: int
    rewrites: bool
    options: Mapping[str, str]
    wide_options: Mapping[str, str]


def platform() -> Platform:
    """What holds for JAX's default backend at this moment."""
    if jax.default_backend() == "cpu":
        # Small enough that a sample for the numerical error and a few doubtful runs cost little, large enough to
        # vectorise.
        return Platform(512, os.cpu_count() or 1, rewrites=True, options=_OPTIONS, wide_options=_WIDE_OPTIONS)
    # An accelerator's step takes as long for some ten thousand runs as for one; a second thread hides the host's work.
    return Platform(16_384, 2, rewrites=False, options={}, wide_options={})

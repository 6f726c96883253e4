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

# The whole loop of a solve as one CUDA graph, which starts each step's kernels and decides by itself whether there is
# another: half the time of a step for up to 16 384 runs, three quarters for 100 000.
_GPU_OPTIONS = {"xla_gpu_enable_command_buffer": "FUSION,WHILE,CONDITIONAL"}


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
    # An accelerator's step takes hardly longer for 10 000 runs than for one; a second thread hides the host's work.
    # In blocks of a million XLA has each thread make four, which spills registers: twice the time for a run.
    options = _GPU_OPTIONS if jax.default_backend() == "gpu" else {}
    return Platform(65_536, 2, rewrites=False, options=options, wide_options=options)

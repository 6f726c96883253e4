"""Compiled programs kept from one command to the next, in the user's cache folder."""

import logging
from pathlib import Path


def cache_folder() -> Path:
    """Where compiled programs are kept."""
    import platformdirs

    return Path(platformdirs.user_cache_dir("qsmc_jax"))


def keep_compiled_programs() -> None:
    """Has JAX look for compiled programs in the user's cache folder, and leave new ones there, however small.

    Only the command line does so: importing the package changes nothing.
    """
    import jax

    try:
        folder = str(cache_folder())
    except (RuntimeError, KeyError, OSError):  # nobody's home is known: a container, say
        return
    jax.config.update("jax_compilation_cache_dir", folder)
    logging.getLogger(__name__).info("compiled programs are kept in %s", folder)
    # By default JAX keeps nothing that compiles in less than a second.
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)

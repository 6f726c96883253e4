"""`python -m qsmc_jax` is the program `qsmc`."""

from qsmc_jax.cli.main import main

if __name__ == "__main__":
    main()

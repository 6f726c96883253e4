"""`python -m qsmc_jax` is the program `qsmc`."""

from qsmc_jax.cli.main import app

if __name__ == "__main__":
    app(prog_name="qsmc")

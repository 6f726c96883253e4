"""The pictures of README.md, made anew: `python docs/pictures.py`. Two minutes on two cores."""

import runpy
from pathlib import Path
from typing import Any

import numpy as np

import qsmc_jax as qj

HERE = Path(__file__).parent
STUDIES = HERE.parent / "studies"


def save(name: str, axes: Any) -> None:
    """Writes the figure of the axes as a small PNG beside this file."""
    axes[0].figure.savefig(HERE / name, dpi=70)


def main() -> None:
    """Draws a run, a verification and a map of robustness."""
    run = qj.simulate(qj.paper.example1(), x0=[0.9, 0.9], t1=20.0)
    save("run.png", run.plot())
    study = runpy.run_path(str(STUDIES / "example1_uncertain.py"))["study"]
    save("verification.png", qj.verify(study, 10_000).plot())
    sampled = runpy.run_path(str(STUDIES / "example1_implemented.py"))["study"]
    periods = np.geomspace(1e-3, 0.3, 24)
    save("map.png", qj.robustness_map(sampled, {"sample_period": periods}, runs=512).plot())


if __name__ == "__main__":
    main()

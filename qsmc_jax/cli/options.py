"""Arguments and options that several commands share."""

from pathlib import Path
from typing import Annotated, Literal

import typer

StudyFile = Annotated[Path, typer.Argument(metavar="STUDY", help="Python file that defines `study`.")]
StudiesFile = Annotated[
    Path, typer.Argument(metavar="STUDY|RUN", help="Python file that defines `studies`, by name; or a run folder.")
]
Overrides = Annotated[
    list[str] | None,
    typer.Option(
        "-S",
        "--set",
        metavar="NAME=VALUE",
        help="Fix a name of the study; repeatable. Vectors: x0=0.5,0.5. Tuned gains: @FOLDER",
    ),
]
Seed = Annotated[int, typer.Option(help="Seed of the study.")]
Out = Annotated[Path | None, typer.Option(help="New folder for data and pictures.")]
Json = Annotated[bool, typer.Option("--json", help="Print JSON instead of a table.")]
Rtol = Annotated[float, typer.Option(help="Relative tolerance of the solver.")]
Atol = Annotated[float | None, typer.Option(help="Absolute tolerance of the solver; default a hundredth of --rtol.")]
Cache = Annotated[bool, typer.Option("--cache/--no-cache", help="Keep compiled programs in the user's cache folder.")]
Method = Annotated[
    Literal["auto", "other", "tsit5", "rodas4", "rodas5p"],
    typer.Option(help="Solver; `other` takes the one that `auto` does not, as a check."),
]
MaxSteps = Annotated[int, typer.Option(help="Steps after which a run is given up as UNDECIDED.")]
Block = Annotated[int | None, typer.Option(help="Runs solved together, a multiple of 64; default 512 on CPUs.")]
Threads = Annotated[int | None, typer.Option(help="Blocks solved at once; default one a core.")]
Together = Annotated[float, typer.Option(help="Confidence that all intervals hold together.")]

"""From what the user names to what decides the rows of a campaign."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from qsmc_jax.base.errors import InputError
from qsmc_jax.cli.study_file import Source, load_study

if TYPE_CHECKING:
    from qsmc_jax.campaign.folder import RunFolder
    from qsmc_jax.campaign.recipe import Recipe


def recipe_of(study_file: Path, overrides: list[str], **options: Any) -> "Recipe":
    """The recipe of a study file; `options` are those of `Recipe`."""
    from qsmc_jax.campaign.recipe import Recipe

    source = Source.read(study_file)
    return Recipe(load_study(source, overrides), source.content, **options)


def recipe_again(folder: "RunFolder", study_file: Path | None, **options: Any) -> "Recipe":
    """The recipe that a run folder was made by.

    It runs the study file that the folder was made from, where it was named then, or the one named now; the copy in the
    folder is run only if it is named.

    Raises:
        InputError: There is no such file, or it is no longer the same study.
    """
    from qsmc_jax.campaign.recipe import Recipe
    from qsmc_jax.simulation.settings import SolverSettings

    manifest = folder.manifest
    identity, named = manifest["identity"], study_file or Path(manifest["study_path"])
    is_inside = folder.path.resolve() in named.resolve().parents
    if not named.is_file() or (is_inside and study_file is None):
        raise InputError(
            f"The study of `{folder.path}` was `{named}`, which is not there. Name the file by --study. A copy, to be "
            f"run if you trust it, is `{folder.path / 'study.py'}`."
        )
    settings = SolverSettings(identity["rtol"], identity["atol"])
    settings = settings.replace(**{name: identity[name] for name, _ in settings.choices if name in identity})
    source = Source.read(named)
    study = load_study(source, []).substitute(**identity["values"])
    recipe = Recipe(study, source.content, int(identity["seed"]), settings, **options)
    folder.check(recipe)
    return recipe

"""From what the user names to what decides the rows of a campaign."""

from pathlib import Path
from typing import TYPE_CHECKING, Any

from qsmc_jax.base.errors import InputError
from qsmc_jax.cli.study_file import Source, load_study

if TYPE_CHECKING:
    from qsmc_jax.campaign.config import CampaignConfig
    from qsmc_jax.campaign.folder import RunFolder


def config_of(study_file: Path, overrides: list[str], metrics: str | None = None, **options: Any) -> "CampaignConfig":
    """The config of a study file, asking for other standard metrics; `options` are those of `CampaignConfig`."""
    from qsmc_jax.campaign.config import CampaignConfig

    source = Source.read(study_file)
    study = load_study(source, overrides)
    study = study if metrics is None else study.asking(*(name.strip() for name in metrics.split(",")))
    return CampaignConfig(study, source.content, files=source.files, **options)


def config_again(folder: "RunFolder", study_file: Path | None, **options: Any) -> "CampaignConfig":
    """The config that a run folder was made by.

    It runs the study file named now, or the one that the folder was made from if that was on this machine and is still
    where it was; in both cases only if its code is what it was. The copy in the folder is run only if it is named.

    Raises:
        InputError: There is no such file, or it is no longer the same study.
    """
    from qsmc_jax.base.atomic import machine
    from qsmc_jax.campaign.config import CampaignConfig, code_hash, require_same, settings_in, study_in

    manifest = folder.manifest
    identity, there = manifest["identity"], Path(manifest["study_path"])
    named = study_file or there
    is_ours = there.is_absolute() and folder.path.resolve() not in there.resolve().parents
    is_here = is_ours and manifest["machine"] == machine()
    if not named.is_file() or not (study_file or is_here):
        raise InputError(
            f"The study of `{folder.path}` was `{there}` on `{manifest['machine']}`, which is not there. Name the file "
            f"by --study. A copy, to be run if you trust it, is `{folder.path / 'study.py'}`."
        )
    source = Source.read(named)
    # Before a line of it is run: a file of this name may be anybody's.
    require_same({"study_code": identity["study_code"]}, {"study_code": code_hash(source.content)}, str(folder.path))
    settings = settings_in(identity)
    study = study_in(identity, load_study(source, []))
    config = CampaignConfig(study, source.content, int(identity["seed"]), settings, files=source.files, **options)
    folder.check(config)
    return config

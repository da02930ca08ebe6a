"""A model file becomes a `ModelSpec`: what it says, free of the file."""

from pathlib import Path

from imubayes.campaign.campaign_reader import read_model_file
from imubayes.campaign.file_schemas import ModelFile
from imubayes.model.model_spec import EffectSpec, ModelSpec


def read_model(path: str | Path) -> ModelSpec:
    """Read a model file; its own effects are looked for beside it.

    Raises
    ------
    InputError
        with everything that is wrong with the file.
    """
    path = Path(path)
    return spec_of_file(read_model_file(path), path)


def spec_of_file(file: ModelFile, path: Path) -> ModelSpec:
    """Return what a model file says, free of the file."""
    effects = tuple(
        EffectSpec(
            name=entry.name,
            channels=tuple(entry.channels) if entry.channels is not None else None,
            per=entry.per,
            prior=dict(entry.prior),
            options=dict(entry.model_extra or {}),
            optional=entry.optional,
            where=f"{path}: effect {place + 1} ({entry.name})",
        )
        for place, entry in enumerate(file.effect)
    )
    percent = file.delta_k_threshold_percent
    own = tuple(str(path.parent / name) for name in file.files)
    return ModelSpec(file.name, effects, own, str(path), None if percent is None else percent / 100)


load_model = read_model  # the public name

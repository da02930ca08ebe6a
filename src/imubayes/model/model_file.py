"""A model file becomes a `ModelSpec`: what it says, free of the file."""

from pathlib import Path

from imubayes.campaign.campaign_reader import read_model_file
from imubayes.campaign.file_schemas import ModelFile
from imubayes.model.model_spec import EffectSpec, ModelSpec, PriorCorrelation
from imubayes.model.trusted_effects import refuse_untrusted


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
    correlations = tuple(
        PriorCorrelation(
            tuple(entry.parameters),
            tuple(map(tuple, entry.matrix)),
            entry.optional,
            f"{path}: prior_correlation {place + 1}",
        )
        for place, entry in enumerate(file.prior_correlation)
    )
    return ModelSpec(
        name=file.name,
        effects=effects,
        files=own,
        where=str(path),
        delta_k_threshold=None if percent is None else percent / 100,
        correlations=correlations,
        noise_priors=None if file.noise_priors is None else _noise_priors(path.parent / file.noise_priors),
    )


def _noise_priors(path: Path) -> ModelSpec:
    """Read the noise of static records; it names no further file of its kind."""
    return spec_of_file(read_model_file(path).model_copy(update={"noise_priors": None}), path)


def read_carried_model(path: Path) -> ModelSpec:
    """Read a model file that comes along with something else: its own effects must be trusted.

    Raises
    ------
    InputError
        with everything that is wrong with the file, and for effect files that are not trusted.
    """
    spec = read_model(path)
    refuse_untrusted(spec.files)
    return spec


load_model = read_model  # the public name

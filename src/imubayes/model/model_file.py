"""A model file, or a mapping like one, becomes a `ModelSpec`: a list of effects with their settings."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

from imubayes.campaign.campaign_reader import read_model_file
from imubayes.campaign.file_schemas import ModelFile
from imubayes.campaign.toml_documents import Ledger, plain_content, validated
from imubayes.foundations.campaign_data import SetAside
from imubayes.foundations.errors import input_error
from imubayes.foundations.records import Record
from imubayes.foundations.shipped_examples import model_file
from imubayes.model.trusted_files import refuse_untrusted


@dataclass(frozen=True)
class EffectSpec:
    """One effect of a model.

    Attributes
    ----------
    name : of the effect or noise member.
    channels : the channels it acts on; None for all that it can act on.
    per : sharing of values (channel, all, run, mounting); None for the default of the effect.
    prior : parameter → prior as written.
    options : fixed settings of the effect.
    optional : drop it if no run can show it or the unit lacks the channel, instead of refusing the model.
    where : file and key, for errors.

    Examples
    --------
    >>> import imubayes
    >>> bias = imubayes.load_model("accel-channel").effects[1]
    >>> bias.name, dict(bias.prior)
    ('accel_bias', {'bias': 'normal(0, 1000 ug)'})
    """

    name: str
    channels: tuple[str, ...] | None = None
    per: str | None = None
    prior: Mapping[str, str] = field(default_factory=dict)
    options: Mapping[str, float] = field(default_factory=dict)
    optional: bool = False
    where: str = "model"


class SingleRunEffect(Record):
    """An effect that differs from run to run, on channels with one run each: it is left out of the bound model."""

    effect: str
    channels: tuple[str, ...]


GRAVITY = "gravity_anomaly"
"""The effect that is an error of gravity."""


class UncertainEquipment(Record):
    """A parameter of equipment that is not exact, and that a model takes as exact.

    Attributes
    ----------
    effect, parameter : effect that describes it, and its parameter as the model would name it.
    unit, size : its standard uncertainty.
    stated : whether the campaign states the size; otherwise it is a plausible one, as for normal gravity.
    """

    effect: str
    parameter: str
    unit: str
    size: float
    stated: bool


@dataclass(frozen=True)
class PriorCorrelation:
    """Correlation of the priors of noise parameters, of their logarithms if these are lognormal.

    Attributes
    ----------
    parameters : names of K noise parameters, `effect.parameter[label]`.
    matrix : K rows of K correlations.
    optional : leave out the parameters that the model does not have, instead of refusing it.
    where : file and key, for errors.
    """

    parameters: tuple[str, ...]
    matrix: tuple[tuple[float, ...], ...]
    optional: bool = False
    where: str = "model"


@dataclass(frozen=True)
class ModelSpec:
    """A model: a name and its effects; `files` are sources of the user's own effects, as given.

    `delta_k_threshold` is the Δk up to which the 1 g line of a converter applies to all inputs, as a ratio; None for
    that of the campaign.  `correlations` are those of the priors of noise parameters.  `noise_priors` is the noise
    of the unit from its static records, which takes the place of the model's own once bound to a campaign.  `set_aside`
    are readings that are left out.  `classes` are effects of the user that are defined in this session and in no file.
    `priors_from` is what the priors were taken from, in words; empty for priors of the user.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.load_model("accel-channel").name
    'accel-channel'
    """

    name: str
    effects: tuple[EffectSpec, ...]
    files: tuple[str, ...] = ()
    where: str = "model"
    delta_k_threshold: float | None = None
    correlations: tuple[PriorCorrelation, ...] = ()
    noise_priors: "ModelSpec | None" = None
    set_aside: tuple[SetAside, ...] = ()
    classes: tuple[type, ...] = ()
    priors_from: str = ""


def read_model(path: str | Path) -> ModelSpec:
    """Read a model file, or a shipped model by its name; its own effects are looked for beside it.

    Parameters
    ----------
    path : the file, or the name that `imubayes example` lists; a file on disk comes first.

    Raises
    ------
    InputError
        with everything that is wrong with the file.

    Examples
    --------
    >>> import imubayes
    >>> spec = imubayes.load_model("accel-channel")
    >>> [effect.name for effect in spec.effects][:2]
    ['mounting_error', 'accel_bias']
    """
    path = model_file(path)
    return spec_of_file(read_model_file(path), path)


def build_model(content: Any) -> ModelSpec:
    """Return a model of a mapping with the keys of a model file.

    Parameters
    ----------
    content : keys and values of a model file (`imubayes schema model`).  An effect under `effect` is a mapping, a name,
        or a class of one's own; the `name` of a mapping may be a class as well.  `format` is not needed; paths are
        from the working directory.

    Raises
    ------
    InputError
        with everything that is wrong with the content.

    Examples
    --------
    >>> import imubayes
    >>> bias = {"name": "accel_bias", "prior": {"bias": "normal(0, 2 mg)"}}
    >>> spec = imubayes.build_model({"name": "bench", "effect": ["mounting_error", bias, "white_noise"]})
    >>> [effect.name for effect in spec.effects]
    ['mounting_error', 'accel_bias', 'white_noise']
    """
    if not isinstance(content, Mapping):
        what = f"the content of a model is of type {type(content).__name__}"
        remedy = "give a mapping; a model file is read by imubayes.load_model"
        raise input_error(what, "content", "a mapping with the keys of a model file", remedy)
    document, classes = {"format": 1, **plain_content(content)}, dict[type, None]()
    effects = document.get("effect")
    if isinstance(effects, list):
        document["effect"] = [_named(each, classes) for each in effects]
    made = validated(document, ModelFile, Ledger(Path("content")))
    made.ledger.stop_if_any()
    assert made.entry is not None
    return replace(spec_of_file(made.entry, Path("content")), classes=tuple(classes))


def _named(effect: Any, classes: dict[type, None]) -> Any:
    """Return an effect of a mapping as a file has it, and note the class that it is."""
    entry = effect if isinstance(effect, dict) else {"name": effect}
    member = entry.get("name")
    if not isinstance(member, type):
        return entry
    classes[member] = None
    return {**entry, "name": getattr(member, "name", member.__name__)}


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
        set_aside=tuple(SetAside.model_validate(entry.model_dump()) for entry in file.set_aside),
        priors_from=file.priors_from,
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

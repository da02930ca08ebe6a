"""Registry of effect and noise classes, of the package and of user files; noise of static records in a model.

`imubayes noise` writes what it finds in the static records of a unit as a model of noise alone.  In the models of its
other campaigns it takes the place of the effects of the same names, on the channels that it has and the campaign has.
"""

import hashlib
import importlib.util
import sys
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TypeGuard

from imubayes.effects import EFFECTS, Effect
from imubayes.effects.base import MotionEffect, Stage
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError, closest_first, input_error
from imubayes.foundations.quantity_names import QuantityName
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.trusted_files import note_run
from imubayes.noise import NOISES, Noise
from imubayes.parameters.declarations import declared_parameters

EffectClass = type[Effect] | type[Noise]
"""The class of an effect or of a noise member; a model file lists both as effects."""
_USER = "imubayes_user_"


def acts_on_channels(effect_class: EffectClass) -> bool:
    """Return whether a class acts on single channels; effects on the motion and closure noise act on the whole unit."""
    return not issubclass(effect_class, MotionEffect) and "closure" not in effect_class.kinds


@dataclass(frozen=True)
class Registry:
    """Effects and noise members by name.

    Attributes
    ----------
    effects : name → class; those of the package if none are given.

    Examples
    --------
    >>> import imubayes
    >>> imubayes.Registry().find("accel_bias", "my tool").__name__
    'AccelBias'
    """

    effects: dict[str, EffectClass] = field(default_factory=lambda: {m.name: m for m in (*EFFECTS, *NOISES)})

    def find(self, name: str, where: str) -> EffectClass:
        """Return the member of a name; raises InputError with the closest names."""
        if name not in self.effects:
            raise input_error(
                f"there is no effect '{name}'",
                where,
                closest_first(name, self.effects),
                "correct the name; `imubayes effects` lists all",
            )
        return self.effects[name]

    def of_equipment(self) -> tuple[str, ...]:
        """Return the effects whose width a campaign states of its equipment or site, in the order of the catalogue."""
        return tuple(
            name
            for name, member in self.effects.items()
            if any(declared.equipment for declared in declared_parameters(member).values())
        )

    def with_files(self, files: Iterable[str | Path]) -> "Registry":
        """Return the registry with the effects that Python files define."""
        registry, by_name = self, dict[str, Path]()
        for file in map(Path, files):
            other = by_name.setdefault(file.name, file)
            if other.resolve() != file.resolve():
                raise input_error(
                    f"two effect files are named '{file.name}'", f"{other} and {file}",
                    "files of different names: a result keeps them beside each other", "rename one of them",
                )  # fmt: skip
            for member in _members_of(file):
                registry = registry._with(member, str(file))
        return registry

    def with_classes(self, classes: Iterable[type]) -> "Registry":
        """Return the registry with effects that are defined in this session; those that it has already are passed over.

        Raises
        ------
        InputError
            for a class that is no effect, or has the name of another.
        """
        registry = self
        for member in classes:
            where = f"class {member.__name__}"
            if not _is_effect(member):
                raise input_error(
                    f"the class {member.__name__} is not an effect with a name, a stage and "
                    f"parameters", where, _CLASSES,
                    "derive it from one of these",
                )  # fmt: skip
            if registry.effects.get(member.name) is not member:
                registry = registry._with(member, where)
        return registry

    def _with(self, member: EffectClass, where: str) -> "Registry":
        if member.name in self.effects:
            raise input_error(
                f"the effect '{member.name}' exists already",
                where,
                "a name that neither `imubayes effects` lists nor another file of the model defines",
                "give the new effect a name of its own",
            )
        return Registry({**self.effects, member.name: member})

    def without_files(self) -> "Registry":
        """Return the registry without what files define: for a model that names its files itself."""
        return Registry({name: known for name, known in self.effects.items() if not known.__module__.startswith(_USER)})


_CLASSES = (
    "classes derived from SignalEffect, RecordEffect, MotionEffect, PlaceEffect, EntryNoise, SharedNoise, SeriesNoise "
    "or TailNoise that have a name, parameters and, but for noise, a stage of the signal path"
)


def _is_effect(member: type) -> TypeGuard[EffectClass]:
    named = issubclass(member, Effect | Noise) and isinstance(getattr(member, "name", None), str)
    placed = not issubclass(member, Effect) or isinstance(getattr(member, "stage", None), Stage)
    return named and placed and bool(declared_parameters(member))


def names_in(file: str | Path) -> tuple[str, ...]:
    """Return the names of the effects that a Python file defines; raises InputError if it defines none."""
    return tuple(member.name for member in _members_of(Path(file)))


def _members_of(file: Path) -> list[EffectClass]:
    def refuse(what: str) -> InputError:
        return input_error(
            what,
            str(file),
            f"a Python file with {_CLASSES}",
            "correct the file, or take it out of the model's 'files'",
        )

    if not file.is_file():
        raise refuse("the file with the user's effects is missing")
    name = _USER + hashlib.sha256(str(file.resolve()).encode()).hexdigest()[:12]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None:
        raise refuse("the file is not Python")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    note_run(file)
    try:
        # Not by the loader, which leaves bytecode beside the file.
        exec(compile(file.read_bytes(), str(file), "exec", dont_inherit=True), vars(module))
    except (Exception, SystemExit) as error:
        raise refuse(f"the file cannot be read: {type(error).__name__}: {error}") from error
    found = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and issubclass(value, Effect | Noise) and value.__module__ == name
    ]
    if not found:
        raise refuse("the file defines no effect")
    for member in found:
        if not _is_effect(member):
            raise refuse(f"the class {member.__name__} has no name, no stage or no parameter")
    return found


def with_noise_priors(spec: ModelSpec, campaign: Campaign, registry: Registry) -> ModelSpec:
    """Return the model with the noise from static records in it; the model itself if it names none."""
    if spec.noise_priors is None:
        return spec
    names = tuple(channel.name for channel in campaign.channels)
    given = [entry for each in spec.noise_priors.effects if (entry := _among(each, names)) is not None]
    own = []
    for each in spec.effects:
        kinds = registry.find(each.name, each.where).kinds
        suitable = [channel.name for channel in campaign.channels if channel.kind in kinds]
        entry = _beside(each, given, suitable)
        own += [] if entry is None else [entry]
    blocks = (
        block
        for block in spec.noise_priors.correlations
        if all(QuantityName.of(name).label in names for name in block.parameters)
    )
    correlations = (*spec.correlations, *blocks)
    return replace(spec, effects=(*own, *given), correlations=correlations, noise_priors=None)


def _among(entry: EffectSpec, names: Sequence[str]) -> EffectSpec | None:
    """Return an entry for the channels that the campaign has; None if it has none of them."""
    if entry.channels is None:
        return entry
    shared = tuple(name for name in entry.channels if name in names)
    return replace(entry, channels=shared) if shared else None


def _beside(entry: EffectSpec, given: Sequence[EffectSpec], suitable: Sequence[str]) -> EffectSpec | None:
    """Return an entry of the model for the channels that no given entry of its name has; None if none is left."""
    same = [each for each in given if each.name == entry.name]
    if not same:
        return entry
    if any(each.channels is None for each in same):
        return None
    taken = {name for each in same for name in each.channels or ()}
    left = tuple(name for name in entry.channels or suitable if name not in taken)
    return replace(entry, channels=left) if left else None

"""The examples that come with the package: campaigns, an archive of units, their models and test plans.

A wheel holds them in `imubayes/examples`, a source tree at its top; both have the folders `data` and `models`.  What is
copied keeps these places, so that commands of the documentation run beside a copy as in the source tree.
"""

import shutil
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.files import new_folder, refuse_existing, replacing

_PACKAGE = Path(__file__).parents[1]
_HOME = next((place for place in (_PACKAGE / "examples", _PACKAGE.parents[1]) if (place / "models").is_dir()), _PACKAGE)
_CAMPAIGN = "campaign.toml"
_ARCHIVES = {"unit-archive": "An archive of 24 units like accel-channel, eight of them calibrated twice."}
# Models of a campaign that does not share their name, and the specification of one; it stands with the models.
_MODELS = {"hidden-thermal": "hidden-effects-thermal", "unit-archive": "accel-channel"}
_SPECIFICATIONS = {"full-qualification": "qualification-spec"}


@dataclass(frozen=True)
class Example:
    """A shipped campaign or archive; places are relative to the folder that holds `data` and `models`.

    Attributes
    ----------
    name, summary : what it is called, and what it is.
    data, model : its folder and its model file.
    others : test plans and specifications that go with it.
    """

    name: str
    summary: str
    data: Path
    model: Path
    others: tuple[Path, ...]

    @property
    def is_campaign(self) -> bool:
        """Whether it is one campaign; else it is an archive of several."""
        return self.name not in _ARCHIVES


def examples() -> dict[str, Example]:
    """Return the shipped examples by their names."""
    folders = (file.parent for file in (_HOME / "data").glob(f"*/{_CAMPAIGN}"))
    archives = (_HOME / "data" / name for name in _ARCHIVES)
    return {folder.name: _example(folder) for folder in sorted((*folders, *archives)) if folder.is_dir()}


def example(name: str) -> Example:
    """Return the example of a name.

    Raises
    ------
    InputError
        for a name that no example has.
    """
    found = examples()
    if name not in found:
        allowed = closest_first(name, found, len(found)) or "none: this installation has no examples"
        raise input_error(f"there is no example '{name}'", "examples", allowed, "use one of these names")
    return found[name]


def shipped(place: Path) -> Path:
    """Return where a place of an example is, as short as it can be given from the working directory."""
    found, here = _HOME / place, Path.cwd()
    return found.relative_to(here) if found.is_relative_to(here) else found


def model_names() -> list[str]:
    """Return the names of the shipped models."""
    names = sorted(file.stem for file in (_HOME / "models").glob("*.toml"))
    return [name for name in names if name not in _SPECIFICATIONS.values()]


def model_file(model: str | Path) -> Path:
    """Return the file that a model is named by: a path, or the name of a shipped model if there is no such file.

    Raises
    ------
    InputError
        for a bare name that is neither.
    """
    file = Path(model)
    if file.is_file() or file.suffix or file.name != str(model):
        return file
    named = shipped(Path("models", f"{file}.toml"))
    if file.name not in model_names():
        known = closest_first(file.name, model_names(), 40)
        fault = f"there is no model '{file}': neither a file nor a shipped model has this name"
        raise input_error(fault, str(file), f"the path of a model file, or one of {known}", "correct the name")
    return named


def copy_examples(chosen: Iterable[Example], out: Path) -> list[Path]:
    """Copy examples with their models, plans and specifications; return the places, of copies there already as well.

    Raises
    ------
    InputError
        if a file of another content is in the way; nothing is copied then.
    """
    wanted = list(dict.fromkeys(place for each in chosen for place in (each.data, each.model, *each.others)))
    for source, target in _files(wanted, out):
        refuse_existing(target, but=source.read_bytes().__eq__)
    for place in wanted:
        if (_HOME / place).is_dir() and not (out / place).exists():
            with new_folder(out / place) as draft:
                shutil.copytree(_HOME / place, draft, dirs_exist_ok=True)
    for source, target in _files(wanted, out):
        if not target.exists():
            with replacing(target) as scratch:
                shutil.copyfile(source, scratch)
    return [out / place for place in wanted]


def _files(places: Iterable[Path], out: Path) -> list[tuple[Path, Path]]:
    """Return each file that belongs to some places, and where its copy is."""
    sources = [file for place in places for file in (_HOME / place, *sorted((_HOME / place).rglob("*")))]
    return [(file, out / file.relative_to(_HOME)) for file in sources if file.is_file()]


def _example(folder: Path) -> Example:
    name = folder.name
    summary = _ARCHIVES.get(name) or (folder / _CAMPAIGN).read_text(encoding="utf-8").partition("\n")[0].strip("# ")
    model = _MODELS.get(name) or ("hidden-effects" if name.startswith("hidden-") else name)
    plans = sorted(folder.parent.glob("plans/*-example.toml"))
    mine = (Path("data", "plans", plan.name) for plan in plans if name.startswith(plan.stem.removesuffix("-example")))
    others = (*mine, *(Path("models", f"{limits}.toml") for of, limits in _SPECIFICATIONS.items() if of == name))
    return Example(name, summary, Path("data", name), Path("models", f"{model}.toml"), others)

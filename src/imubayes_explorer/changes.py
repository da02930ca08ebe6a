"""Changes of a model that a page asks for: what makes them, what shows them before the fit, and the command of each."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from operator import methodcaller
from pathlib import Path

from imubayes.api import add, refit, remove
from imubayes.display.loop import diagnosis_report as report
from imubayes.display.numbers_and_labels import command_line
from imubayes.foundations.errors import InputError, input_error
from imubayes.foundations.files import write_text
from imubayes.foundations.progress import Tell
from imubayes.loop.model_changes import reduce
from imubayes.results.change_records import ModelChange
from imubayes.results.result_folder import write_model
from imubayes_explorer.edited_model import EditedModel, edited_model
from imubayes_explorer.messages import ChangeWanted
from imubayes_explorer.open_model import OpenModel, shown
from imubayes_explorer.refit_ahead import Ahead


@dataclass(frozen=True)
class Change:
    """A change of a model.

    Attributes
    ----------
    what, command : of it, in words, and what does the same.
    make, predict : what does it, and what shows it before the fit is made.
    adding : effects that are added, of which there is a linear prediction as well.
    write, file : what writes the file that it needs; the file goes if the change is not made.
    """

    what: str
    command: str
    make: Callable[[Tell], ModelChange]
    predict: Callable[[], Ahead | None]
    adding: tuple[str, ...] = ()
    write: Callable[[], object] = lambda: None
    file: Path | None = None

    @cached_property
    def ahead(self) -> Ahead | None:
        """What it does to the residuals; None if that takes the fit, and if the fit will say what is wrong."""
        try:
            return self.predict()
        except InputError:
            return None

    def written(self, tell: Tell) -> ModelChange:
        """Make the change."""
        self.write()
        try:
            return self.make(tell)
        except BaseException:
            if self.file is not None:
                self.file.unlink(missing_ok=True)
            raise


def change_of(model: OpenModel, wanted: ChangeWanted, locked: Sequence[str], others: Sequence[OpenModel]) -> Change:
    """Return a change as it was asked for.

    Parameters
    ----------
    locked : effects that are always added.
    others : models that are ready, one of which may have readings that are taken back.

    Raises
    ------
    InputError
        for a formula of a residual that has none, and an edit that is not possible.
    """
    if wanted.formula_of:
        return _adding_formula(model, wanted)
    if wanted.add:
        also = (name for name in locked if name in model.view.variants)
        return _adding(model, tuple(dict.fromkeys((*wanted.add, *also))), wanted.channels)
    if wanted.remove:
        return _removing(model, wanted.remove)
    return _refitting(model, edited_model(model, wanted), others)


def _adding(model: OpenModel, effects: tuple[str, ...], channels: tuple[str, ...] | None) -> Change:
    folder, channels = folder_for(model, effects[0]), channels or model.channels_for(effects)
    return Change(
        what=f"add {', '.join(effects)}",
        command=report.add_command(effects, channels, model.place, shown(folder)),
        make=lambda tell: add(model.result, effects, folder, channels, diagnosis=model.told, progress=tell),
        predict=lambda: model.ahead_of_adding(effects, channels),
        adding=effects,
    )


def _adding_formula(model: OpenModel, wanted: ChangeWanted) -> Change:
    """Return the change of writing an effect for the formula of a residual, and adding it on its channel."""
    channel, found = wanted.formula_of, model.view.formula(wanted.formula_of, wanted.drawn)
    if found is None:
        raise input_error(f"the residual of {channel} has no formula", "formula", "a channel with a formula",
                          "choose another channel")  # fmt: skip
    folder = folder_for(model, "found_shape")
    file = folder.with_name(f"{folder.name}.py")
    view = model.view
    return Change(
        what=f"add the formula of {channel}",
        command=report.add_command([shown(file)], [channel], model.place, shown(folder)),
        make=lambda tell: add(model.result, [str(file)], folder, [channel], diagnosis=model.diagnosis, progress=tell),
        predict=lambda: view.ahead(view.fit.model, columns=view.columns_of(found, wanted.drawn)),
        write=lambda: write_text(file, report.formula_source(found)),
        file=file,
    )


def _removing(model: OpenModel, effects: tuple[str, ...]) -> Change:
    folder = folder_for(model, f"without-{effects[0]}")
    return Change(
        what=f"remove {', '.join(effects)}",
        command=command_line("remove", *effects, "--from", model.place, "--out", shown(folder)),
        make=lambda tell: remove(model.result, effects, folder, progress=tell),
        predict=lambda: model.view.ahead(reduce(model.view.fit, effects).model),
    )


def _refitting(model: OpenModel, edited: EditedModel, others: Sequence[OpenModel]) -> Change:
    """Return the change to an edited model; its file stays beside the results, as the command names it."""
    folder = folder_for(model, edited.word)
    file = folder.with_name(f"{folder.name}.toml")
    ahead_of = methodcaller("ahead_of", edited.spec)
    return Change(
        what=edited.what,
        command=command_line("refit", model.place, "--model", shown(file), "--out", shown(folder)),
        make=lambda tell: refit(model.result, file, folder, progress=tell),
        predict=lambda: next(filter(None, map(ahead_of, (model, *others))), None),
        write=lambda: write_model(edited.spec, file),
        file=file,
    )  # fmt: skip


def folder_for(model: OpenModel, word: str) -> Path:
    """Return a free folder beside a model for the one that follows it."""
    number, first = 1, model.folder.with_name(f"{model.folder.name}-{word}")
    folder = first
    while folder.exists():
        number += 1
        folder = first.with_name(f"{first.name}-{number}")
    return folder

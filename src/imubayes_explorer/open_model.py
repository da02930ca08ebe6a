"""An open model: its result, diagnosis and linear model in memory, and the state that the page receives."""

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from inspect import getdoc
from pathlib import Path

import numpy as np

from imubayes import Diagnosis
from imubayes.adequacy.known_noise_fit import KnownNoisePoint
from imubayes.criticism.diagnose import ExplainedFit, Heard, explained_fit
from imubayes.criticism.diagnosis_record import ScreenedEffect
from imubayes.criticism.explanation_records import WeighedSoFar
from imubayes.display.fit_cautions import set_aside_text
from imubayes.display.fit_quality_tables import run_design_text
from imubayes.display.loop import diagnosis_report as report
from imubayes.display.loop.diagnosis_sentences import evidence_text, form_text, sentence
from imubayes.foundations.errors import InputError, input_error, kept_if_possible
from imubayes.foundations.progress import Tell
from imubayes.foundations.tail_probabilities import chi2_survival
from imubayes.loop.warm_start import extended
from imubayes.model.bind import bind
from imubayes.model.model_file import ModelSpec
from imubayes.results.change_records import read_diagnosis, write_diagnosis
from imubayes.results.folder_files import same_fit
from imubayes.results.history_tree import shown_place
from imubayes.results.result import Result
from imubayes_explorer import messages
from imubayes_explorer.drawn_shape import DrawnCurve, DrawnFormula
from imubayes_explorer.known_noise_view import KnownNoiseView, nowhere, view_of
from imubayes_explorer.linear_view import LinearView
from imubayes_explorer.point_table import PointTable
from imubayes_explorer.refit_ahead import Ahead
from imubayes_explorer.selection_text import drawn_text, formula_text, preview_text, refitted_text, selection_text

Stamp = frozenset[tuple[str, int, int, int]]
"""Files, with what shows that one was replaced."""


@dataclass(frozen=True)
class OpenModel:
    """A result that is open: its readings at once, what is said of them once its explanations are weighed.

    Attributes
    ----------
    id : its name on the page.
    result, readings, table : the result, its fit at the known noise, and its readings.
    stamp : of the files of the campaign when it was opened.
    told : what the diagnosis says: made now, or found in the folder; None before there is one.
    so_far : what the search at work has weighed of the explanations.
    linear : the linear model with every candidate; None before the explanations are weighed.
    """

    id: str
    result: Result
    readings: KnownNoiseView
    table: PointTable
    stamp: Stamp
    told: Diagnosis | None = None
    so_far: WeighedSoFar | None = None
    linear: LinearView | None = None

    @property
    def stage(self) -> messages.Stage:
        """How far it is open."""
        return "read" if self.told is None else "told" if self.linear is None else "ready"

    @property
    def diagnosis(self) -> Diagnosis:
        """What the diagnosis says; raises InputError before there is one."""
        return self._there(self.told)

    @property
    def view(self) -> LinearView:
        """The linear model with every candidate; raises InputError before the explanations are weighed."""
        return self._there(self.linear)

    def _there[T](self, found: T | None) -> T:
        if found is None:
            raise input_error("the explanations of this model are still being weighed", str(self.folder),
                              "a model whose explanations are weighed", "wait until they are")  # fmt: skip
        return found

    def replaced(self) -> bool:
        """Return whether its folder no longer holds the result that was opened."""
        try:
            same_fit(self.folder, self.result.identity)
        except (InputError, OSError):
            return True
        return False

    @property
    def folder(self) -> Path:
        """The result folder."""
        assert self.result.folder is not None
        return self.result.folder

    @property
    def place(self) -> str:
        """The result folder as it is shown."""
        return shown(self.folder)

    def campaign_changed(self) -> bool:
        """Return whether a file of the campaign is another one than when the model was opened."""
        return campaign_stamp(self.result) != self.stamp

    def facts(self) -> messages.ModelFacts:
        """Return what the page shows of the model."""
        model, table = self.readings.fit.model, self.table
        record = self.readings.point.record()
        facts = messages.ModelFacts(
            id=self.id,
            stage=self.stage,
            identity=self.result.identity,
            folder=shown_place(str(self.folder.resolve())),
            name=model.spec.name,
            campaign=model.campaign.name,
            chi2=record.chi2,
            dof=record.dof,
            cells=table.cells(),
            channels=table.channels,
            runs=table.run_names,
            abscissae=table.abscissae,
            labels=table.labels(),
            effects=tuple(
                messages.ModelEffect(name=effect.name, channels=effect.channels or ()) for effect in model.spec.effects
            ),
            set_aside=tuple(map(set_aside_text, model.spec.set_aside)),
        )
        if self.told is None:
            return facts
        found = self.told
        evidence = found.explanations
        return facts.model_copy(update={
            "verdict": found.verdict,
            "sentence": sentence(found),
            "evidence": evidence_text(evidence) if evidence is not None else "",
            "explanations": evidence.explanations if evidence is not None else (),
            "causes": tuple(self._causes(found)),
            "separating": tuple(
                run_design_text(group.discriminating_run) if group.discriminating_run is not None else ""
                for group in found.groups
            ),
            "named": found.proposed.effects if found.proposed is not None else (),
            "command": report.next_command(found.model_copy(update={"result": self.place})),
        })  # fmt: skip

    def _causes(self, told: Diagnosis) -> list[messages.CauseLine]:
        registry, found = self.readings.fit.model.registry, []
        groups = {
            member.effect: place
            for place, group in reversed(list(enumerate(told.groups, 1)))
            for member in group.candidates
        }
        for line in told.ranking:
            shown = told.estimate(line.effect) or line
            found.append(messages.CauseLine(
                effect=line.effect, probability=line.probability, log_odds=line.log_odds, delta_chi2=shown.delta_chi2,
                coefficient=report.coefficient_text(shown), group=groups.get(line.effect),
                words=(getdoc(registry.effects[line.effect]) or "").partition("\n")[0],
            ))  # fmt: skip
        return found

    def select(self, brushes: Sequence[messages.Brush], without: Sequence[str]) -> messages.SelectionFacts:
        """Return what selected rows say; some effects are not considered.

        Before the explanations are weighed that is their χ² alone.
        """
        chosen = self.table.chosen(brushes)
        n, chi2 = int(chosen.sum()), float(np.sum(self.readings.whitened()[chosen] ** 2))
        p = float(chi2_survival(chi2, float(n))) if n else None
        rms = self.table.rms(chosen) if n else (None, "")
        found = self.linear.rank(chosen, without) if self.linear is not None else messages.NOT_RANKED
        best = (found.causes[0].effect, found.causes[0].probability) if found.causes else None
        told = self.told.explanations.form if self.told is not None and self.told.explanations is not None else None
        words = form_text(told) if told is not None and found.form is not None else ""
        if found.form is not None and found.form > (best[1] if best is not None else 0.0):
            best = words, found.form
        return messages.SelectionFacts(
            **dict(found), n=n, of=int(self.readings.entries.sum()), chi2=chi2, form_words=words,
            sentence=selection_text(n, chi2, p, rms, best, found.nothing, found.offset),
            runs=tuple(map(str, np.unique(self.table.runs[self.table.run[chosen]]))),
        )  # fmt: skip

    def ahead_of_adding(self, effects: Sequence[str], channels: Sequence[str] | None) -> Ahead | None:
        """Return the refit with effects at the noise known beforehand; None if it takes the whole fit."""
        fitted, told = self.view.fit.model, [self.diagnosis.estimate(each) for each in effects]
        spec = extended(fitted.spec, effects, channels, fitted.campaign, fitted.registry.without_files())
        return self.ahead_of(spec, [line for line in told if line is not None])

    def ahead_of(self, spec: ModelSpec, estimates: Sequence[ScreenedEffect] = ()) -> Ahead | None:
        """Return the refit of an edited model at the noise known beforehand; None if it takes the whole fit."""
        fitted = self.view.fit.model
        known = fitted.campaign.set_aside
        if not set(known) <= set(spec.set_aside):
            return None  # readings that are taken back are at hand if there is a model with them
        spec = replace(spec, set_aside=tuple(each for each in spec.set_aside if each not in known) or known)
        return self.view.ahead(bind(spec, fitted.campaign, fitted.registry.without_files()), estimates)

    def preview(
        self, effects: Sequence[str], out: str, ahead: Ahead | None = None, what: str = "", by: PointTable | None = None
    ) -> messages.PreviewFacts:
        """Return what causes would do together, or what a change does.

        Parameters
        ----------
        out : folder of the command that adds them.
        ahead, what, by : the change, its name, and the table of the readings that it is of; this model's if None.
        """
        shown = self.with_causes(effects) if ahead is None else ahead
        predicted = shown.point if ahead is None else self.view.with_causes(effects)
        drop, moved = self._drop(shown.point), self.view.moved(shown.point)
        largest = (moved[0].name, moved[0].in_sd) if moved else None
        command = report.add_command(effects, self.channels_for(effects), self.place, out) if effects else ""
        return messages.PreviewFacts(
            effects=tuple(effects) or ((what,) if ahead is not None else ()), refitted=ahead is not None,
            delta_chi2=drop, cells=(by or self.table).expected(shown, self.table), moved=moved, command=command,
            sentence=preview_text(effects, self._drop(predicted), largest) if ahead is None
            else refitted_text(what, self._drop(predicted) if effects else None, drop, largest),
        )  # fmt: skip

    def with_causes(self, effects: Sequence[str]) -> Ahead:
        """Return the fit with causes beside, linear if they are."""
        return Ahead(self.view.with_causes(effects), ~self.view.entries)

    def _drop(self, point: KnownNoisePoint) -> float:
        """Return the drop of χ² at the noise known beforehand."""
        return float(self.view.point.left @ self.view.point.left - point.left @ point.left)

    def formula(self, channel: str, drawn: DrawnCurve | None = None) -> messages.FormulaFacts:
        """Return the formula of what the model leaves of a channel, or of a drawing, and the effect that it becomes."""
        found = self.view.formula(channel, drawn)
        sheet = report.formula_sheet(
            self.diagnosis.model_copy(update={"formulas": (found,) if found is not None else ()})
        )
        return messages.FormulaFacts(
            sentence=drawn_text(found) if isinstance(found, DrawnFormula) else formula_text(found, channel),
            table=messages.shown_table(sheet) if found is not None else None,
            source=report.formula_source(found) if found is not None else "",
        )

    def channels_for(self, effects: Sequence[str]) -> tuple[str, ...] | None:
        """Return the channels on which a single effect was found; None if the command needs none named."""
        return self.told.channels_for(effects[0]) if self.told is not None and len(effects) == 1 else None


def shown(folder: Path) -> str:
    """Return a folder as it is shown: a command quotes it."""
    return shown_place(str(folder.resolve()))


def stamp_of(files: Iterable[Path]) -> Stamp:
    """Return what shows that one of some files was replaced or is gone."""
    found = set[tuple[str, int, int, int]]()
    for file in files:
        with suppress(FileNotFoundError):  # removed meanwhile
            stat = file.stat()
            found.add((str(file), stat.st_ino, stat.st_size, stat.st_mtime_ns))
    return frozenset(found)


def campaign_stamp(result: Result) -> Stamp:
    """Return the stamp of the files of the campaign of a result."""
    folder = result.fit.model.campaign.folder
    return stamp_of(filter(Path.is_file, Path(folder).rglob("*")) if folder else ())


def opened(name: str, result: Result, tell: Tell) -> OpenModel:
    """Return a result with its readings at the noise known beforehand, and the diagnosis that its folder holds, if any.

    Raises
    ------
    InputError
        if its campaign is gone or has changed, or the fit stands nowhere finite.
    """
    tell("reading the fit")
    fit, folder = result.fit, result.folder
    assert folder is not None
    tell("laying out the readings")
    readings = view_of(fit, str(folder))
    return OpenModel(name, result, readings, PointTable(result, readings), campaign_stamp(result), _kept(result))


def _kept(result: Result) -> Diagnosis | None:
    """Return the diagnosis that the folder of a result holds of it; None if there is none, or it is not whole."""
    assert result.folder is not None
    try:
        same_fit(result.folder, result.identity)
        return read_diagnosis(result.folder)
    except (InputError, OSError):
        return None


def weighed(model: OpenModel, tell: Tell, heard: Heard) -> ExplainedFit:
    """Return the fit of an open model with its explanations weighed; `heard` receives them meanwhile.

    Raises
    ------
    InputError
        if there is no fit to diagnose.
    """
    explained = explained_fit(model.result.fit, str(model.folder), tell, heard)
    if explained is None:
        raise nowhere(model.result.fit, str(model.folder))
    return explained


def told(model: OpenModel, explained: ExplainedFit) -> OpenModel:
    """Return an open model with what the diagnosis says.

    It is kept in its folder if it can be, as `imubayes diagnose` does; one that the folder holds stands.
    """
    if model.told is not None:
        return model
    found = explained.diagnosis()
    with kept_if_possible(model.folder):
        write_diagnosis(model.folder, found, model.result.identity)
    return replace(model, told=found)


def ready(model: OpenModel, explained: ExplainedFit, tell: Tell) -> OpenModel:
    """Return an open model that has its diagnosis, ready for previews and selections."""
    found = model.diagnosis
    view = LinearView(explained, found, model.result.summary)
    view.prepare(tell)
    ready = replace(model, linear=view)
    effects = found.proposed.effects if found.proposed is not None else tuple(view.variants)[:1]
    ready.ahead_of_adding(effects, ready.channels_for(effects))  # so that the first is as fast as the others
    return ready

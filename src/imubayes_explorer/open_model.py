"""A model that is open: its result, diagnosis and linear model in memory, and what the page is told of it."""

import shlex
from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from inspect import getdoc
from pathlib import Path

import numpy as np

from imubayes.adequacy.known_noise_fit import KnownNoisePoint
from imubayes.criticism.diagnose import explained_fit
from imubayes.criticism.diagnosis_record import Diagnosis, ScreenedEffect
from imubayes.display.fit_cautions import set_aside_text
from imubayes.display.fit_quality_tables import run_design_text
from imubayes.display.loop import diagnosis_report as report
from imubayes.display.loop.diagnosis_sentences import evidence_text, form_text, sentence
from imubayes.foundations.errors import input_error, kept_if_possible
from imubayes.foundations.progress import Tell
from imubayes.foundations.tail_probabilities import chi2_survival
from imubayes.loop.warm_start import extended
from imubayes.model.bind import bind
from imubayes.model.model_file import ModelSpec
from imubayes.results.change_records import write_diagnosis
from imubayes.results.history_tree import shown_place
from imubayes.results.result import Result
from imubayes_explorer import messages
from imubayes_explorer.drawn_shape import DrawnCurve, DrawnFormula
from imubayes_explorer.linear_view import LinearView
from imubayes_explorer.point_table import PointTable
from imubayes_explorer.refit_ahead import Ahead
from imubayes_explorer.selection_text import drawn_text, formula_text, preview_text, refitted_text, selection_text

Stamp = frozenset[tuple[str, int, int, int]]
"""Files, with what tells that one was replaced."""


@dataclass(frozen=True)
class OpenModel:
    """A diagnosed result.

    Attributes
    ----------
    id : its name on the page.
    result, diagnosis, view, table : the result, what the diagnosis says, its linear model, and its readings.
    stamp : of the files of the campaign when it was opened.
    """

    id: str
    result: Result
    diagnosis: Diagnosis
    view: LinearView
    table: PointTable
    stamp: Stamp

    @property
    def folder(self) -> Path:
        """The result folder."""
        assert self.result.folder is not None
        return self.result.folder

    @property
    def place(self) -> str:
        """The result folder as it stands in a command."""
        return quoted(self.folder)

    def campaign_changed(self) -> bool:
        """Tell whether a file of the campaign is another one than when the model was opened."""
        return campaign_stamp(self.result) != self.stamp

    def facts(self) -> messages.ModelFacts:
        """Return what the page shows of the model."""
        found, model, table = self.diagnosis, self.view.fit.model, self.table
        record = self.view.point.record()
        said = found.model_copy(update={"result": self.place})
        return messages.ModelFacts(
            id=self.id,
            folder=shown_place(str(self.folder.resolve())),
            name=model.spec.name,
            campaign=model.campaign.name,
            verdict=found.verdict,
            sentence=sentence(found),
            evidence=evidence_text(found.explanations) if found.explanations is not None else "",
            explanations=found.explanations.explanations if found.explanations is not None else (),
            chi2=record.chi2,
            dof=record.dof,
            causes=tuple(self._causes()),
            separating=tuple(
                run_design_text(group.discriminating_run) if group.discriminating_run is not None else ""
                for group in found.groups
            ),
            cells=table.cells(),
            channels=table.channels,
            runs=table.run_names,
            abscissae=table.abscissae,
            groupings=table.groupings(),
            effects=tuple(effect.name for effect in model.spec.effects),
            set_aside=tuple(map(set_aside_text, model.spec.set_aside)),
            command=report.next_command(said),
        )

    def _causes(self) -> list[messages.CauseLine]:
        registry, found = self.view.fit.model.registry, []
        groups = {
            member.effect: place
            for place, group in reversed(list(enumerate(self.diagnosis.groups, 1)))
            for member in group.candidates
        }
        for line in self.diagnosis.ranking:
            shown = self.diagnosis.estimate(line.effect) or line
            found.append(messages.CauseLine(
                effect=line.effect, probability=line.probability, log_odds=line.log_odds, delta_chi2=shown.delta_chi2,
                coefficient=report.coefficient_text(shown), group=groups.get(line.effect),
                words=(getdoc(registry.effects[line.effect]) or "").partition("\n")[0],
            ))  # fmt: skip
        return found

    def select(self, brushes: Sequence[messages.Brush], without: Sequence[str]) -> messages.SelectionFacts:
        """Return what selected rows say; some effects are not considered."""
        chosen, view = self.table.chosen(brushes), self.view
        n, chi2 = int(chosen.sum()), float(np.sum(view.whitened()[chosen] ** 2))
        p = float(chi2_survival(chi2, float(n))) if n else None
        rms = self.table.rms(chosen) if n else (None, "")
        found = view.rank(chosen, without)
        best = (found.causes[0].effect, found.causes[0].probability) if found.causes else None
        told = self.diagnosis.explanations.form if self.diagnosis.explanations is not None else None
        words = form_text(told) if told is not None and found.form is not None else ""
        if found.form is not None and found.form > (best[1] if best is not None else 0.0):
            best = words, found.form
        return messages.SelectionFacts(
            **dict(found), n=n, of=int(view.entries.sum()), chi2=chi2, form_words=words,
            sentence=selection_text(n, chi2, p, rms, best, found.nothing, found.offset),
            runs=tuple(map(str, np.unique(self.table.runs[self.table.run[chosen]]))),
        )  # fmt: skip

    def ahead_of_adding(self, effects: Sequence[str], channels: Sequence[str] | None) -> Ahead | None:
        """Return the refit with effects at the noise known beforehand; None where it takes the whole fit."""
        fitted, told = self.view.fit.model, [self.diagnosis.estimate(each) for each in effects]
        spec = extended(fitted.spec, effects, channels, fitted.campaign, fitted.registry.without_files())
        return self.ahead_of(spec, [line for line in told if line is not None])

    def ahead_of(self, spec: ModelSpec, estimates: Sequence[ScreenedEffect] = ()) -> Ahead | None:
        """Return the refit of an edited model at the noise known beforehand; None where it takes the whole fit."""
        fitted = self.view.fit.model
        known = fitted.campaign.set_aside
        if not set(known) <= set(spec.set_aside):
            return None  # readings that are taken back are at hand where there is a model with them
        spec = replace(spec, set_aside=tuple(each for each in spec.set_aside if each not in known) or known)
        return self.view.ahead(bind(spec, fitted.campaign, fitted.registry.without_files()), estimates)

    def preview(
        self, effects: Sequence[str], out: str, ahead: Ahead | None = None, what: str = "", by: PointTable | None = None
    ) -> messages.PreviewFacts:
        """Return what causes would do together, or what a change does.

        Parameters
        ----------
        out : folder of the command that adds them.
        ahead, what, by : the change, its name, and the table of the readings that it is of; this model's where None.
        """
        predicted = self.view.with_causes(effects)
        shown = Ahead(predicted, ~self.view.entries) if ahead is None else ahead
        drop, moved = self._drop(shown.point), self.view.moved(shown.point)
        largest = (moved[0].name, moved[0].in_sd) if moved else None
        command = report.add_command(effects, self.channels_for(effects), self.place, out) if effects else ""
        return messages.PreviewFacts(
            effects=tuple(effects) or ((what,) if ahead is not None else ()), refitted=ahead is not None,
            delta_chi2=drop, cells=(by or self.table).expected(shown, self.table), moved=moved, command=command,
            sentence=preview_text(effects, self._drop(predicted), largest) if ahead is None
            else refitted_text(what, self._drop(predicted) if effects else None, drop, largest),
        )  # fmt: skip

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
        """Return the channels on which a single effect was found; None where the command needs none named."""
        return self.diagnosis.channels_for(effects[0]) if len(effects) == 1 else None


def quoted(folder: Path) -> str:
    """Return a folder as it stands in a command."""
    return shlex.quote(shown_place(str(folder.resolve())))


def stamp_of(files: Iterable[Path]) -> Stamp:
    """Return what tells that one of some files was replaced or is gone."""
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
    """Return a result diagnosed; the diagnosis is kept in its folder where it can be, as `imubayes diagnose` does.

    Raises
    ------
    InputError
        where its campaign is gone or has changed, or there is no fit to diagnose.
    """
    tell("reading the fit")
    fit, folder = result.fit, result.folder
    assert folder is not None
    explained = explained_fit(fit, str(folder), tell)
    if explained is None:
        raise input_error(
            fit.message or "the fit did not converge", str(folder), "a fit that converged",
            "remove the cause, and fit again until it converges",
        )  # fmt: skip
    found = explained.diagnosis()
    with kept_if_possible(folder):
        write_diagnosis(folder, found, result.identity)
    tell("laying out the readings")
    view = LinearView(explained, found, result.summary)
    model = OpenModel(name, result, found, view, PointTable(result, view), campaign_stamp(result))
    view.prepare(tell)
    effects = found.proposed.effects if found.proposed is not None else tuple(view.variants)[:1]
    model.ahead_of_adding(effects, model.channels_for(effects))  # so that the first is as fast as the others
    return model

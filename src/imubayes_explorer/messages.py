"""Requests of the page and answers of the server, as typed records.

A view of the points is asked for by a `PointsWanted`; a selection is a list of `Brush`es, each a rectangle on a panel,
and means the same rows in every window and after a reload.
"""

from typing import Literal

from pydantic import Field

from imubayes.criticism.diagnosis_record import CovariateLabel
from imubayes.criticism.explanation_records import ProbableExplanation, Verdict, WeighedSoFar
from imubayes.display.layout import Sheet
from imubayes.foundations.records import Record
from imubayes_explorer.drawn_shape import DrawnCurve
from imubayes_explorer.kept_session import Lock, ModelNote

Ordinate = Literal["known", "input", "fitted"]
"""Residual over the noise known beforehand, in input units, or over the noise as fitted."""
Grouping = Literal["run", "mounting", "temperature", "table"]
Stage = Literal["read", "told", "ready"]
"""How far a model is open: its readings, what the diagnosis says, and previews and selections by its linear model."""


class ShownTable(Record):
    """A table: texts of its cells, which columns are left-aligned, and cells, row by row, that need attention."""

    title: str
    head: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: tuple[int, ...]
    note: str
    doubtful: tuple[int, ...]


def shown_table(sheet: Sheet) -> ShownTable:
    """Return a sheet as it is sent."""
    moods = [cell.mood for row in sheet.rows for cell in row]
    return ShownTable(
        title=sheet.title,
        head=tuple(sheet.head),
        rows=tuple(tuple(cell.text for cell in row) for row in sheet.rows),
        left=tuple(sheet.left),
        note=sheet.note,
        doubtful=tuple(k for k, mood in enumerate(moods) if mood in ("weak", "bad")),
    )


class Brush(Record):
    """A rectangle on a panel: rows with an abscissa and, if `y` names an ordinate, a residual between bounds.

    Attributes
    ----------
    channels, runs : names; empty for all.
    rows : of these runs, counted from 1; empty for all.
    x : column of the covariate; empty if any abscissa will do.
    """

    channels: tuple[str, ...] = ()
    runs: tuple[str, ...] = ()
    rows: tuple[int, ...] = Field((), max_length=200)
    x: str = ""
    x_low: float = 0.0
    x_high: float = 0.0
    y: Ordinate | None = None
    y_low: float = 0.0
    y_high: float = 0.0


class ModelWanted(Record):
    """A model by its id."""

    model: str


class SelectionWanted(ModelWanted):
    """Which rows of a model are selected."""

    brushes: tuple[Brush, ...] = Field(max_length=200)


class PreviewWanted(ModelWanted):
    """Which causes are previewed on a model, together, or the task whose change is shown before its fit is made."""

    effects: tuple[str, ...] = Field((), max_length=20)
    task: int = 0


class PointsWanted(PreviewWanted):
    """Which points are drawn: one channel of some runs, or of all if there are none named.

    Attributes
    ----------
    x, y, colour : column of the abscissa, the residual, and what distinguishes the points.
    between : part of the abscissa that is shown; None for all.
    brushes : the selection.
    most : points at most, beyond which the extremes of each place stand for all.
    """

    channel: str
    runs: tuple[str, ...] = ()
    x: str
    y: Ordinate = "known"
    colour: Grouping = "run"
    between: tuple[float, float] | None = None
    brushes: tuple[Brush, ...] = Field((), max_length=200)
    most: int = Field(12_000, ge=100, le=50_000)


class ChangeWanted(ModelWanted):
    """A change of a model.

    No code is taken from a page: an effect is made of the formula that is found again.

    Attributes
    ----------
    add, channels, remove : effects added, on channels, or removed.
    formula_of, drawn : channel the formula of whose residual, or of a shape drawn over it, is added.
    prior_of, prior : parameter, and its prior as a model file has it; empty for the default.
    aside, reason : readings that are set aside, and why.
    take_back : places in the list of those set aside.
    """

    add: tuple[str, ...] = ()
    remove: tuple[str, ...] = ()
    formula_of: str = ""
    drawn: DrawnCurve | None = None
    channels: tuple[str, ...] | None = None
    prior_of: str = ""
    prior: str = Field("", max_length=200)
    aside: tuple[Brush, ...] = Field((), max_length=200)
    reason: str = Field("", max_length=400)
    take_back: tuple[int, ...] = ()


class FormulaWanted(ModelWanted):
    """The channel of a model whose residual is put into a formula, or a shape drawn over it."""

    channel: str
    drawn: DrawnCurve | None = None


class FormulaFacts(Record):
    """A formula of a residual: its terms, and the effect that it becomes; `source` is empty without one."""

    sentence: str
    table: ShownTable | None
    source: str


class NoteWanted(ModelNote, ModelWanted):
    """A name and a note of a model."""


class PointWanted(ModelWanted):
    """A reading of a model by its place."""

    entry: int


class QuantitiesWanted(ModelWanted):
    """Quantities of a model by their names."""

    names: tuple[str, ...] = Field(min_length=1, max_length=6)


class LockWanted(Record):
    """An effect that is always added, never proposed, or neither."""

    effect: str
    lock: Lock | Literal[""]


class ExpectedCell(Record):
    """Readings and χ² of one channel of one run; with a preview, without those that it sets aside."""

    n: int
    chi2: float


class MapCell(ExpectedCell):
    """One channel of one run; χ² is at the noise known beforehand and as fitted, rms at the first, in `unit`."""

    run: str
    channel: str
    fitted: float | None
    rms: float
    unit: str


class RankedCause(Record):
    """A cause of chosen rows, with its probability among single effects, an offset of these rows, and none."""

    effect: str
    probability: float
    log_odds: float


class CauseLine(RankedCause):
    """A possible cause.

    Attributes
    ----------
    group : number of the group of effects that the runs cannot distinguish; None outside of the leading explanation.
    delta_chi2, coefficient : predicted drop of χ², and its most significant coefficient in words.
    words : what it is.
    """

    delta_chi2: float
    coefficient: str
    words: str
    group: int | None = None


class GroupLabels(Record):
    """What distinguishes runs, and the group of each run, in the order of the runs."""

    by: Grouping
    labels: tuple[str, ...]


class ModelEffect(Record):
    """An effect of a model, and the channels that it acts on if its entry names them; empty for all."""

    name: str
    channels: tuple[str, ...] = ()


class ModelFacts(Record):
    """What the page shows of a model that is open; of one that is only read, no verdict and no causes.

    Attributes
    ----------
    stage, identity : how far it is open, and of which result.
    sentence, evidence : the verdict, and the probability of each explanation, in words.
    command, named : the next command of the loop, and the effects that it adds.
    separating : of each group the run that would distinguish its effects, in words.
    effects, set_aside : of the model, and the readings that it leaves out, in words.
    """

    id: str
    stage: Stage
    identity: str
    folder: str
    name: str
    campaign: str
    verdict: Verdict | None = None
    sentence: str = ""
    evidence: str = ""
    explanations: tuple[ProbableExplanation, ...] = ()
    chi2: float
    dof: float
    causes: tuple[CauseLine, ...] = ()
    separating: tuple[str, ...] = ()
    cells: tuple[MapCell, ...]
    channels: tuple[str, ...]
    runs: tuple[str, ...]
    abscissae: tuple[CovariateLabel, ...]
    labels: tuple[GroupLabels, ...]
    effects: tuple[ModelEffect, ...]
    set_aside: tuple[str, ...]
    command: str = ""
    named: tuple[str, ...] = ()


class OpenState(Record):
    """Which model is open, how far, of which result, and whether its folder holds another one by now.

    Attributes
    ----------
    so_far : what has been weighed of its explanations, while they are.
    """

    id: str
    stage: Stage
    identity: str
    replaced: bool
    so_far: WeighedSoFar | None = None


class RowsRanking(Record):
    """Causes of chosen rows, the most probable first, and the probabilities of what else they may be.

    Attributes
    ----------
    nothing : of noise alone; None before the explanations are weighed.
    form : of the form outside the catalogue, or the wrong record, of the leading explanation; None without one.
    offset : of an offset of these rows alone; None if all rows are chosen, of which an offset is a bias.
    """

    causes: tuple[RankedCause, ...]
    nothing: float | None
    form: float | None
    offset: float | None


NOT_RANKED = RowsRanking(causes=(), nothing=None, form=None, offset=None)
"""Knowledge of the causes of chosen rows before the explanations are weighed."""


class SelectionFacts(RowsRanking):
    """What is said of selected rows.

    Attributes
    ----------
    form_words : what the form, or wrong record, of the leading explanation is.
    sentence : the same in words.
    runs : those with selected rows.
    """

    n: int
    of: int
    chi2: float
    form_words: str
    sentence: str
    runs: tuple[str, ...]


class MovedEstimate(Record):
    """What a previewed cause would do to an estimate: where it would be, and the shift in its standard uncertainty."""

    name: str
    unit: str
    after: str
    in_sd: float


class PreviewFacts(Record):
    """What previewed causes would do.

    Attributes
    ----------
    delta_chi2 : predicted drop of χ² at the noise known beforehand, of all together.
    cells : what is expected of each run and channel, in the order of the model's cells.
    moved : estimates that would move, those that would most first.
    effects, refitted : the causes, or the name of a change whose refit these are.
    task : that was asked for; if nothing is refitted, its residuals come with the fit.
    sentence, command : the prediction in words, and the command that adds the causes.
    """

    effects: tuple[str, ...]
    refitted: bool
    task: int = 0
    delta_chi2: float
    cells: tuple[ExpectedCell, ...]
    moved: tuple[MovedEstimate, ...]
    sentence: str
    command: str


class PointsHead(Record):
    """What stands before the numbers of the points: their columns in order, and what they mean.

    Attributes
    ----------
    count, of : points that follow, and those that they stand for.
    arrays : names of the columns of `count` numbers each.
    groups : names of the colours.
    refitted : whether the preview is the refit.
    y_factor : of what is drawn over the residual that a brush is in.
    """

    count: int
    of: int
    arrays: tuple[str, ...]
    groups: tuple[str, ...]
    refitted: bool
    x_label: str
    y_label: str
    y_factor: float
    output_label: str

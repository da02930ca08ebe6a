"""A session: the tree of models that grows from one result, those that are open, and the changes that are asked for.

All that is done to results goes through the functions behind the commands; the session keeps which command does the
same.  Windows receive one record, which counts its changes.
"""

import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from glob import escape
from pathlib import Path
from tempfile import TemporaryDirectory

from imubayes.api import export, fit
from imubayes.display.loop.change_report import change_lines
from imubayes.display.numbers_and_labels import command_line
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError, input_error, kept_if_possible
from imubayes.foundations.files import remove_abandoned
from imubayes.foundations.progress import Tell
from imubayes.loop.model_history import Tree
from imubayes.results.change_records import ModelChange
from imubayes.results.folder_files import MANIFEST, MODEL
from imubayes.results.history_tree import campaign_of, read_tree, select, shown_place
from imubayes.results.result import Result, read_result
from imubayes.results.stored_tables import read_summary_and_residuals
from imubayes_explorer.calibration import CalibrationFacts, calibration_facts
from imubayes_explorer.changes import Change, change_of, folder_for
from imubayes_explorer.kept_session import KeptSession, ModelNote
from imubayes_explorer.messages import (
    ChangeWanted,
    LockWanted,
    ModelWanted,
    NoteWanted,
    OpenState,
    PointsWanted,
    PreviewFacts,
    PreviewWanted,
    QuantitiesWanted,
)
from imubayes_explorer.narrowing import NarrowingRuns, RankedRuns
from imubayes_explorer.open_model import OpenModel, Stamp, opened, ready, shown, stamp_of, told, weighed
from imubayes_explorer.point_table import PointTable
from imubayes_explorer.refit_ahead import Ahead
from imubayes_explorer.selection_text import fitted_text
from imubayes_explorer.session_state import SessionState, id_of, marks_of, tree_lines
from imubayes_explorer.worker import TaskOutcome, Worker

_MOST_OPEN = 4


class Session:
    """One tree of models, from its first result on.

    Parameters
    ----------
    root : folder of the first result.
    """

    def __init__(self, root: Path):
        self.root, self._version = root, 0
        for folder in root.resolve().parent.glob(f"{escape(root.name)}-*/"):
            remove_abandoned(folder)
        self._lock, self._listeners = threading.RLock(), list[Callable[[], None]]()
        self._open, self._kept = dict[str, OpenModel](), KeptSession.read(root)
        self._read: tuple[Tree | None, Stamp] = None, frozenset()
        self._looked = dict[str, tuple[Stamp, bool]]()
        self._refits, self._narrowing = threading.Lock(), RankedRuns()
        self._change: tuple[int, Change | None] = 0, None
        self.worker, self.closed = Worker(self.changed), False

    def close(self) -> None:
        """End the news of every window, and cancel the running task."""
        self.closed = True
        for each in self.worker.tasks:
            self.worker.cancel(each.number)
        self.changed()

    # ---- what windows receive ----

    def changed(self) -> None:
        """Count a change, and notify every window."""
        with self._lock:
            self._version += 1
            listeners = list(self._listeners)
        for listener in listeners:
            listener()

    def listen(self, listener: Callable[[], None]) -> Callable[[], None]:
        """Call a function at every change; return what ends that."""
        with self._lock:
            self._listeners.append(listener)
        return lambda: self._listeners.remove(listener)

    def state(self) -> SessionState:
        """Return what every window shows alike."""
        return SessionState(
            version=self._version, tree=tree_lines(self.tree(), self._kept.notes),
            opened=tuple(map(self._open_state, self.open_models)),
            tasks=self.worker.tasks, commands=self._kept.commands, locks=dict(self._kept.locks),
        )  # fmt: skip

    def _open_state(self, model: OpenModel) -> OpenState:
        """Return how far a model is open; its folder is looked into if its manifest has changed."""
        now, (marks, replaced) = stamp_of([model.folder / MANIFEST]), self._looked.get(model.id, (None, False))
        if now != marks:
            replaced = model.replaced()
            self._looked[model.id] = now, replaced
        so_far = model.so_far if model.stage == "read" else None
        return OpenState(
            id=model.id, stage=model.stage, identity=model.result.identity, replaced=replaced, so_far=so_far
        )

    def tree(self) -> Tree | None:
        """Return the tree of models; None before there is a first one.

        It is read again if a manifest beside one of its models has changed.
        """
        kept, marks = self._read
        now = marks_of(self.root, kept)
        if now != marks or kept is None:
            # The marks are those from before: what comes while it is read is read the next time.
            kept = read_tree([self.root]) if (self.root / MANIFEST).is_file() else None
            self._read = kept, now
        return kept

    # ---- models ----

    def place_of(self, model: str) -> Path:
        """Return the folder of a model of the tree; raises InputError if it has none of this id."""
        tree = self.tree()
        for place in tree.nodes if tree is not None else ():
            if id_of(place) == model:
                return Path(place)
        raise input_error("there is no such model in this session", f"model {model[:40]!r}", "a model of the tree",
                          "choose one of the tree")  # fmt: skip

    def get(self, model: str) -> OpenModel | None:
        """Return a model that is open; None of one that is not: it is opened then."""
        with self._lock:
            if model in self._open:
                self._open[model] = self._open.pop(model)
                return self._open[model]
            # The first fit opens its result itself; until then there is no other model.
            at_work = [(each.kind, each.of) for each in self.worker.tasks if each.at_work]
            if ("fit", "") not in at_work and ("open", model) not in at_work:
                folder = self.place_of(model)
                self.worker.submit(
                    "open", f"open {folder.name}", model, lambda tell: self._opened(read_result(folder), tell)
                )
            return None

    @property
    def open_models(self) -> tuple[OpenModel, ...]:
        """The models that are open."""
        with self._lock:
            return tuple(self._open.values())

    @property
    def ready_models(self) -> tuple[OpenModel, ...]:
        """The models whose explanations are weighed."""
        return tuple(each for each in self.open_models if each.stage == "ready")

    def require(self, model: str) -> OpenModel:
        """Return a model that is open; raises InputError of one that is not yet."""
        found = self.get(model)
        if found is None:
            raise input_error("this model is still being opened", f"model {model[:40]!r}", "a model that is open",
                              "wait until it is open")  # fmt: skip
        return found

    def reload(self, model: str) -> None:
        """Open a model anew, by what its folder holds now."""
        with self._lock:
            self._open.pop(model, None)
        self.get(model)
        self.changed()

    def _opened(self, result: Result, tell: Tell, lines: tuple[str, ...] = ()) -> TaskOutcome:
        """Hold a result in memory, its readings first, then diagnosed; the one that was used least goes."""
        assert result.folder is not None
        name = id_of(str(result.folder.resolve()))
        found = opened(name, result, tell)
        self._hold(found)
        self.worker.say(lines, name)  # shown at once, while its explanations are weighed
        explained = weighed(found, tell, lambda so_far: self._hold(replace(found, so_far=so_far)))
        diagnosed = told(found, explained)
        self._hold(diagnosed)
        self.keep(command_line("diagnose", found.place))
        self._hold(ready(diagnosed, explained, tell))
        return TaskOutcome(name, lines)

    def _hold(self, model: OpenModel) -> None:
        with self._lock:
            self._open[model.id] = model
            self._looked.pop(model.id, None)
            while len(self._open) > _MOST_OPEN:
                del self._open[next(iter(self._open))]
        self.changed()

    def begin(self, result: Result | None = None) -> None:
        """Open the selected model of the tree, or a result that is in memory."""
        if result is not None:
            name = id_of(str(self.root))
            self.worker.submit("open", f"open {self.root.name}", name, lambda tell: self._opened(result, tell))
            return
        tree = self.tree()
        if tree is not None:
            self.get(id_of((tree.selected or tree.roots)[0]))

    def fit(self, campaign: Campaign | Path, model: Path) -> None:
        """Fit a campaign as the first model; no command does that with one that is in no folder."""
        given = isinstance(campaign, Path)
        words = "fit", str(campaign), "--model", str(model), "--out", str(self.root), "--no-sample"

        def work(tell: Tell) -> TaskOutcome:
            result = fit(campaign, model, self.root, sample=False, progress=tell)
            if given:
                self.keep(command_line(*words))
            self.worker.say((fitted_text(shown_place(str(self.root.resolve()))),))
            return self._opened(result, tell)

        self.worker.submit("fit", f"fit {campaign.name}", "", work)

    def previewed(self, wanted: PreviewWanted) -> PreviewFacts:
        """Return what causes would do together, with the command that adds them, or what a change does."""
        found, (ahead, what) = self.require(wanted.model), self._ahead_of(wanted)
        out = folder_for(found, wanted.effects[0]) if wanted.effects else found.folder
        facts = found.preview(wanted.effects, shown(out), ahead, what, self._table_of(found, ahead))
        return facts.model_copy(update={"task": wanted.task})

    def calibration(self, wanted: ModelWanted) -> CalibrationFacts:
        """Return the estimates of a model, beside those of the one that it was made from if that is at hand."""
        return self.calibration_of(self.require(wanted.model))

    def calibration_of(self, found: OpenModel) -> CalibrationFacts:
        """Return the same of a model that is open."""
        tree = self.tree()
        place = str(found.folder.resolve())
        parent = tree.parents.get(place) if tree is not None else None
        before = None
        if tree is not None and parent:
            with suppress(InputError):
                before = read_summary_and_residuals(Path(parent))[0]
        return calibration_facts(found.result.summary, before, tree.nodes[parent].title if tree and parent else "")

    def narrowing(self, wanted: QuantitiesWanted) -> NarrowingRuns | None:
        """Return the runs that would narrow quantities most; None before they are ranked, which is a task."""
        result = self.require(wanted.model).result
        found = self._narrowing.of(result, wanted.names)

        def work(tell: Tell) -> TaskOutcome:
            tell("expected standard deviation after each candidate run")
            self._narrowing.rank(result, wanted.names)
            return TaskOutcome("")

        if found is None and not any(each.kind == "runs" and each.at_work for each in self.worker.tasks):
            self.worker.submit("runs", "rank the next runs", wanted.model, work)
        return found

    def frame(self, wanted: PointsWanted) -> bytes:
        """Return the points of a view as bytes (see `PointTable.frame`)."""
        found, (ahead, _) = self.require(wanted.model), self._ahead_of(wanted)
        if ahead is None and wanted.effects:
            return found.table.frame(wanted, found.with_causes(wanted.effects))
        return self._table_of(found, ahead).frame(wanted, ahead, refitted=ahead is not None)

    def _table_of(self, model: OpenModel, ahead: Ahead | None) -> PointTable:
        """Return the table with the readings of a change: those of another model if some are taken back."""
        others = (each.table for each in self.open_models if ahead and each.readings.fit.model is ahead.point.model)
        return next(others, model.table)

    def _ahead_of(self, wanted: PreviewWanted | PointsWanted) -> tuple[Ahead | None, str]:
        """Return the refit of a change that is at work, and its name; made once, by whoever asks first."""
        number, change = self._change
        if not wanted.task or number != wanted.task or change is None:
            return None, ""
        with self._refits:
            return change.ahead, change.what

    # ---- changes ----

    def keep(self, command: str, *, again: bool = False) -> None:
        """Keep the command of what was done; see `KeptSession.with_command`."""
        self._keep(lambda kept: kept.with_command(command, again=again))

    def _keep(self, changed: Callable[[KeptSession], KeptSession]) -> None:
        """Keep a change; it stays with the session if there is no right to write, or no room."""
        with self._lock, kept_if_possible(self.root.parent):
            self._kept = changed(self._kept)
            self._kept.write(self.root)
        self.changed()

    def change(self, wanted: ChangeWanted) -> int:
        """Add or remove effects, and fit again; return the number of the task.

        Raises
        ------
        InputError
            if a change is at work already, the campaign is no longer what was fitted, or nothing is named.
        """
        model = self.require(wanted.model)
        self._refuse_changed_campaign(model)
        locked = [name for name, lock in self._kept.locks.items() if lock == "in"]
        change = change_of(model, wanted, locked, self.ready_models)

        def work(tell: Tell) -> TaskOutcome:
            tell("new residuals")
            with self._refits:
                _ = change.ahead  # shown while the fit is made
            return self._after(change.written(tell), change.command, tell)

        with self._lock:  # two windows may ask at once
            if any(each.kind == "change" and each.at_work for each in self.worker.tasks):
                raise input_error("another change is running", "this session", "one change at a time",
                                  "wait for it, or cancel it")  # fmt: skip
            number = self.worker.submit("change", change.what, model.id, work, change.adding)
            self._change = number, change
            return number

    def _after(self, change: ModelChange, command: str, tell: Tell) -> TaskOutcome:
        self.keep(command)
        lines = tuple(change_lines(change))
        self.worker.say(lines)
        return self._opened(change.result, tell, lines) if change.taken else TaskOutcome("", lines)

    def _refuse_changed_campaign(self, model: OpenModel) -> None:
        if model.campaign_changed() and campaign_of(model.folder) is None:
            raise input_error(
                "the campaign is no longer the one that was fitted",
                model.readings.fit.model.campaign.folder or "campaign",
                "the files exactly as they were fitted",
                f"restore them, or fit the campaign as it is now: "
                f"{command_line('explore', 'CAMPAIGN', '--model', str(model.folder / MODEL))}",
            )  # fmt: skip

    def select(self, model: str) -> None:
        """Make a model the selected one: the one that is exported."""
        folder = self.place_of(model)
        select(folder)
        self.keep(command_line("history", "--select", shown(folder)), again=True)

    def note(self, wanted: NoteWanted) -> None:
        """Keep a name and a note of a model."""
        folder, note = self.place_of(wanted.model).name, ModelNote(name=wanted.name, note=wanted.note)
        self._keep(lambda kept: kept.with_note(folder, note))

    def lock(self, wanted: LockWanted) -> None:
        """Lock an effect in or out, or free it."""
        self._keep(lambda kept: kept.with_lock(wanted.effect, wanted.lock))

    @property
    def left_out(self) -> tuple[str, ...]:
        """Effects that are locked out."""
        return tuple(name for name, lock in self._kept.locks.items() if lock == "out")

    def script(self) -> str:
        """Return a shell script that does what was clicked."""
        return self._kept.script()

    def exported(self) -> str:
        """Return the text of the selected model.

        Raises
        ------
        InputError
            if it needs effect files, which a single file cannot hold.
        """
        with TemporaryDirectory() as scratch:
            file = Path(scratch) / MODEL
            export(self.root, file)
            others = sorted(each.name for each in Path(scratch).iterdir() if each != file)
            if others:
                raise input_error(
                    f"the selected model also needs {', '.join(others)}", "export", "a model in one file",
                    f"run: {command_line('history', shown(self.root), '--export', 'model.toml')}",
                )  # fmt: skip
            return file.read_text(encoding="utf-8")

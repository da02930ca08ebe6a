"""The run that would narrow a quantity most, of the quantities that were asked about."""

import threading
from collections.abc import Sequence

from imubayes.display.fit_quality_tables import next_run_sheet
from imubayes.foundations.records import Record
from imubayes.results.result import Result
from imubayes.results.summary import NextRun
from imubayes_explorer.messages import ShownTable, shown_table


class NarrowingRuns(Record):
    """The runs that would narrow chosen quantities most, and the names of those that no candidate run narrows."""

    table: ShownTable
    none_for: tuple[str, ...]


class RankedRuns:
    """The runs that have been ranked, by the result and its quantities; None for a quantity that no run narrows."""

    def __init__(self) -> None:
        self._known, self._lock = dict[tuple[str, str], NextRun | None](), threading.Lock()

    def rank(self, result: Result, names: Sequence[str]) -> None:
        """Rank the runs for quantities of a result; the first time programs compile for some seconds."""
        best = {line.quantity: line for line in result.next_runs(names)}
        with self._lock:
            self._known |= {(result.identity, name): best.get(name) for name in names}

    def of(self, result: Result, names: Sequence[str]) -> NarrowingRuns | None:
        """Return the runs for quantities of a result in words; None before they are ranked."""
        with self._lock:
            if not all((result.identity, name) in self._known for name in names):
                return None
            best = {name: self._known[result.identity, name] for name in names}
        found = sorted(filter(None, best.values()), key=lambda line: str(line.run))
        sheet = next_run_sheet(result.summary.model_copy(update={"next_runs": tuple(found)}))
        return NarrowingRuns(
            table=shown_table(sheet), none_for=tuple(name for name, line in best.items() if line is None)
        )

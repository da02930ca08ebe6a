"""The one thread that fits and diagnoses: one task after the other, each with its progress, and stopped between steps.

JAX works in this thread alone, so that the page is answered meanwhile.  A task that is cancelled ends at its next step;
results are written as a whole at the end, so that nothing of it is left.
"""

import queue
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Literal

from imubayes.foundations.errors import InputError, Issue
from imubayes.foundations.progress import Tell
from imubayes.foundations.records import Record

TaskState = Literal["waiting", "running", "cancelling", "done", "failed", "cancelled"]
TaskKind = Literal["open", "fit", "change", "runs"]
_AT_WORK: tuple[TaskState, ...] = ("waiting", "running", "cancelling")
_TOLD_EVERY, _ENDED_TOLD = 0.1, 8


class CancelledError(Exception):
    """The task was cancelled."""


class TaskProgress(Record):
    """A task, as the page shows it.

    Attributes
    ----------
    what : of it, in words; `step` is what goes on.
    of, made : model that it starts from, and that it has made or opened; empty for none.
    adding : effects that a change adds, whose linear prediction is shown if there is no refit ahead.
    seconds : since it began.
    issues : why it failed, as text in four parts.
    lines : what a change brought, in words.
    """

    number: int
    kind: TaskKind
    what: str
    state: TaskState = "waiting"
    step: str = ""
    seconds: float = 0.0
    of: str = ""
    adding: tuple[str, ...] = ()
    made: str = ""
    issues: tuple[str, ...] = ()
    lines: tuple[str, ...] = ()

    @property
    def at_work(self) -> bool:
        """Whether it waits or runs."""
        return self.state in _AT_WORK


@dataclass(frozen=True)
class TaskOutcome:
    """The model that a task has made or opened, and what is said of it."""

    made: str
    lines: tuple[str, ...] = ()


Work = Callable[[Tell], TaskOutcome]


class Worker:
    """Runs tasks one after the other; `changed` is called after every step."""

    def __init__(self, changed: Callable[[], None]):
        self._changed, self._queue = changed, queue.Queue[tuple[int, Work] | None]()
        self._lock, self._tasks = threading.Lock(), dict[int, TaskProgress]()
        self._thread = threading.Thread(target=self._run, name="explore-worker", daemon=True)
        self._thread.start()

    @property
    def tasks(self) -> tuple[TaskProgress, ...]:
        """The tasks that wait or run, and the last that ended."""
        with self._lock:
            every = list(self._tasks.values())
        return tuple(each for n, each in enumerate(every, 1) if each.at_work or n > len(every) - _ENDED_TOLD)

    @property
    def busy(self) -> bool:
        """Whether a task waits or runs."""
        return any(each.at_work for each in self.tasks)

    def submit(self, kind: TaskKind, what: str, of: str, work: Work, adding: tuple[str, ...] = ()) -> int:
        """Queue a task about a model; return its number."""
        with self._lock:
            number = 1 + max(self._tasks, default=0)
            self._tasks[number] = TaskProgress(number=number, kind=kind, what=what, of=of, adding=adding)
        self._queue.put((number, work))
        self._changed()
        return number

    def cancel(self, number: int) -> None:
        """Stop a task at its next step; one that has ended stays as it is."""
        self._update(number, ("waiting", "running"), state="cancelling")

    def stop(self, patience: float) -> bool:
        """Cancel every task, and wait for the one at work to end at its next step; return whether all has ended.

        Parameters
        ----------
        patience : seconds.  The interpreter must not end while a compiled program runs in the thread.
        """
        for each in self.tasks:
            self.cancel(each.number)
        self._queue.put(None)
        self._thread.join(patience)
        return not self._thread.is_alive()

    def say(self, lines: tuple[str, ...], made: str = "") -> None:
        """Report what the task at work has brought so far: it is there, even if the task is being cancelled."""
        for each in self.tasks:
            if each.step:
                self._update(each.number, ("running", "cancelling"), lines=lines, made=made)

    def _update(self, number: int, where: Sequence[TaskState] = _AT_WORK, /, **changes: object) -> None:
        """Change a task that is in one of some states."""
        with self._lock:
            if number not in self._tasks or self._tasks[number].state not in where:
                return
            self._tasks[number] = self._tasks[number].model_copy(update=changes)
        self._changed()

    def _run(self) -> None:
        while (queued := self._queue.get()) is not None:
            number, work = queued
            began = time.monotonic()

            def tell(text: str, number: int = number, began: float = began) -> None:
                task, seconds = self._tasks[number], time.monotonic() - began
                if task.state == "cancelling":
                    raise CancelledError
                if text != task.step or seconds - task.seconds > _TOLD_EVERY:
                    # One that is cancelled at this moment stays so, and ends at its next step.
                    self._update(number, ("waiting", "running"), state="running", step=text, seconds=seconds)

            self._update(number, **self._ended(work, tell), seconds=time.monotonic() - began)

    def _ended(self, work: Work, tell: Tell) -> dict[str, object]:
        """Return what became of a task."""
        try:
            tell("starting")
            outcome = work(tell)
        except CancelledError:
            return {"state": "cancelled"}
        except InputError as error:
            return {"state": "failed", "issues": tuple(map(str, error.issues))}
        except Exception as error:  # the page reports it, and goes on
            said = f"internal error: {type(error).__name__}: {error}"
            issue = Issue(said, "inside imubayes", "", "run the command that the page shows, and report its output")
            return {"state": "failed", "issues": (str(issue),)}
        return {"state": "done", "made": outcome.made, "lines": outcome.lines}

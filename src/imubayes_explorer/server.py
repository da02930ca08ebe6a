"""The server of the page: what a window may ask, and the state that it receives as it changes.

Linear algebra is answered at once, by threads; what fits or diagnoses is queued for the session's worker, and reported
by server-sent events.  Faults of a request are answered in the four parts of an input error.
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import suppress
from importlib.resources import files

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from imubayes.foundations.errors import InputError, Issue
from imubayes.foundations.records import Record
from imubayes_explorer import messages
from imubayes_explorer.corner import corner_facts
from imubayes_explorer.guard import Application, Guard
from imubayes_explorer.knowledge import known_tables
from imubayes_explorer.point_facts import point_facts
from imubayes_explorer.saved_page import saved_page
from imubayes_explorer.session import Session

_TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css", "txt": "text/plain", "svg": "image/svg+xml"}
_LOOKED, _ALIVE = 2.0, 5
"""Seconds after which the folders are looked at again, and looks without news after which a stream says that the server
is there."""
_STILL_HERE = ": still here\n\n"
_LATER = Response(status_code=202)
"""The answer comes with a task: it is asked for again when that is done."""


class Faults(Record):
    """Why a request could not be answered; each fault as text in four parts."""

    issues: tuple[str, ...]


class Begun(Record):
    """The number of a task that was begun."""

    task: int


def page_files() -> dict[str, tuple[bytes, str]]:
    """Return the files of the page: name → content and media type."""
    found = {}
    for place in (files("imubayes_explorer").joinpath("page"), files("imubayes_explorer").joinpath("page", "vendor")):
        for each in place.iterdir():
            kind = _TYPES.get(each.name.rpartition(".")[2])
            if each.is_file() and kind is not None:
                found[each.name] = (each.read_bytes(), f"{kind}; charset=utf-8")
    return found


def application(session: Session, token: str, port: int) -> Application:
    """Return the server of a session as an ASGI application."""
    return Guard(Starlette(routes=_Answers(session).routes()), token, port)


Said = Record | bytes | str | Response


def _response(said: Said) -> Response:
    if isinstance(said, Record):
        return Response(said.model_dump_json(), media_type="application/json")
    if isinstance(said, bytes):
        return Response(said, media_type="application/octet-stream")
    return PlainTextResponse(said) if isinstance(said, str) else said


def _answered(
    answer: Callable[..., Said], kind: type[Record] | None = None
) -> Callable[[Request], Awaitable[Response]]:
    """Return the handler of a request of a kind, or of one that says nothing further, answered in a thread."""

    async def handle(request: Request) -> Response:
        try:
            wanted = () if kind is None else (kind.model_validate_json(await request.body()),)
            return _response(await run_in_threadpool(answer, *wanted))
        except InputError as error:
            issues = error.issues
        except ValidationError as error:
            issues = [Issue(each["msg"], ".".join(map(str, each["loc"])) or "request", "", "correct the request")
                      for each in error.errors(include_input=False)]  # fmt: skip
        faults = Faults(issues=tuple(map(str, issues)))
        return Response(faults.model_dump_json(), 400, media_type="application/json")

    return handle


class _Answers:
    """What is answered about a session."""

    def __init__(self, session: Session):
        self.session, self.files = session, page_files()

    def routes(self) -> list[Route]:
        session, require = self.session, self.session.require
        asked: dict[str, tuple[type[Record], Callable[..., Said]]] = {
            "model": (messages.ModelWanted, self.model),
            "points": (messages.PointsWanted, session.frame),
            "selection": (messages.SelectionWanted, lambda w: require(w.model).select(w.brushes, session.left_out)),
            "preview": (messages.PreviewWanted, session.previewed),
            "formula": (messages.FormulaWanted, lambda w: require(w.model).formula(w.channel, w.drawn)),
            "known": (messages.ModelWanted, lambda w: known_tables(require(w.model).result)),
            "estimates": (messages.ModelWanted, session.calibration),
            "point": (messages.PointWanted, lambda w: point_facts(require(w.model).table, w.entry)),
            "corner": (messages.QuantitiesWanted, lambda w: corner_facts(require(w.model).result, w.names)),
            "runs": (messages.QuantitiesWanted, lambda w: session.narrowing(w) or _LATER),
            "change": (messages.ChangeWanted, lambda w: Begun(task=session.change(w))),
            "reload": (messages.ModelWanted, self._done(lambda w: session.reload(w.model))),
            "select": (messages.ModelWanted, self._done(lambda w: session.select(w.model))),
            "note": (messages.NoteWanted, self._done(session.note)),
            "lock": (messages.LockWanted, self._done(session.lock)),
            "cancel": (Begun, self._done(lambda w: session.worker.cancel(w.task))),
        }
        given: dict[str, Callable[[], Said]] = {
            "state": session.state, "script.sh": session.script, "model.toml": session.exported,
            "session.html": lambda: saved_page(
                session.state(), [(each, session.calibration_of(each)) for each in session.open_models], self.files
            ),
        }  # fmt: skip
        return [
            *(Route(f"/{name}", _answered(act, kind), methods=["POST"]) for name, (kind, act) in asked.items()),
            *(Route(f"/{name}", _answered(act)) for name, act in given.items()),
            Route("/events", self.events),
            Route("/", self.file),
            Route("/page/{name}", self.file),
        ]

    async def file(self, request: Request) -> Response:
        content, kind = self.files.get(request.path_params.get("name", "index.html"), (b"", ""))
        return Response(content, media_type=kind) if kind else PlainTextResponse("there is no such file\n", 404)

    async def events(self, request: Request) -> Response:
        return StreamingResponse(self._states(request), media_type="text/event-stream")

    async def _states(self, request: Request) -> AsyncIterator[str]:
        """Yield the state of the session, and again whenever it changes; a tree that is damaged is looked at again."""
        loop, news, told_last, looks = asyncio.get_running_loop(), asyncio.Event(), None, 0

        def told() -> None:
            loop.call_soon_threadsafe(news.set)

        end = self.session.listen(told)
        try:
            while not self.session.closed and not await request.is_disconnected():
                news.clear()
                try:
                    state = await run_in_threadpool(self.session.state)
                    if state != told_last:
                        yield f"data: {state.model_dump_json()}\n\n"
                        told_last, looks = state, 0
                except InputError:
                    yield _STILL_HERE
                looks += 1
                if looks % _ALIVE == 0:
                    yield _STILL_HERE
                with suppress(TimeoutError):
                    async with asyncio.timeout(_LOOKED):
                        await news.wait()
        finally:
            end()

    # ---- what is asked ----

    def model(self, wanted: messages.ModelWanted) -> Said:
        found = self.session.get(wanted.model)
        return _LATER if found is None else found.facts()

    def _done(self, act: Callable[..., None]) -> Callable[[Record], Said]:
        """Return what does something and answers with the state after it."""

        def answer(wanted: Record) -> Said:
            act(wanted)
            return self.session.state()

        return answer

"""The server of the page: what a window may ask, and the state that it is told of as it changes.

Linear algebra is answered at once, by threads; what fits or diagnoses is queued for the session's worker, and told by
server-sent events.  Faults of a request are answered in the four parts of an input error.
"""

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from importlib.resources import files

from pydantic import ValidationError
from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route

from imubayes.explorer.guard import Application, Guard
from imubayes.explorer.knowledge import known_tables, quantity_facts
from imubayes.explorer.messages import (
    ChangeWanted,
    FormulaWanted,
    LockWanted,
    ModelWanted,
    NoteWanted,
    PointsWanted,
    PreviewWanted,
    QuantityWanted,
    SelectionWanted,
)
from imubayes.explorer.saved_page import saved_page
from imubayes.explorer.session import Session
from imubayes.foundations.errors import InputError, Issue
from imubayes.foundations.records import Record

_TYPES = {"html": "text/html", "js": "text/javascript", "css": "text/css", "txt": "text/plain", "svg": "image/svg+xml"}
_ALIVE = 10.0
"""Seconds after which a stream without news says that the server is there."""
_STILL_HERE = ": still here\n\n"


class Faults(Record):
    """Why a request could not be answered; each fault as text in four parts."""

    issues: tuple[str, ...]


class Begun(Record):
    """The number of a task that was begun."""

    task: int


def page_files() -> dict[str, tuple[bytes, str]]:
    """Return the files of the page: name → content and media type."""
    found = {}
    for place in (files("imubayes.explorer").joinpath("page"), files("imubayes.explorer").joinpath("page", "vendor")):
        for each in place.iterdir():
            kind = _TYPES.get(each.name.rpartition(".")[2])
            if each.is_file() and kind is not None:
                found[each.name] = (each.read_bytes(), f"{kind}; charset=utf-8")
    return found


def application(session: Session, token: str, port: int) -> Application:
    """Return the server of a session as an ASGI application."""
    return Guard(Starlette(routes=_Answers(session).routes()), token, port)


def _json(record: Record, status: int = 200) -> Response:
    return Response(record.model_dump_json(), status, media_type="application/json")


def _numbers(content: bytes) -> Response:
    return Response(content, media_type="application/octet-stream")


def _faults(*issues: str) -> Response:
    return _json(Faults(issues=issues), 400)


Answer = Callable[[Request], Awaitable[Response]]


def _asked[Asked: Record](kind: type[Asked], answer: Callable[[Asked], Response]) -> Answer:
    """Return the handler of a request of a kind, answered in a thread."""

    async def handle(request: Request) -> Response:
        try:
            wanted = kind.model_validate_json(await request.body())
            return await run_in_threadpool(answer, wanted)
        except InputError as error:
            return _faults(*map(str, error.issues))
        except ValidationError as error:
            told = [Issue(each["msg"], ".".join(map(str, each["loc"])) or "request", "", "correct the request")
                    for each in error.errors(include_input=False)]  # fmt: skip
            return _faults(*map(str, told))

    return handle


def _given(answer: Callable[[], Response]) -> Answer:
    """Return the handler of a request that says nothing further."""

    async def handle(request: Request) -> Response:
        try:
            return await run_in_threadpool(answer)
        except InputError as error:
            return _faults(*map(str, error.issues))

    return handle


class _Answers:
    """What is answered about a session."""

    def __init__(self, session: Session):
        self.session, self.files = session, page_files()

    def routes(self) -> list[Route]:
        session, require = self.session, self.session.require
        asked: tuple[tuple[str, Answer], ...] = (
            ("model", _asked(ModelWanted, self.model)),
            ("points", _asked(PointsWanted, lambda w: _numbers(session.frame(w)))),
            (
                "selection",
                _asked(SelectionWanted, lambda w: _json(require(w.model).select(w.brushes, session.left_out))),
            ),
            ("preview", _asked(PreviewWanted, lambda w: _json(session.previewed(w)))),
            ("formula", _asked(FormulaWanted, lambda w: _json(require(w.model).formula(w.channel, w.drawn)))),
            ("known", _asked(ModelWanted, lambda w: _json(known_tables(require(w.model).result)))),
            ("quantity", _asked(QuantityWanted, lambda w: _json(quantity_facts(require(w.model).result, w.name)))),
            ("change", _asked(ChangeWanted, lambda w: _json(Begun(task=session.change(w)), 202))),
            ("select", _asked(ModelWanted, self._done(lambda w: session.select(w.model)))),
            ("note", _asked(NoteWanted, self._done(session.note))),
            ("lock", _asked(LockWanted, self._done(session.lock))),
            ("cancel", _asked(Begun, self._done(lambda w: session.worker.cancel(w.task)))),
        )
        given = (
            ("state", _given(lambda: _json(session.state()))),
            ("script.sh", _given(lambda: PlainTextResponse(session.script()))),
            ("session.html", _given(self.saved)),
            ("model.toml", _given(lambda: PlainTextResponse(session.exported()))),
        )
        return [
            *(Route(f"/{name}", handle, methods=["POST"]) for name, handle in asked),
            *(Route(f"/{name}", handle) for name, handle in given),
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
        loop, news = asyncio.get_running_loop(), asyncio.Event()

        def told() -> None:
            loop.call_soon_threadsafe(news.set)

        end = self.session.listen(told)
        try:
            while not await request.is_disconnected():
                news.clear()
                try:
                    state = await run_in_threadpool(self.session.state)
                    yield f"data: {state.model_dump_json()}\n\n"
                except InputError:
                    yield _STILL_HERE
                try:
                    async with asyncio.timeout(_ALIVE):
                        await news.wait()
                except TimeoutError:
                    yield _STILL_HERE
        finally:
            end()

    # ---- what is asked ----

    def model(self, wanted: ModelWanted) -> Response:
        found = self.session.get(wanted.model)
        return Response(status_code=202) if found is None else _json(found.facts())

    def _done[Asked: Record](self, act: Callable[[Asked], None]) -> Callable[[Asked], Response]:
        """Return what does something and answers with the state after it."""

        def answer(wanted: Asked) -> Response:
            act(wanted)
            return _json(self.session.state())

        return answer

    def saved(self) -> Response:
        page = saved_page(self.session.state(), self.session.open_models, self.files)
        return Response(page, media_type="text/plain; charset=utf-8")

"""A page about many units, and the loop of each that is clicked, served beside it."""

import threading
from collections.abc import Callable
from typing import Protocol

from starlette.applications import Starlette
from starlette.concurrency import run_in_threadpool
from starlette.requests import Request
from starlette.responses import HTMLResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import Route

from imubayes.foundations.errors import InputError
from imubayes.results.unit_page import UNIT_LINK, UnitPage, UnitToExplore
from imubayes_explorer.guard import Application, Guard
from imubayes_explorer.served import Served


class HasAddress(Protocol):
    """What is served at an address."""

    address: str


class ServedUnits[Loop: HasAddress](Served):
    """A page of units that is served, with the loops that were opened from it.

    Parameters
    ----------
    page : of the units.
    opened : begins the loop of a unit.
    ended : ends it within some seconds.
    """

    def __init__(
        self, page: UnitPage, opened: Callable[[UnitToExplore], Loop], ended: Callable[[Loop, float], None], port: int
    ):
        self.page, self._opened, self._ended = page, opened, ended
        self.loops, self._lock = dict[str, Loop](), threading.Lock()
        super().__init__(self._application, port)

    def _application(self, token: str, port: int) -> Application:
        routes = [Route("/", self._page), Route(f"/{UNIT_LINK.format('{unit}')}", self._unit)]
        # Pictures have their styles in them; there are no scripts on this page.
        return Guard(Starlette(routes=routes), token, port, b"'unsafe-inline'")

    async def _page(self, request: Request) -> Response:
        return HTMLResponse(self.page.html)

    async def _unit(self, request: Request) -> Response:
        """Open the loop of a unit once, and lead to it."""
        unit = request.path_params["unit"]
        if unit not in self.page.units:
            return PlainTextResponse("there is no such unit\n", 404)
        try:
            return RedirectResponse(await run_in_threadpool(self._address, unit), 303)
        except InputError as error:
            return PlainTextResponse("\n".join(map(str, error.issues)) + "\n", 400)

    def _address(self, unit: str) -> str:
        with self._lock:
            if unit not in self.loops:
                self.loops[unit] = self._opened(self.page.units[unit])
            return self.loops[unit].address

    def stop(self, patience: float) -> None:
        """Stop serving, and end what is at work in each loop at its next step, within some seconds each."""
        self.end()
        for each in self.loops.values():
            self._ended(each, patience)

"""A session begun: from a result, or from a campaign with a model; served on this machine until it is stopped."""

import socket
import threading
import time
import webbrowser
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.compiled.jax_settings import prepare_jax
from imubayes.foundations.errors import input_error
from imubayes.foundations.shipped_examples import example, shipped
from imubayes.model.model_file import read_model
from imubayes.results.folder_files import MANIFEST, checked
from imubayes.results.result import Result
from imubayes_explorer.session import Session

# Without the extra the name of the function is still public: `explore` refuses when it is called.
_MISSING = next((name for name in ("starlette", "uvicorn") if find_spec(name) is None), "")
if TYPE_CHECKING or not _MISSING:
    import uvicorn

    from imubayes_explorer.guard import HOST, new_token
    from imubayes_explorer.server import application

_PATIENCE, _STEP = 10.0, 120.0
"""Seconds in which the server starts or ends, and that a step of the work may take, such as a program that compiles."""
SHIPPED = "hidden-gyro"
"""The example that is explored where nothing is named: an effect is hidden in it."""


class Exploration:
    """A session that is served.

    Attributes
    ----------
    address : of its page; the token in it is the key.
    session : what is explored.
    """

    def __init__(self, session: Session, port: int = 0):
        # Bound before anything is said: the port of the address is this server's own.
        try:
            bound = socket.create_server((HOST, port))
        except (OSError, OverflowError) as error:
            raise input_error(f"the port cannot be opened: "
                              f"{getattr(error, 'strerror', None) or error}", f"--port {port}",
                              "a free port, or 0 for any", "choose another one") from error  # fmt: skip
        token, self.session = new_token(), session
        self.address = f"http://{HOST}:{bound.getsockname()[1]}/{token}/"
        served = application(session, token, bound.getsockname()[1])
        # Given by a factory, which uvicorn need not tell from an application.
        settings = uvicorn.Config(
            lambda: served, factory=True, interface="asgi3", ws="none", lifespan="off", proxy_headers=False,
            server_header=False, log_level="warning", access_log=False, timeout_graceful_shutdown=1,
        )  # fmt: skip
        self._server = uvicorn.Server(settings)
        self._thread = threading.Thread(target=self._server.run, args=([bound],), name="explore-server", daemon=True)

    def start(self) -> "Exploration":
        """Serve in a thread; return itself once the page is there."""
        self._thread.start()
        until = time.monotonic() + _PATIENCE
        while not self._server.started and time.monotonic() < until:
            time.sleep(0.01)
        return self

    def wait(self) -> None:
        """Serve until the process is interrupted."""
        while self._thread.is_alive():
            self._thread.join(0.5)

    def stop(self, patience: float = _STEP) -> None:
        """Stop serving, and end what is at work at its next step; what was accepted is in its folders.

        Parameters
        ----------
        patience : seconds that the step at work may take; a longer one goes on to its end.
        """
        self.session.close()
        self._server.should_exit = True
        self._thread.join(_PATIENCE)
        self.session.worker.stop(patience)

    def __repr__(self) -> str:
        return f"<Exploration of {self.session.root} at {self.address}>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{escape(self.address)}" width="100%" height="820" title="imubayes explore"></iframe>'


def explore(
    place: Result | str | Path | None = None, model: str | Path | None = None, out: str | Path | None = None,
    *, port: int = 0, browser: bool = False,
) -> Exploration:  # fmt: skip
    """Serve the loop on a page of this machine: where the model fails, what would explain it, what adding it brings.

    In a notebook the returned object shows the page in a frame; elsewhere its `address` is opened in a browser.

    Parameters
    ----------
    place : a result, its folder, or the folder of a campaign; the example `hidden-gyro` where None.
    model : model file to fit a campaign with, or the name of a shipped one.
    out : result folder of that fit; by default results/CAMPAIGN-MODEL, which is opened where it is there already.
    port : of the server; any free one where 0.
    browser : whether to open the page in the browser.

    Raises
    ------
    InputError
        if `imubayes[explore]` is not installed, for a place that is neither, a result without a folder, and a port that
        is taken.

    Examples
    --------
    >>> import imubayes
    >>> page = imubayes.explore("results/accel-channel")
    >>> page.address.startswith("http://127.0.0.1:")
    True
    >>> page.stop()
    """
    if _MISSING:
        raise input_error(
            f"{_MISSING} is not installed", "imubayes explore", "the packages of imubayes[explore]",
            "install them: pip install 'imubayes[explore]'",
        )  # fmt: skip
    prepare_jax("explore")
    if place is None and model is None:
        chosen = example(SHIPPED)
        place, model = shipped(chosen.data), shipped(chosen.model)
    begun = _of_result(place) if isinstance(place, Result) else _of_folder(Path(place or "."), model, out)
    found = Exploration(begun, port).start()
    if browser:
        webbrowser.open(found.address)
    return found


def _of_result(result: Result) -> Session:
    if result.folder is None or not result.identity:
        raise input_error("the result has no folder", "explore", "a result that was written: `out` of imubayes.fit",
                          "write it to a folder")  # fmt: skip
    session = Session(result.folder)
    session.begin(result)
    return session


def _of_folder(place: Path, model: str | Path | None, out: str | Path | None) -> Session:
    if (place / CAMPAIGN_FILE).is_file():
        if model is None:
            raise input_error("a campaign needs a model", str(place), "--model FILE",
                              "name the model, or a result folder in place of the campaign")  # fmt: skip
        read_model(model)  # what is wrong with it is told before a page is opened
        root = Path(out) if out is not None else Path("results") / f"{place.resolve().name}-{Path(model).stem}"
        if not (root / MANIFEST).is_file():
            session = Session(root)
            session.fit(place, Path(model))
            return session
        place = root
    checked(place)
    session = Session(place)
    session.begin()
    return session

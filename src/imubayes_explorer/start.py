"""A session begun: from a result, or from a campaign with a model; served on this machine until it is stopped."""

import webbrowser
from html import escape
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING

from imubayes.campaign.campaign_reader import CAMPAIGN_FILE
from imubayes.compiled.jax_settings import prepare_jax
from imubayes.foundations.errors import input_error
from imubayes.foundations.extensions import extensions
from imubayes.foundations.progress import Tell, silent
from imubayes.foundations.shipped_examples import example, shipped
from imubayes.model.model_file import read_model
from imubayes.results.folder_files import FIT, MANIFEST, checked
from imubayes.results.result import Result
from imubayes.results.unit_page import UnitPage, UnitToExplore
from imubayes_explorer.session import Session

# Without the extra the name of the function is still public: `explore` refuses when it is called.
_MISSING = next((name for name in ("starlette", "uvicorn") if find_spec(name) is None), "")
if TYPE_CHECKING or not _MISSING:
    from imubayes_explorer.served import Served
    from imubayes_explorer.server import application
    from imubayes_explorer.unit_server import ServedUnits

_STEP = 120.0
"""Seconds that a step of the work may take, such as a program that compiles."""
SHIPPED = "hidden-gyro"
"""The example that is explored if nothing is named: an effect is hidden in it."""


class Exploration:
    """A session that is served.

    Attributes
    ----------
    address : of its page; the token in it is the key.
    session : what is explored.
    """

    def __init__(self, session: Session, port: int = 0):
        self.session = session
        self._served = Served(lambda token, bound: application(session, token, bound), port)
        self.address = self._served.address

    def start(self) -> "Exploration":
        """Serve in a thread; return itself once the page is there."""
        self._served.begin()
        return self

    def wait(self) -> None:
        """Serve until the process is interrupted."""
        self._served.wait()

    def stop(self, patience: float = _STEP) -> None:
        """Stop serving, and end what is at work at its next step; what was accepted is in its folders.

        Parameters
        ----------
        patience : seconds that the step at work may take; a longer one goes on to its end.
        """
        self.session.close()
        self._served.end()
        self.session.worker.stop(patience)

    def __repr__(self) -> str:
        return f"<Exploration of {self.session.root} at {self.address}>"

    def _repr_html_(self) -> str:
        return f'<iframe src="{escape(self.address)}" width="100%" height="820" title="imubayes explore"></iframe>'


def explore(
    place: Result | str | Path | None = None, model: str | Path | None = None, out: str | Path | None = None,
    *, port: int = 0, browser: bool = False,
) -> Exploration:  # fmt: skip
    """Serve the loop on a page of this machine: residuals, their possible causes, and the improvement by each.

    In a notebook the returned object shows the page in a frame; elsewhere its `address` is opened in a browser.

    Parameters
    ----------
    place : a result, its folder, or the folder of a campaign; the example `hidden-gyro` if None.
    model : model file to fit a campaign with, or the name of a shipped one.
    out : result folder of that fit; by default results/CAMPAIGN-MODEL, which is opened if it exists.
    port : of the server; any free one if 0.
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


def explore_units(
    place: Path, *, port: int = 0, browser: bool = False, progress: Tell = silent
) -> "ServedUnits[Exploration] | None":
    """Serve the page about the fits of many units in a folder, from which the loop of each is opened.

    Parameters
    ----------
    place : the folder.
    port, browser : as of `explore`.
    progress : called with a short text as the page is made.

    Returns
    -------
    served : None if no package has a page about this folder.
    """
    # What has a campaign or a fit is none of them: the packages with pages are not imported for it.
    if _MISSING or (place / CAMPAIGN_FILE).is_file() or (place / FIT).is_file():
        return None
    pages = (entry.load()(place, progress) for entry in extensions("pages").values())
    page: UnitPage | None = next((each for each in pages if each is not None), None)
    if page is None:
        return None
    prepare_jax("explore")
    found = ServedUnits(page, _of_unit, Exploration.stop, port)
    found.begin()
    if browser:
        webbrowser.open(found.address)
    return found


def _of_unit(unit: UnitToExplore) -> Exploration:
    """Return the loop of a unit, its first model fitted if that is not done."""
    campaign = unit.campaign()
    if isinstance(campaign, Path):
        return Exploration(_of_folder(campaign, unit.model, unit.out)).start()
    session = Session(unit.out)
    session.fit(campaign, unit.model)
    return Exploration(session).start()


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
        read_model(model)  # what is wrong with it is reported before a page is opened
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

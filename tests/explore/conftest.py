"""One fitted campaign with a hidden effect, explored: a session that the tests of server and page share."""

from pathlib import Path

import pytest
from explore_client import Client, settled

from imubayes.api import fit
from imubayes.explorer.start import explore

ROOT = Path(__file__).parents[2]


@pytest.fixture(scope="session")
def explored(tmp_path_factory):
    folder = tmp_path_factory.mktemp("explore") / "first result"  # a blank in the name: commands quote it
    result = fit(ROOT / "data" / "hidden-gyro", ROOT / "models" / "hidden-effects.toml", folder, sample=False)
    begun = explore(result)
    settled(begun)
    yield begun
    begun.stop()


@pytest.fixture(scope="session")
def client(explored) -> Client:
    return Client(explored.address)


@pytest.fixture(scope="session")
def first(explored) -> str:
    """The id of the first model."""
    return next(line.id for line in explored.session.state().tree if not line.parent)

"""One fitted campaign with a hidden effect, explored: a session that the tests of server and page share."""

import pytest
from explore_client import Client, settled

from imubayes_explorer.start import explore


@pytest.fixture(scope="session")
def explored(hidden_gyro):
    begun = explore(hidden_gyro)
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

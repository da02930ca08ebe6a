"""The notebook that is shipped runs, and what a notebook shows of each record is its HTML alone."""

from copy import deepcopy
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

ROOT = Path(__file__).parents[2]
NOTEBOOK = nbformat.read(ROOT / "data" / "notebooks" / "loop.ipynb", as_version=4)


@pytest.fixture(scope="module")
def executed(tmp_path_factory, command_environment) -> nbformat.NotebookNode:
    """Run the notebook beside copies of the folders, so that what it writes stays out of the repository."""
    place = tmp_path_factory.mktemp("repository")
    (place / "data" / "notebooks").mkdir(parents=True)
    (place / "data" / "hidden-gyro").symlink_to(ROOT / "data" / "hidden-gyro")
    (place / "models").symlink_to(ROOT / "models")
    resources = {"metadata": {"path": str(place / "data" / "notebooks")}}
    return NotebookClient(deepcopy(NOTEBOOK), timeout=300, resources=resources).execute(env=command_environment)


def outputs(executed: nbformat.NotebookNode, begins: str) -> list:
    cell = next(cell for cell in executed.cells if cell.source.startswith(begins))
    return [output for output in cell.outputs if output.get("data", {}).get("text/plain") != ""]


@pytest.mark.slow  # the loop of the README, which runs at every run, in a process of its own
@pytest.mark.parametrize(
    ("begins", "headline", "within"),
    [
        ("import imubayes", "<Result hidden-gyro", "gyro_scale_factor.scale[gx]"),
        ("found =", "<Diagnosis missing effect: gyro_scale_asymmetry", "gyro_scale_asymmetry is missing"),
        ("addition =", "<ModelChange + gyro_scale_asymmetry", "gyro_scale_asymmetry.asymmetry[gx]"),
    ],
)
def test_a_record_shows_its_html_once_and_nothing_else(executed, begins, headline, within):
    (shown,) = outputs(executed, begins)
    assert shown.output_type == "execute_result"
    assert shown.data["text/plain"].startswith(headline)
    assert "\n" not in shown.data["text/plain"]
    assert within in shown.data["text/html"]


@pytest.mark.slow
def test_nothing_is_written_to_standard_error(executed):
    assert not [
        output for cell in executed.cells for output in cell.get("outputs", ()) if output.get("name") == "stderr"
    ]


def test_the_loop_takes_fifteen_lines():
    code = "\n".join(cell.source for cell in NOTEBOOK.cells if cell.cell_type == "code")
    assert len([line for line in code.splitlines() if line.strip()]) <= 15

"""A campaign read by another process is the one that this process would have read, faults included."""

import pickle
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from imubayes.campaign import Inspection, inspect_campaign
from imubayes.foundations.errors import InputError, Issue

ROOT = Path(__file__).parents[2]
CAMPAIGN = ROOT / "data" / "polar-tumble"
READ = """
import pickle, sys
from pathlib import Path
from imubayes.cli.session import inspecting

if __name__ == "__main__":
    with inspecting(Path(sys.argv[1])) as inspected:
        found = pickle.dumps(inspected())
    Path(sys.argv[2]).write_bytes(found)
"""

# Commands end by os._exit after atexit, which joins every child: one that waits for its next task would never end.
LEFT = """
import sys
from contextlib import suppress
from multiprocessing import active_children
from pathlib import Path
from imubayes.cli.session import inspecting

if __name__ == "__main__":
    with suppress(ZeroDivisionError), inspecting(Path(sys.argv[1])) as inspected:
        {wait}
    print(len(active_children()), "children")
"""


def read_beside(campaign: Path, folder: Path) -> Inspection:
    """Return the inspection as a process without JAX gets it."""
    script, kept = folder / "read.py", folder / "inspection"
    script.write_text(READ, encoding="utf-8")
    subprocess.run([sys.executable, script, campaign, kept], check=True)
    return pickle.loads(kept.read_bytes())


def test_a_campaign_read_beside_is_the_same(tmp_path):
    found, expected = read_beside(CAMPAIGN, tmp_path), inspect_campaign(CAMPAIGN)
    assert found.findings == expected.findings
    assert found.campaign is not None
    assert expected.campaign is not None
    assert [run.name for run in found.campaign.runs] == [run.name for run in expected.campaign.runs]
    for run, same in zip(found.campaign.runs, expected.campaign.runs, strict=True):
        np.testing.assert_array_equal(run.observed, same.observed)


def test_faults_come_back_with_their_four_parts(tmp_path):
    (tmp_path / "empty").mkdir()
    found = read_beside(tmp_path / "empty", tmp_path)
    assert found.campaign is None
    assert found.issues == inspect_campaign(tmp_path / "empty").issues


@pytest.mark.parametrize("waiting", [True, False])
def test_no_child_is_left_when_the_reading_ends_or_is_given_up(tmp_path, waiting):
    script = tmp_path / "left.py"
    script.write_text(LEFT.format(wait="inspected()" if waiting else "1 / 0"), encoding="utf-8")
    told = subprocess.run([sys.executable, script, CAMPAIGN], check=True, capture_output=True, text=True, timeout=60)
    assert told.stdout.strip() == "0 children"


def test_an_input_error_is_pickled_with_its_issues():
    error = InputError([Issue("a", "b", "c", "d"), Issue("e", "f", "", "g")])
    assert pickle.loads(pickle.dumps(error)).issues == error.issues


def test_output_into_a_pipe_and_the_status_survive_the_end(tmp_path):
    command = [sys.executable, "-m", "imubayes.cli.main"]
    told = subprocess.run([*command, "check", CAMPAIGN, "--json"], check=True, capture_output=True, text=True)
    assert told.stdout.rstrip().endswith("}")
    refused = subprocess.run([*command, "check", tmp_path], capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    # On a slow machine a line of progress stands above it.
    assert "\nerror: " in f"\n{refused.stderr}"

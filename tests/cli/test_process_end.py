"""The output of a command at its end, and an error passed to another process, is whole."""

import pickle
import subprocess
import sys
from pathlib import Path

from imubayes.foundations.errors import InputError, Issue

ROOT = Path(__file__).parents[2]
CAMPAIGN = ROOT / "data" / "polar-tumble"


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

"""Without extras every command of `--help` and every public function works, or names the extra in one line.

The environment has what the wheel requires and nothing else (`conftest.alone`).  The functions are called by the
examples of their docstrings.
"""

import json
import re
import shlex
import shutil
from pathlib import Path

import polars as pl
import pytest

from imubayes.cli.main import app
from later_campaign import write_later

pytestmark = pytest.mark.slow  # part of make release-check

ROOT = Path(__file__).parents[2]
FIT = "imubayes fit data/accel-channel --model accel-channel --out results/accel-channel --no-sample"
# Commands in their order, with their exit status.
COMMANDS = {
    "imubayes example accel-channel desk-imu rotation-modulation --out .": 0,
    "imubayes check data/accel-channel --model accel-channel": 0,
    FIT: 0,
    "imubayes fit data/desk-imu --model desk-imu --out results/desk --no-sample": 0,
    "imubayes compare results/accel-channel": 0,
    "imubayes diagnose results/accel-channel": 0,
    "imubayes add accel_cubic --to results/accel-channel --out results/second": 0,
    "imubayes remove accel_cubic --from results/second --out results/third": 0,
    "imubayes refit results/accel-channel --model results/accel-channel/model.toml --out results/fourth": 0,
    "imubayes history results/accel-channel results/second --html history.html": 0,
    "imubayes plant --result results/accel-channel --effects accel_cubic --draws 2": 0,
    "imubayes predict results/accel-channel campaigns/later": 0,
    "imubayes classical data/accel-channel": 0,
    "imubayes effects accel_cubic": 0,
    "imubayes simulate data/plans/accel-channel-example.toml --out campaigns/simulated": 0,
    "imubayes schema campaign": 0,
    "imubayes report results/accel-channel --out report.html report.json": 0,
    "imubayes export results/desk --out constants.json": 0,
    "imubayes mission results/desk --duration-min 1": 0,
    "imubayes apply results/desk desk.csv --out corrected.csv": 0,
    "imubayes new campaigns/new desk.csv --gravity-m-s2 9.81": 0,
    "imubayes convert desk.csv --gravity-m-s2 9.81 --out campaigns/converted": 0,
    "imubayes capture campaigns/captured --from desk.csv --patience 0 --gravity-m-s2 9.81": 0,
    f"imubayes noise {shlex.quote(str(ROOT))}/data/static-record": 0,  # it is not in the wheel
    "imubayes carrier data/rotation-modulation pyramid-forward --out carrier.csv": 0,
    "imubayes archive pack data/accel-channel --out archive": 0,
    "imubayes archive list archive": 0,
    "imubayes archive check archive": 0,
    "imubayes batch archive --model accel-channel --out units": 0,
    "imubayes batch population units": 0,
    "imubayes selftest": 0,
    "imubayes demo --no-sample --out demo": 0,
}
# What needs an extra, and the extra.
REFUSED = {
    "imubayes explore results/accel-channel": "explore",
    "imubayes report results/accel-channel --out report.pdf": "pdf",
    "imubayes batch archive --model accel-channel --out more --workers 2": "cluster",
    "imubayes convert log.ulg --out campaigns/ulog": "recordings",
    "imubayes convert log.tdms --out campaigns/tdms": "recordings",
}
# The examples of all docstrings; what those that failed say is printed.
EXAMPLES = """
import doctest, inspect, json, imubayes
found = {}
for name in imubayes.__all__:
    test = doctest.DocTestParser().get_doctest(inspect.getdoc(getattr(imubayes, name)) or "", {}, name, None, 0)
    said = []
    doctest.DocTestRunner(optionflags=doctest.ELLIPSIS | doctest.NORMALIZE_WHITESPACE).run(test, out=said.append)
    if said:
        found[name] = "".join(said)
print(json.dumps(found))
"""


@pytest.fixture(scope="module")
def place(outside) -> Path:
    """A folder with recordings and a later calibration, where the commands expect them."""
    write_later(ROOT / "data" / "accel-channel", outside / "campaigns" / "later")
    pl.read_parquet(ROOT / "data" / "desk-imu" / "runs" / "tumble.parquet").write_csv(outside / "desk.csv")
    (outside / "log.ulg").write_bytes(b"ULog\x01\x12\x35" + bytes(64))
    (outside / "log.tdms").write_bytes(b"TDSm" + bytes(64))
    return outside


def test_every_command_works_or_names_the_extra_in_one_line(finished, place):
    for command, status in COMMANDS.items():
        done = finished(command)
        assert done.returncode == status, f"{command}\n{done.stdout}\n{done.stderr}"
        assert "Traceback" not in done.stderr, command
    for command, extra in REFUSED.items():
        done = finished(command)
        assert done.returncode == 2, f"{command}\n{done.stdout}\n{done.stderr}"
        remedy = re.findall(r"^  do:  .*$", done.stderr, re.MULTILINE)
        assert len(remedy) == 1, done.stderr
        assert f"imubayes[{extra}]" in remedy[0]
    asked = {command.split()[1] for command in (*COMMANDS, *REFUSED)}
    assert {name for name in app if not name.startswith("-")} <= asked


def test_every_example_of_a_public_name_works_or_names_the_extra(finished, place):
    """`explore` alone needs one.  The examples make arrays in any order: JAX is double from the start."""
    for name in ("data", "models"):
        if not (place / name).exists():
            (place / name).symlink_to(ROOT / name)
    # Commands may have written campaigns and results before.
    for name in ("campaigns", "results"):
        shutil.rmtree(place / name, ignore_errors=True)
    write_later(ROOT / "data" / "accel-channel", place / "campaigns" / "later")
    done = finished(f"{FIT} --replace")
    assert done.returncode == 0, done.stderr
    assert finished(FIT.replace("data/accel-channel", "campaigns/later").replace("accel-channel --no", "later --no"))
    (place / "examples.py").write_text("import os\nos.environ['JAX_ENABLE_X64'] = '1'\n" + EXAMPLES)
    done = finished("python examples.py")
    assert done.returncode == 0, done.stderr
    failed = json.loads(done.stdout.splitlines()[-1])
    assert set(failed) == {"explore"}, "\n".join(failed.values())
    assert "pip install 'imubayes[explore]'" in failed["explore"]
    assert finished("python -c 'from imubayes import *; import arviz'").returncode == 0

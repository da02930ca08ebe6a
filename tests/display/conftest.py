"""Result folders made once, and a comparison of the large one."""

from pathlib import Path

import pytest
import synthetic_results as made

from imubayes.display.compare_report import Comparison, compare


@pytest.fixture(scope="session")
def trihedral(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A sampled result of 21 runs and 6 channels; not to be changed."""
    return made.trihedral_folder(tmp_path_factory.mktemp("results") / "trihedral")


@pytest.fixture(scope="session")
def compared(trihedral: Path) -> Comparison:
    return compare(trihedral, every=True)


@pytest.fixture
def tumble(tmp_path: Path) -> Path:
    """A fit that was not sampled: one run by hand, no table, channels beyond one page."""
    parameters, derived = made.trihedral_quantities()
    parameters = [entry for entry in parameters if entry.name.startswith(("gyro", "accel"))]
    derived = [entry for entry in derived if entry.name.startswith("scale_factor")]
    residuals = made.tumble_residuals()
    summary = made.summary_of(residuals, parameters, derived, sampled=False)
    return made.write_folder(tmp_path / "tumble", residuals, summary)


@pytest.fixture
def single(tmp_path: Path) -> Path:
    """One run of one channel."""
    residuals = made.trihedral_residuals(temperatures=(25,), channels=("gx",))
    residuals = residuals.filter(residuals["run"] == "rate-pyramid-25C")
    return made.write_folder(tmp_path / "single", residuals, made.summary_of(residuals, sampled=False))

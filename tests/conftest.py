"""Tests run strict: double precision, no silent promotion of rank or type, shapes and types checked."""

import functools
import gc
import os
import sys
from importlib import import_module
from pathlib import Path

import pytest
from xdist.scheduler import LoadScopeScheduling

# Tests replace functions, which the identity of a kept program cannot see.
os.environ["IMUBAYES_KEEP_PROGRAMS"] = "0"
# Two test processes share the machine: threads of the linear algebra would wait for each other.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
# Everything compiled is kept, for tests and for the commands they run alike, so that it is paid for once.
os.environ["XDG_CACHE_HOME"] = str(Path(__file__).parents[1] / ".cache" / "commands")
os.environ["XDG_CONFIG_HOME"] = str(Path(__file__).parents[1] / ".cache" / "configuration")

# Folders and files whose tests compile models of their own, or search as long, heaviest first; `make test-fast` leaves
# them out.
COMPILED = (
    "model/test_compile_cache_limit.py",  # first, as it drops what its process compiled before
    "readme",
    "criticism",
    "explorer/test_explore_ahead.py",
    "explorer/test_explore_answers.py",
    "explorer/test_explore_opening.py",
    "explorer/test_explore_page.py",
    "explorer/test_explore_points.py",
    "explorer/test_explore_session.py",
    "explorer/test_explore_walks.py",
    "cli",
    "qualification/test_report.py",
    "qualification/test_report_combinations.py",
    "qualification/test_exports_agree.py",
    "recordings/test_noise.py",
    "recordings/test_noise_records.py",
    "readme/test_notebook.py",  # of what others have compiled
    "conformance",
    "inference",
    "model",
    "display/test_comparison.py",
    "results",
    "procedures/test_joint.py",
    "procedures/test_motion.py",
    "procedures/test_serial_joint.py",
    "procedures/test_recovery.py",
    "procedures/test_converters.py",
    "procedures/test_assumptions.py",
    "procedures/test_new_procedure.py",
    "recordings/test_new_campaign.py",
    "campaign/test_new_covariate.py",
    "recordings/test_guided_capture.py",
    "campaign/test_setup_gate.py",
    "campaign/test_setup_gate_of_several_axes.py",
    "campaign/test_setup_gate_drifts.py",
    "campaign/test_wrong_values.py",
    "campaign/test_still_rests.py",
    "recordings/test_record_examination.py",
    "recordings/test_noise_terms.py",
    "display/test_figures.py",
    "procedures/test_serial_axes.py",
    "simulation",
    "qualification/test_uncertainty_budget.py",
    "archive",
    "qualification/test_correct_recording.py",
    "qualification/test_inputs_along_axes.py",
    "qualification/test_known_answers.py",
    "qualification/test_effects_not_shown.py",
    "qualification/test_left_in_law.py",
    "qualification/test_uncorrected_effects.py",
    "qualification/test_until_digits.py",
    "reference",
    "study",
    "campaign/test_fresh_setups.py",
    "recordings/test_rate_table_recordings.py",
    "campaign/test_tumble.py",
    "campaign/test_checks.py",
    "campaign/test_raw_logs.py",
    "campaign/test_nominal_scales.py",
    "recordings/test_convert.py",
    "campaign/test_clipping.py",
    "campaign/test_reduction.py",
    "recordings/test_term_evidence.py",
    "parameters",
    "procedures/test_rate_series.py",
    "test_docstrings.py",  # after those that fit the same campaign
    "test_kept_programs.py",
    "test_in_numpy.py",
    "test_rotations.py",
    "release",
)

# Tests that fit the same campaign run in one process, for what they share; other tests stay with their file.
README = "readme/test_readme.py::test_"
GROUPS = {
    "hidden": (
        f"{README}commands_run_as_written[The loop",
        f"{README}commands_before",
        "criticism/test_outliers.py",
        "criticism/test_shipped.py",
        "criticism/test_known_noise.py::test_scatter_of_one",
        "criticism/test_known_noise.py::test_noise_as",
        "criticism/test_known_noise.py::test_all_comparisons",
        "criticism/test_dead_zone.py",
        "criticism/test_missing_several.py",
        "criticism/test_wrong_records.py",
        "criticism/test_noise_is_no_effect.py::test_scatter_between",
        "criticism/test_noise_is_no_effect.py::test_complete_models",
        "criticism/test_known_noise_fit.py",
        "results/test_posterior.py",
        "explorer/test_explore_ahead.py",
        "explorer/test_explore_answers.py",
        "explorer/test_explore_opening.py",
        "explorer/test_explore_page.py",
        "explorer/test_explore_points.py",
        "explorer/test_explore_session.py",
    ),
    "polar-tumble": (
        "results/test_predicted_runs.py",
        "results/test_repeatability.py",
        "archive/test_run_batch.py",
        "archive/test_lanes.py",
        "qualification/test_report_combinations.py",
        "results/test_combinations.py",
        "results/test_contributions_agree.py::test_a_nominal",
        "criticism/test_hidden_effects.py::test_an_effect_between_few_runs",
    ),
    "desk-imu": (
        "qualification/test_correct_recording.py",
        "inference/test_negligible_modes.py",
    ),
    "accel-channel": (
        f"{README}python_runs_as_written",
        "criticism/test_refit_edited.py",
        "criticism/test_cross_validation.py",
        "criticism/test_removal.py",
        "criticism/test_hidden_effects.py",
        "criticism/test_injection_recovery.py",
        "criticism/test_candidates_everywhere.py",
        "criticism/test_known_noise.py",
        "criticism/test_noise_assumptions.py",
        "criticism/test_noise_is_no_effect.py",
        "criticism/test_wrong_names.py",
        "criticism/test_user_effect.py",
        "cli/",
        "inference/test_resume.py",
        "results/test_fit_file.py",
        "results/test_arviz.py",
        "results/test_contributions_agree.py",
        "procedures/test_converters.py",
        "qualification/test_until_digits.py",
        "qualification/test_inputs_along_axes.py",
        "qualification/test_uncertainty_budget.py",
        "test_docstrings.py",
    ),
}

# Imports and tracing create millions of objects that stay, and looking for garbage among them takes time.
gc.set_threshold(300_000)


def pytest_addoption(pluginmanager):
    """Be strict before the conftests of folders import the package; what only hands out tests imports none."""
    options = pluginmanager.get_plugin("pytestconfig").known_args_namespace
    if not options.numprocesses or "PYTEST_XDIST_WORKER" in os.environ:
        import_module("strict_types").be_strict()


def _compiled_plainly(config) -> bool:
    return "not slow" in config.option.markexpr


def pytest_configure(config):
    # Most of what is tested runs once, so that compiling is what takes time.  The long studies are compiled as a user
    # has them.
    if "jax" in sys.modules:
        import_module("jax").config.update("jax_disable_most_optimizations", _compiled_plainly(config))
    # Two test processes share the cache: an entry that is still being written is compiled again.
    config.addinivalue_line("filterwarnings", "ignore:Error (reading|writing) persistent compilation cache:UserWarning")
    # Aliases of other packages, such as rich's, are still written in the old way.
    config.addinivalue_line("filterwarnings", "ignore::beartype.roar.BeartypeDecorHintPep585DeprecationWarning")
    config.addinivalue_line("markers", "compiled: compiles a model, or takes as long; left out by `make test-fast`")


class Scheduling(LoadScopeScheduling):
    """One group of tests after the other to the next free process."""

    def _split_scope(self, nodeid: str) -> str:
        test = nodeid.removeprefix("tests/")
        mine = (group for group, parts in GROUPS.items() if test.startswith(parts))
        return next(mine, test.partition("::")[0])


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config, log):
    return Scheduling(config, log) if config.getvalue("dist") == "loadfile" else None


def pytest_ignore_collect(collection_path, config):
    """Do not even read what is left out as a whole."""
    return True if "not compiled" in config.option.markexpr and _weight(collection_path) < len(COMPILED) else None


def pytest_collection_modifyitems(items):
    """Heavy tests first, so that none is left over at the end."""
    for item in items:
        if _weight(item.path) < len(COMPILED):
            item.add_marker("compiled")
    items.sort(key=lambda item: _weight(item.path))
    gc.freeze()


@functools.cache
def _weight(file: Path) -> int:
    """Return the place of a file among those that compile, by its longest entry; their number if it does not."""
    path = Path(os.path.relpath(file, Path(__file__).parent)).as_posix()
    entries = [(len(part), place) for place, part in enumerate(COMPILED) if path.startswith(part)]
    return max(entries)[1] if entries else len(COMPILED)


@pytest.fixture(scope="session")
def command_environment(pytestconfig) -> dict[str, str]:
    """Environment of a process of its own: the package from this tree, compiled like the tests and into their cache."""
    source, plainly = str(Path(__file__).parents[1] / "src"), str(int(_compiled_plainly(pytestconfig)))
    return os.environ | {"PYTHONPATH": source, "JAX_DISABLE_MOST_OPTIMIZATIONS": plainly}


@pytest.fixture(scope="session")
def accel_channel(tmp_path_factory) -> Path:
    """The result of the shipped accelerometer channel, at its mode: for many tests, which copy what they change."""
    from imubayes.api import fit

    folder, root = tmp_path_factory.mktemp("accel-channel") / "result", Path(__file__).parents[1]
    fit(root / "data" / "accel-channel", root / "models" / "accel-channel.toml", folder, sample=False)
    return folder


@pytest.fixture(scope="session")
def hidden_gyro(tmp_path_factory):
    """The result, with its fit, of the shipped campaign whose gyros hide an effect, at its mode; not to be changed."""
    from imubayes.api import fit

    folder = tmp_path_factory.mktemp("hidden-gyro") / "first result"  # a blank in the name: commands quote it
    root = Path(__file__).parents[1]
    return fit(root / "data" / "hidden-gyro", root / "models" / "hidden-effects.toml", folder, sample=False)


SAMPLED_STEPS = 60  # of each ensemble, too few for intervals


@pytest.fixture(scope="session")
def sampled_channel(tmp_path_factory) -> Path:
    """The same, sampled by a few steps with seed 3."""
    from imubayes.api import Settings, fit

    folder, root = tmp_path_factory.mktemp("sampled") / "result", Path(__file__).parents[1]
    settings = Settings(least_steps=SAMPLED_STEPS, most_steps=SAMPLED_STEPS)
    fit(root / "data" / "accel-channel", root / "models" / "accel-channel.toml", folder, seed=3, settings=settings)
    return folder


@pytest.fixture(scope="module", autouse=True)
def _what_stays_is_not_searched():
    """Leave what a module left behind, compiled programs above all, out of later searches for garbage."""
    yield
    gc.collect()
    gc.freeze()

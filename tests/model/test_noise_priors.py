"""The noise of a static record as priors of other runs of the unit."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import slow_noise_campaign as simulated
from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.errors import InputError
from imubayes.model.bind import Model, bind
from imubayes.model.likelihood import log_normaliser
from imubayes.model.model_file import read_model
from imubayes.model.model_spec import EffectSpec, ModelSpec, PriorCorrelation

REPEATS, BIAS, SCALE = 3, 4.0, 300.0
PLAIN = ("gyro_bias", "gyro_scale_factor", "white_noise")
SLOW = (*PLAIN, "flicker_noise", "random_walk_noise")


@pytest.fixture(scope="module")
def written(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("unit")
    rows = simulated.rate_rows(REPEATS, np.random.default_rng(1), BIAS, SCALE)
    still = simulated.still_record(2.0, np.random.default_rng(2), BIAS)
    simulated.write(folder / "turns", rows)
    simulated.write(folder / "still", None, still)
    simulated.write(folder / "both", rows, still)
    assert run(["noise", str(folder / "still"), "--out", str(folder / "noise")]) == 0
    effects = "".join(f'[[effect]]\nname = "{name}"\n' for name in PLAIN)
    head = 'format = 1\nname = "with-priors"\nnoise_priors = "noise/noise-priors.toml"\n'
    (folder / "model.toml").write_text(head + effects)
    return folder


def of_effects(*names: str) -> ModelSpec:
    return ModelSpec("m", tuple(EffectSpec(name) for name in names))


@pytest.fixture(scope="module")
def with_priors(written: Path) -> Model:
    return bind(read_model(written / "model.toml"), load_campaign(written / "turns"))


def test_the_prior_of_correlated_parameters_is_that_of_a_normal_distribution(with_priors: Model):
    model = with_priors
    problem = model.problem
    assert problem.hyper_correlation is not None
    root = np.asarray(problem.hyper_correlation.root)
    matrix = root @ root.T
    assert np.abs(matrix - np.eye(len(matrix))).max() > 0.2
    h = np.array([0.3, -0.8, 0.5])
    rest = float(log_normaliser(problem, jnp.asarray(h)))
    without = bind(of_effects(*PLAIN), model.campaign)
    assert without.problem.hyper_correlation is None
    plain = type(problem)(**{**vars(problem), "hyper_correlation": None})
    difference = rest - float(log_normaliser(plain, jnp.asarray(h)))
    expected = -0.5 * h @ np.linalg.solve(matrix, h) - 0.5 * np.linalg.slogdet(matrix)[1] + 0.5 * h @ h
    assert difference == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize(
    ("names", "matrix", "what"),
    [
        (("white_noise.sigma[gx]", "flicker.b[gx]"), ((1, 0.5), (0.5, 1)), "no noise parameter 'flicker.b[gx]'"),
        (("white_noise.sigma[gx]", "flicker_noise.b[gx]"), ((1, 1.5), (1.5, 1)), "no correlation matrix"),
        (("white_noise.sigma[gx]", "flicker_noise.b[gx]"), ((1, 0.5),), "does not suit"),
        (("white_noise.sigma[gx]", "white_noise.sigma[gx]"), ((1, 0.5), (0.5, 1)), "listed twice"),
    ],
)
def test_what_is_no_correlation_is_refused(written: Path, names, matrix, what: str):
    spec = of_effects(*SLOW)
    wrong = ModelSpec("m", spec.effects, correlations=(PriorCorrelation(names, matrix),))
    with pytest.raises(InputError, match=what.replace("[", r"\[").replace("]", r"\]")):
        bind(wrong, load_campaign(written / "turns"))

"""The noise of a static record in other runs of the unit: as priors, and jointly in one campaign."""

from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

import slow_noise_campaign as simulated
from imubayes.campaign import load_campaign
from imubayes.cli.main import run
from imubayes.foundations.errors import InputError
from imubayes.inference.laplace_marginal import knowledge
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.bind import Model, bind
from imubayes.model.likelihood import log_normaliser
from imubayes.model.model_file import EffectSpec, ModelSpec, PriorCorrelation, read_model
from imubayes.parameters.priors import LogNormal

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


def fitted(spec: ModelSpec, folder: Path):
    """Return the model, the standard deviation of the bias in °/h, and values and log sds of the noise scales."""
    model = bind(spec, load_campaign(folder))
    problem = model.problem
    mode = find_mode(problem, jnp.zeros(problem.size[0]), jnp.zeros(problem.size[1]))
    assert bool(mode.converged)
    precision = knowledge(problem, mode.about, mode.h).precision + jnp.eye(problem.size[0])
    place = model.layout.index("gyro_bias.bias[gx]")
    parameter = model.layout.parameters[place]
    sd = float(np.sqrt(np.linalg.inv(np.asarray(precision))[place, place])) * parameter.prior_sd
    values = dict(zip(model.hyper_layout.names, np.asarray(problem.hyper_priors.values(mode.h)), strict=True))
    spread = np.sqrt(np.diag(np.linalg.inv(np.asarray(mode.marginal.information))))
    priors = [parameter.prior for parameter in model.hyper_layout.parameters]
    widths = [prior.log_deviation * s for prior, s in zip(priors, spread, strict=True) if isinstance(prior, LogNormal)]
    return model, sd, values, dict(zip(model.hyper_layout.names, widths, strict=len(widths) == len(priors)))


@pytest.fixture(scope="module")
def with_priors(written: Path):
    return fitted(read_model(written / "model.toml"), written / "turns")


@pytest.fixture(scope="module")
def deviation_of_bias() -> float:
    """Standard deviation, °/h, of the generalised least-squares bias of the turns under the true noise."""
    random, rows = np.random.default_rng(3), REPEATS * len(simulated.RATES)
    each = round(simulated.ROW_S / simulated.DT)
    means = [simulated.slow_noise(rows * each, random).reshape(rows, each).mean(axis=1) for _ in range(1000)]
    rates = np.tile(simulated.RATES, REPEATS)
    design = np.column_stack([np.ones(rows), rates / 100])
    # The random walk starts at zero: means over many runs are zero, and the covariance is about zero.
    covariance = np.mean([np.outer(each, each) for each in means], axis=0)
    return 3600 * float(np.sqrt(np.linalg.inv(design.T @ np.linalg.solve(covariance, design))[0, 0]))


@pytest.mark.slow
def test_priors_of_a_static_record_give_the_interval_of_its_noise(written: Path, with_priors, deviation_of_bias: float):
    model, sd, values, _ = with_priors
    assert {"flicker_noise.b[gx]", "random_walk_noise.k[gx]"} <= set(model.hyper_layout.names)
    assert model.problem.hyper_correlation is not None
    assert values["flicker_noise.b[gx]"] == pytest.approx(simulated.NOISE["flicker"] / 3600, rel=0.3)
    assert sd == pytest.approx(deviation_of_bias, rel=0.3)
    # White noise alone, the planted fault, is too sure of itself.
    assert fitted(of_effects(*PLAIN), written / "turns")[1] < 0.6 * deviation_of_bias


@pytest.mark.slow
def test_a_static_record_informs_the_noise_of_other_runs(written: Path, deviation_of_bias: float):
    """One campaign of both: B and K are known better than from the short run alone, and so is the bias."""
    _, _, _, unknown = fitted(of_effects(*SLOW), written / "turns")
    _, joint, values, known = fitted(of_effects(*SLOW), written / "both")
    for name in ("flicker_noise.b[gx]", "random_walk_noise.k[gx]"):
        assert known[name] < 0.8 * unknown[name]
    assert values["flicker_noise.b[gx]"] == pytest.approx(simulated.NOISE["flicker"] / 3600, rel=0.4)
    assert values["random_walk_noise.k[gx]"] == pytest.approx(simulated.NOISE["random_walk"] / 3600, rel=0.6)
    # The record begins at the shared bias too.
    assert 0.5 * deviation_of_bias < joint < 1.1 * deviation_of_bias


@pytest.mark.slow
def test_the_prior_of_correlated_parameters_is_that_of_a_normal_distribution(with_priors):
    model: Model = with_priors[0]
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
        (("white_noise.sigma[gx]", "flicker_noise.b[gx]"), ((1, 1.5), (1.5, 1)), "not a correlation matrix"),
        (("white_noise.sigma[gx]", "flicker_noise.b[gx]"), ((1, 0.5),), "does not suit"),
        (("white_noise.sigma[gx]", "white_noise.sigma[gx]"), ((1, 0.5), (0.5, 1)), "listed twice"),
    ],
)
def test_what_is_no_correlation_is_refused(written: Path, names, matrix, what: str):
    spec = of_effects(*SLOW)
    wrong = ModelSpec("m", spec.effects, correlations=(PriorCorrelation(names, matrix),))
    with pytest.raises(InputError, match=what.replace("[", r"\[").replace("]", r"\]")):
        bind(wrong, load_campaign(written / "turns"))

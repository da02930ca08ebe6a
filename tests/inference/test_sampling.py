"""The sampler on densities whose answer is known, and the verdict on chains that did not converge."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy import stats

from imubayes.inference.chains import Settings
from imubayes.inference.checkpoint import Checkpoint
from imubayes.inference.convergence import diagnose, nested_r_hat
from imubayes.inference.ensemble_sampling import sample

REFERENCE = Path(__file__).parents[2] / ".." / "shared" / "reference" / "posteriordb"
NAMES = ("a", "b")


def run(log_density, dimensions: int, folder: Path, seed: int = 0, walkers: int = 64, steps: int = 3000):
    random = np.random.default_rng(seed)
    checkpoint = Checkpoint(folder / f"checkpoint-{seed}.h5", 4, walkers, dimensions, {})
    checkpoint.create()
    starts = [random.normal(size=(walkers, dimensions)) for _ in range(4)]
    names = [f"p{place}" for place in range(dimensions)]
    return sample(log_density, starts, names, Settings(seed=seed, most_steps=steps), checkpoint)


def test_correlated_normal(tmp_path):
    covariance = np.array([[1.0, 0.9], [0.9, 2.0]])
    precision = np.linalg.inv(covariance)
    chains = run(lambda x: -0.5 * np.einsum("ni,ij,nj->n", x, precision, x), 2, tmp_path)
    assert chains.diagnosis.converged
    draws = chains.points.reshape(-1, 2)
    error = np.sqrt(2 / chains.diagnosis.ess_bulk.min())
    assert np.all(np.abs(draws.mean(0)) < 4 * np.sqrt(np.diag(covariance)) * error)
    np.testing.assert_allclose(np.cov(draws.T), covariance, atol=10 * error)


def eight_schools(points: np.ndarray, data: dict) -> np.ndarray:
    """Log density of μ = 5 z, τ = 5 tan(½π Φ(z)), θ' = z: half-Cauchy through its inverse distribution function."""
    mu = 5 * points[:, 0]
    tau = 5 * np.tan(0.5 * np.pi * stats.norm.cdf(points[:, 1]))
    theta = mu[:, None] + tau[:, None] * points[:, 2:]
    fit = stats.norm.logpdf(np.array(data["y"]), theta, np.array(data["sigma"])).sum(axis=1)
    return fit - 0.5 * np.sum(points**2, axis=1)


@pytest.mark.slow
def test_eight_schools_against_the_reference_draws(tmp_path):
    folder = REFERENCE / "eight_schools-eight_schools_noncentered"
    if not folder.is_dir():
        pytest.skip("the reference posteriors are not here")
    data = json.loads((folder / "data.json").read_text())
    chains = run(lambda x: eight_schools(x, data), 10, tmp_path, steps=6000)
    points = chains.points.reshape(-1, 10)
    mu, tau = 5 * points[:, 0], 5 * np.tan(0.5 * np.pi * stats.norm.cdf(points[:, 1]))
    reference = json.loads((folder / "reference.json").read_text())
    size = chains.diagnosis.ess_bulk.min()
    assert size > 400
    for name, draws in (("mu", mu), ("tau", tau)):
        known = reference["params"][name]
        tolerance = 4 * draws.std() * np.sqrt(1 / size + 1 / 10_000)
        assert abs(draws.mean() - known["mean"]) < tolerance
        assert 0.9 < draws.std() / known["sd"] < 1.1


class TestFalseConvergence:
    """Chains that must not be called converged."""

    steps, walkers = 60, 40

    def good(self, seed: int = 0) -> np.ndarray:
        return np.random.default_rng(seed).normal(size=(4, self.steps, self.walkers, 2))

    def verdict(self, chain: np.ndarray):
        return diagnose(chain, np.zeros(chain.shape[:-1]), NAMES)

    def test_good_chains_pass(self):
        assert self.verdict(self.good()).converged

    def test_a_mode_found_by_one_ensemble(self):
        chain = self.good()
        chain[2, ..., 1] += 1.0
        verdict = self.verdict(chain)
        assert not verdict.converged
        assert "ensembles disagree on b" in verdict.message

    def test_a_frozen_walker(self):
        chain = self.good()
        chain[1, :, 5] = chain[1, :1, 5]
        assert "1 of 160 walkers never moved" in self.verdict(chain).message

    def test_a_constant_parameter(self):
        chain = self.good()
        chain[..., 0] = 1.0
        verdict = self.verdict(chain)
        assert not verdict.converged
        assert "a never changed" in verdict.message

    def test_short_chains(self):
        assert "effective size" in self.verdict(self.good()[:, :2, :20]).message

    def test_a_log_density_that_is_not_finite(self):
        chain = self.good()
        density = np.zeros(chain.shape[:-1])
        density[0, 0, 0] = np.nan
        assert "not finite" in diagnose(chain, density, NAMES).message

    def test_ensembles_that_drift_alike(self):
        chain = self.good()
        chain[..., 1] += np.linspace(-0.4, 0.4, self.steps)[:, None]
        assert "on b, or with themselves later" in self.verdict(chain).message

    def test_walkers_that_hardly_move(self):
        """Each stands at a draw of its own: as many effective draws as walkers."""
        random = np.random.default_rng(3)
        chain = random.normal(size=(4, 1, 120, 2)) + 0.01 * random.normal(size=(4, self.steps, 120, 2))
        assert "effective size" in self.verdict(chain).message

    def test_a_few_walkers_far_away(self):
        """They are too few to change a rank, and ruin mean and standard deviation."""
        chain = self.good()
        chain[:, :, 3, 0] += 500
        message = self.verdict(chain).message
        assert "mean effective size of a" in message
        assert "bulk effective size" not in message

    def test_a_log_density_that_does_not_mix(self):
        density = -np.random.default_rng(4).chisquare(2, size=(4, self.steps, self.walkers))
        assert diagnose(self.good(), density, NAMES).converged
        walkers = density[:, :1] + 0.01 * density
        assert "of the log density" in diagnose(self.good(), walkers, NAMES).message

    def test_walkers_that_began_far_below_the_others(self):
        density = -np.random.default_rng(4).chisquare(2, size=(4, self.steps, self.walkers))
        density[1, :4, 7] -= 200
        assert "1 walkers began far below" in diagnose(self.good(), density, NAMES).message
        density[1, 20, 9] -= 200
        assert "began far below" not in diagnose(self.good(), density, NAMES).message

    @pytest.mark.slow
    def test_two_hundred_faulty_runs(self):
        """Not one of 200 runs with a fault drawn at random is called converged."""
        random = np.random.default_rng(7)
        wrong = 0
        for seed in range(200):
            chain = self.good(seed)
            fault = seed % 4
            if fault == 0:
                chain[random.integers(4), ..., random.integers(2)] += random.choice([-1, 1]) * 0.5
            elif fault == 1:
                walker = random.integers(self.walkers)
                chain[0, :, walker] = chain[0, 0, walker]
            elif fault == 2:
                chain[..., random.integers(2)] = 0.3
            else:
                chain = chain[:, :3, :16]
            wrong += self.verdict(chain).converged
        assert wrong == 0


def test_nested_r_hat_grows_with_the_distance_of_a_lost_mode():
    near, far = (np.random.default_rng(1).normal(size=(4, 50, 20, 1)) for _ in range(2))
    far[0] += 0.5
    assert nested_r_hat(near)[0] < 1.01 < nested_r_hat(far)[0]

"""The sampler on `data/trihedral-imu`: against emcee's stretch move and NumPyro's NUTS on the same log density.

All three work on the same points (z of parameters and noise scales) and the same compiled log density; everything is
compiled before it is timed, and every chain starts in the posterior, so that nobody pays for burn-in.

- imubayes: its mix of moves (curved nested Laplace, stretch, DE), independent ensembles, in memory.
- stretch: emcee's stretch move alone, one ensemble of the same number of walkers, until the chain is 50 times its
  integrated autocorrelation time τ or the time allowed is over.  A chain that is shorter gives a τ that is too
  small, which is to its favour: the ratio is then a lower bound.
- NUTS: dense metric = the covariance of the Laplace approximation, fixed; the step size is adapted in a warm-up
  that is not timed.  Of sequential and vectorised chains the faster way is taken.

The effective size is that of the worst parameter, by the rank-normalised bulk estimate over all chains (walkers are
chains) or by N/τ, whichever is larger.
"""

import time
from dataclasses import dataclass

import arviz_stats
import emcee
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from common import Report, require, trihedral
from control_variates import compare
from emcee.autocorr import integrated_time

from imubayes.inference.chains import Settings, walkers_for
from imubayes.inference.ensemble_sampling import _SHORT_SHARE, _SHORT_STEP, _sampler, burn_in
from imubayes.inference.laplace_proposal import LaplaceMove, LaplaceProposal, LogDensity
from imubayes.inference.nested_laplace import NestedLaplace, nested_laplace, posterior_precision
from imubayes.inference.posterior_mode import find_mode
from imubayes.model.likelihood import log_density
from imubayes.model.problem import Problem

PER_EVALUATION_BAR, ACCEPTANCE_BAR, STRETCH_BAR, NUTS_BAR = 0.5, 0.70, 50.0, 100.0
ENSEMBLES, STEPS = 4, 100
STRETCH_SECONDS, LONG_ENOUGH = 300.0, 50.0
NUTS_CHAINS, NUTS_WARMUP, NUTS_DRAWS = 4, 300, 500
_AGREE_MOST, _AGREE_USUAL = 4.5, 3.0


@dataclass
class Outcome:
    """A sampled posterior: draws (chains, draws, D), what it cost, and what it is worth."""

    name: str
    draws: np.ndarray
    seconds: float
    evaluations: int
    gradients: bool = False

    def __post_init__(self):
        self.tau = self._tau()
        self.effective = max(float(self._bulk().min()), self._size() / float(self.tau.max()))

    def _size(self) -> int:
        return self.draws.shape[0] * self.draws.shape[1]

    def _tau(self) -> np.ndarray:
        return integrated_time(self.draws.transpose(1, 0, 2), c=5, tol=0)

    def _bulk(self) -> np.ndarray:
        return np.asarray(arviz_stats.ess(self.draws, chain_axis=0, draw_axis=1, method="bulk"))

    @property
    def rate(self) -> float:
        return self.effective / self.seconds


def measure(quick: bool = False) -> Report:
    require("numpyro")
    report = Report("sampling", "Sampling: `data/trihedral-imu`, full baseline model")
    problem = trihedral().problem
    size, hyper_size = problem.size
    dimensions = size + hyper_size
    walkers = walkers_for(dimensions, Settings())
    mode = find_mode(problem, jnp.zeros(size), jnp.zeros(hyper_size))
    approximation = nested_laplace(problem, mode)
    report.say(f"{size} parameters and {hyper_size} noise scales, {walkers} walkers an ensemble.\n")

    ours, acceptance = _sample_mix(problem, approximation, walkers, 30 if quick else STEPS)
    stretch, length = _sample_stretch(problem, ours, walkers, 10.0 if quick else STRETCH_SECONDS)
    covariance = _laplace_covariance(problem, mode, approximation)
    nuts, leapfrogs = _sample_nuts(problem, ours, covariance, 20 if quick else NUTS_DRAWS, 50 if quick else NUTS_WARMUP)

    rows = []
    for one, share in ((ours, _moved(ours.draws)), (stretch, _moved(stretch.draws)), (nuts, "")):
        kind = "gradients" if one.gradients else "densities"
        rows.append(
            [
                one.name,
                f"{one.draws.shape[0]} × {one.draws.shape[1]}",
                share,
                f"{one.tau.max():.3g}",
                f"{one.evaluations} {kind}",
                f"{one.effective:.0f}",
                f"{one.effective / one.evaluations:.2g}",
                f"{one.seconds:.2f}",
                f"{one.rate:.3g}",
            ]
        )
    report.table(
        [
            "sampler",
            "chains × draws",
            "accepted",
            "τ worst",
            "evaluations",
            "ESS worst",
            "ESS/evaluation",
            "s",
            "ESS/s",
        ],
        rows,
    )
    report.judge("effective draws per log-density evaluation", ours.effective / ours.evaluations, PER_EVALUATION_BAR)
    report.judge("acceptance of the Laplace move, independent draws", acceptance, ACCEPTANCE_BAR)
    report.judge("ESS/s against the stretch move", ours.rate / stretch.rate, STRETCH_BAR)
    report.judge("ESS/s against NUTS", ours.rate / nuts.rate, NUTS_BAR)
    report.say(f"- the stretch chain is {length:.0f} τ long{_caveat(length)}")
    report.say(f"- NUTS takes {leapfrogs:.0f} leapfrogs a draw\n")
    _agree(report, ours, nuts)
    compare(report, quick)
    return report


def _caveat(length: float) -> str:
    return (
        "" if length >= LONG_ENOUGH else f", less than {LONG_ENOUGH:.0f}: its τ is too small, the ratio a lower bound"
    )


def _moved(draws: np.ndarray) -> str:
    return f"{np.mean(np.any(np.diff(draws, axis=1) != 0, axis=-1)):.2f}"


def _sample_mix(problem: Problem, approximation: NestedLaplace, walkers: int, steps: int):
    """Return the outcome of imubayes' own mix of moves, and the share of its independent draws that were taken."""
    proposal = LaplaceProposal(approximation, problem)
    density = LogDensity(problem, walkers // 2)
    dimensions = sum(problem.size)
    chains, evaluations, taken, independent = [], 0, 0.0, []
    for ensemble in range(ENSEMBLES):
        move = LaplaceMove(proposal, _SHORT_STEP, _SHORT_SHARE)
        sampler = _sampler(density, walkers, dimensions, move)
        start = proposal.draw(np.random.RandomState(100 + ensemble), walkers)
        random = np.random.RandomState(ensemble).get_state()
        state = sampler.run_mcmc(emcee.State(start, random_state=random), burn_in(steps) + 2)
        sampler.reset()
        move.proposed = move.taken = 0
        before = density.evaluations
        clock = time.perf_counter()
        sampler.run_mcmc(state, steps)
        taken += time.perf_counter() - clock
        evaluations += density.evaluations - before
        chains.append(sampler.get_chain().transpose(1, 0, 2))
        independent.append(move)
    outcome = Outcome("imubayes", np.concatenate(chains), taken, evaluations)
    acceptance = sum(one.taken for one in independent) / sum(one.proposed for one in independent)
    return outcome, acceptance


def _sample_stretch(problem: Problem, ours: Outcome, walkers: int, allowed: float) -> tuple[Outcome, float]:
    """Return the outcome of the stretch move alone, and the length of its chain in units of τ."""
    density = LogDensity(problem, walkers // 2)
    sampler = emcee.EnsembleSampler(
        walkers, ours.draws.shape[-1], density, moves=emcee.moves.StretchMove(), vectorize=True
    )
    state = sampler.run_mcmc(_spread(ours, walkers), 2)
    sampler.reset()
    before, taken, steps, length = density.evaluations, 0.0, 100, 0.0
    while taken < allowed and length < LONG_ENOUGH:
        clock = time.perf_counter()
        state = sampler.run_mcmc(state, steps)
        taken += time.perf_counter() - clock
        chain = sampler.get_chain()
        length = len(chain) / float(integrated_time(chain, c=5, tol=0).max())
        steps = min(len(chain), max(10, int(steps * (allowed - taken) / max(taken, 1e-3))))
    draws = sampler.get_chain().transpose(1, 0, 2)
    return Outcome("emcee stretch", draws, taken, density.evaluations - before), length


def _spread(ours: Outcome, count: int) -> np.ndarray:
    """Return draws of the posterior, far from each other in the chains."""
    flat = ours.draws.reshape(-1, ours.draws.shape[-1])
    return flat[np.linspace(0, len(flat) - 1, count).astype(int)].copy()


def _laplace_covariance(problem: Problem, mode, approximation: NestedLaplace) -> np.ndarray:
    size, hyper_size = problem.size
    covariance = np.zeros((size + hyper_size, size + hyper_size))
    covariance[:size, :size] = np.linalg.inv(np.asarray(posterior_precision(problem, mode)))
    covariance[size:, size:] = approximation.hyper_covariance()
    return covariance


def _sample_nuts(problem: Problem, ours: Outcome, covariance: np.ndarray, draws: int, warmup: int):
    """Return the outcome of NUTS and its leapfrogs a draw."""
    from numpyro.infer import NUTS

    size = problem.size[0]
    arrays, static = eqx.partition(problem, eqx.is_array)

    def potential(point):
        return -log_density(eqx.combine(arrays, static), point[:size], point[size:])

    kernel = NUTS(
        potential_fn=potential,
        inverse_mass_matrix=jnp.asarray(covariance),
        dense_mass=True,
        adapt_mass_matrix=False,
    )
    starts = jnp.asarray(_spread(ours, NUTS_CHAINS))
    # One kernel for all chains keeps what it learns of its arguments from the first; the states are the chains' own.
    states = [kernel.init(jax.random.key(chain), warmup, start, (), {}) for chain, start in enumerate(starts)]

    def advance(state, count: int):
        def one(state, _):
            state = kernel.sample(state, (), {})
            return state, (state.z, state.num_steps)

        return jax.lax.scan(one, state, None, length=count)

    # Compiled by hand: `MCMC.run` traces its kernel anew at every call, which would be counted against it.
    warm = jax.jit(lambda state: advance(state, warmup)[0])
    alone = jax.jit(lambda state: advance(state, draws))
    together = jax.jit(jax.vmap(lambda state: advance(state, draws)))
    states = [warm(state) for state in states]
    stacked = jax.tree.map(lambda *leaves: jnp.stack(leaves), *states)

    def sequential():
        ends = [alone(state) for state in states]
        return jax.tree.map(lambda *leaves: jnp.stack(leaves), *[found for _, found in ends])

    ways = {"sequential": sequential, "vectorized": lambda: together(stacked)[1]}
    timed = {}
    for name, way in ways.items():
        jax.block_until_ready(way())
        clock = time.perf_counter()
        points, leapfrogs = jax.block_until_ready(way())
        timed[name] = (time.perf_counter() - clock, np.asarray(points), np.asarray(leapfrogs))
    best = min(timed, key=lambda name: timed[name][0])
    taken, points, leapfrogs = timed[best]
    return Outcome(f"NumPyro NUTS, {best}", points, taken, int(leapfrogs.sum()), True), float(leapfrogs.mean())


def _agree(report: Report, ours: Outcome, nuts: Outcome) -> None:
    """Say how far means and standard deviations differ, in units of their Monte Carlo errors."""
    report.say("Agreement with NUTS, differences in units of their Monte Carlo standard errors:\n")
    rows = []
    for what, moment in (("means", np.mean), ("standard deviations", np.std)):
        values, errors = [], []
        for one in (ours, nuts):
            values.append(moment(one.draws, axis=(0, 1)))
            method = "mean" if what == "means" else "sd"
            errors.append(np.asarray(arviz_stats.mcse(one.draws, chain_axis=0, draw_axis=1, method=method)))
        z = np.abs(values[0] - values[1]) / np.hypot(*errors)
        rows.append([what, len(z), f"{np.sqrt(np.mean(z**2)):.2f}", f"{np.quantile(z, 0.99):.2f}", f"{z.max():.2f}"])
    report.table(["quantity", "number", "rms", "99 % quantile", "largest"], rows)
    worst = max(float(row[-1]) for row in rows)
    report.judge("largest difference of a mean or standard deviation (MCSE)", worst, _AGREE_MOST, least=False)

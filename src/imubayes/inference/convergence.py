"""Convergence of the sampler and Monte Carlo errors of what its chains state.

Convergence is judged on independent ensembles, never on the walkers of one.  Walkers of one ensemble move together: R̂
over walkers stays small with a frozen walker and misses a lost mode.  Nested R̂ (Margossian et al. 2024) treats each
half of an ensemble's steps as a superchain, so that ensembles which agree because all drift alike do not pass.
Effective sizes are the rank-normalised bulk and tail ones of Vehtari et al. 2021, the latter at the ends of the 95 %
interval, and those of mean and standard deviation as they are, which ranks do not tell: a few walkers that stay far
away spoil both.  Walkers that stand still have an effective size, too: their number.  So sizes have to exceed it
several times.  The log density is judged like a parameter.  A verdict of "no" names the parameter.

A region that no walker has come near is not seen: a distant mode, or a narrow place that few steps lead to (`BLIND`).

A chain that has not yet been if its proposal is too thin agrees with itself.  So chains of a proposal are also held
against draws of that proposal weighted by the posterior, which reach farther than the chain does: the weights must have
a tail that lets them (Pareto k̂), and the standard deviations must agree.  With a proposal draws are cheap, and the
chains are as long as the standard deviations and 95 % intervals of all parameters need.

An effective size alone does not say how well a chain determines these numbers: if a scatter between few runs has a wide
posterior, a bias is a mixture of narrow and wide normal distributions with a kurtosis of 30 to 100, and the standard
deviation of 12 000 independent draws has an error of 2 to 4 % instead of the 0.6 % of a normal one.  So chains go on
until the probability that any of these numbers is farther from the truth than the bars is small: the sum over all
parameters of the normal probability at their own errors (Bonferroni).  Standard deviations alone are not waited for
beyond a length: if a lognormal scatter is determined by its prior alone, the fourth moment that their error takes
settles after millions of draws.

Errors of standard deviations are those of ArviZ.  Those of the ends of 95 % intervals are √(p (1 − p)/n)/f with n the
effective size at the quantile and f the density there, from the quantiles at p/2 and 2p: the spacing of one error that
ArviZ takes varies by a fifth, and the largest of some hundred is what decides here.
"""

import math
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtri

from imubayes.foundations.tail_probabilities import normal_survival
from imubayes.inference.laplace_proposal import PARETO_K, WeighedProposal, arviz

INTERVAL = (0.025, 0.975)
SD_BAR, END_BAR = 0.05, 0.1
"""Errors that are allowed: of a standard deviation, relative; of an end, in standard deviations."""
MOST_CHANCE = 0.01
"""Probability at most that any number of a chain is beyond its bar."""
_LONGEST = 1e4


@dataclass(frozen=True)
class ChainErrors:
    """Standard errors of the numbers of D parameters.

    Attributes
    ----------
    sd : shape (D,), of the standard deviation, relative.
    end : shape (D, 2), of the ends of the 95 % interval, in standard deviations.
    """

    sd: np.ndarray
    end: np.ndarray

    def chance_beyond(self, longer: float = 1.0) -> float:
        """Return the largest probability that any number is beyond its bar, for chains `longer` times as long."""
        return self.chance_of_ends(longer) + float(2 * normal_survival(SD_BAR * np.sqrt(longer) / self.sd).sum())

    def chance_of_ends(self, longer: float = 1.0) -> float:
        """Return the largest probability that any end is beyond its bar, for chains `longer` times as long."""
        return float(2 * normal_survival(END_BAR * np.sqrt(longer) / self.end).sum())

    def longer(self) -> float:
        """Return how many times the length the chains need; at most 1 if they are long enough."""
        if not np.all(np.isfinite(self.sd)) or not np.all(np.isfinite(self.end)):
            return _LONGEST
        low, high = np.log(1 / _LONGEST), np.log(_LONGEST)
        for _ in range(40):
            middle = (low + high) / 2
            low, high = (middle, high) if self.chance_beyond(np.exp(middle)) > MOST_CHANCE else (low, middle)
        return float(np.exp(high))

    def inexact_ends(self, names: Sequence[str]) -> list[str]:
        """Return the interval whose ends are determined worst, in words, if chains are too short for intervals."""
        if self.chance_of_ends() <= MOST_CHANCE:
            return []
        of_end = self.end.max(axis=1)
        worst = int(np.argmax(np.where(np.isnan(of_end), np.inf, of_end)))
        words = f"{of_end[worst]:.2f} of its standard deviation"
        return [f"the Monte Carlo error of the 95 % interval of {names[worst]} is {words}"]


def monte_carlo_errors(flat: np.ndarray, tail: np.ndarray) -> ChainErrors:
    """Return the errors of chains (walkers, steps, D) with effective sizes (D,) at the ends of the 95 % interval."""
    dimensions = flat.shape[-1]
    spread = flat.std(axis=(0, 1))
    error = np.asarray(arviz("sampling_diagnostics").mcse(flat, chain_axis=0, draw_axis=1, method="sd"))
    return ChainErrors(error / spread, end_errors(flat.reshape(-1, dimensions), tail) / spread[:, None])


def end_errors(draws: np.ndarray, effective: np.ndarray) -> np.ndarray:
    """Return the standard errors (D, 2) of the ends of 95 % intervals, from draws (S, D) and effective sizes (D,)."""
    p = INTERVAL[0]
    outer, inner, inner_high, outer_high = np.quantile(draws, (p / 2, 2 * p, 1 - 2 * p, 1 - p / 2), axis=0)
    # p over the logarithm of its quantiles is the length of a tail that falls exponentially: 2p/(p/2) = e^(2 ln 2).
    length = np.stack([inner - outer, outer_high - inner_high], axis=-1) / (2 * np.log(2))
    return np.sqrt(p * (1 - p) / effective)[:, None] * length / p


def normal_length(dimensions: int) -> float:
    """Return the independent draws that D normal parameters need."""
    # Of a normal distribution the ends need most: √(p (1 − p))/φ(z) = 2.67.
    z = float(ndtri(1 - MOST_CHANCE / (4 * max(dimensions, 1))))
    return (2.67 * z / END_BAR) ** 2


NESTED_R_HAT, EFFECTIVE_SIZE = 1.01, 400.0
# Effective draws that each walker gives at least; one that stands still gives 1.
_PER_WALKER = 3.0
# A density may fall off exponentially in its logarithm, as that of a Cauchy distribution.  In the steps from the median
# of the log density down to its quartile, ln 2 of such a scale, so many draws go twice as far as any of them would.
_FAR_DRAWS = 1e5
# Steps that are judged, evenly spaced, of longer chains: those that need so many move little in as few as are left out.
_MOST_JUDGED = 1000
LOG_DENSITY = "the log density"
BLIND = (
    "The verdict covers only the regions that the ensembles visited: it does not see a mode that no walker came near, "
    "nor a region so narrow that no step led there."
)
"""Limits of a verdict of convergence."""
# A standard deviation that asks for more draws than this is of a parameter of which the interval shows more.
MOST_DRAWS = 100_000
# If the weights have a heavy tail a chain has to leave the place of the largest weight several times to be believed;
# above this index of the tail no practical length is enough (Vehtari et al. 2024).
WORST_PARETO_K = 0.7
# A walker stays for as many steps as the weight of its place; a chain takes so many times the largest weight.
STAYS = 3
# Standard deviations of chain and of weighted draws disagree if they differ by this share and by so many errors.
_SD_SHARE, _SD_ERRORS = 0.05, 4.5


@dataclass(frozen=True)
class Convergence:
    """Convergence of every parameter.

    Attributes
    ----------
    r_hat, ess_bulk, ess_tail : shape (D,).
    pareto_k : tail index of the importance weights of the proposal; None without one.
    converged : whether all bars are met.
    settled : whether all bars are met that more steps could meet.
    message : what is not, in one sentence; empty when converged.
    longer : how many times the length the Monte Carlo errors ask for; at most 1 if they are small enough.
    least_size, needed_size : smallest effective size of all, the log density included, and the one asked for.
    """

    r_hat: np.ndarray
    ess_bulk: np.ndarray
    ess_tail: np.ndarray
    converged: bool
    message: str
    pareto_k: float | None = None
    settled: bool = False
    longer: float = 1.0
    least_size: float = 0.0
    needed_size: float = EFFECTIVE_SIZE


def diagnose(
    chain: np.ndarray, log_density: np.ndarray, names: Sequence[str], weighed: WeighedProposal | None = None
) -> Convergence:
    """Return the verdict on chains.

    Parameters
    ----------
    chain : shape (ensembles, steps, walkers, D), burn-in removed.
    log_density : shape (ensembles, steps, walkers).
    names : of the D parameters.
    weighed : the proposal of the chains with its importance weights, if they have one.
    """
    _, steps, _, dimensions = chain.shape
    flat = _by_walker(chain)
    judged, labels = chain, [*names]
    if np.ptp(log_density) > 0:  # it is not if the density is uniform
        judged, labels = np.concatenate([chain, log_density[..., None]], axis=-1), [*names, LOG_DENSITY]
    judged = judged[:, :: math.ceil(steps / _MOST_JUDGED)]
    sizes, r_hat = _effective_sizes(judged), nested_r_hat(_halves(judged))
    needed = max(EFFECTIVE_SIZE, _PER_WALKER * len(flat))
    faults = [*_immobile(flat, log_density, names), *_strays(log_density), *_too_few(r_hat, sizes, needed, labels)]
    bulk, tail = sizes["bulk"][:dimensions], sizes["tail"][:dimensions]
    least = float(min(np.min(np.where(np.isnan(size), 0.0, size)) for size in sizes.values()))
    missed, inexact, longer = [], [], 1.0
    if weighed is not None:
        with np.errstate(divide="ignore", invalid="ignore"):
            errors = monte_carlo_errors(flat, tail)
        longer, missed = errors.longer(), _missed_tails(weighed, steps)
        inexact = errors.inexact_ends(names)
        faults += [] if missed else against_weights(chain, errors.sd, names, weighed)
    # Beyond the worst index no chain changes what the weights say of a proposal that misses tails.
    hopeless = weighed is not None and bool(missed) and weighed.pareto_k > WORST_PARETO_K
    long_enough = longer <= 1 or (not inexact and log_density.size >= MOST_DRAWS)
    settled = not faults and (hopeless or (long_enough and not missed))
    faults += inexact + missed
    message = "The sampling did not converge: " + "; ".join(faults) + "." if faults else ""
    pareto_k = None if weighed is None else weighed.pareto_k
    r_hat = r_hat[:dimensions]
    return Convergence(r_hat, bulk, tail, not faults, message, pareto_k, settled, longer, least, needed)


def _immobile(flat: np.ndarray, log_density: np.ndarray, names: Sequence[str]) -> list[str]:
    """Return what in walkers, (walkers, steps, D), has no density or did not move."""
    faults = []
    constant = np.ptp(flat.reshape(-1, flat.shape[-1]), axis=0) == 0
    if not np.all(np.isfinite(log_density)):
        faults.append("a log density is not finite")
    if constant.any():
        faults.append(f"{names[int(np.argmax(constant))]} never changed")
    stuck = (np.abs(np.diff(flat, axis=1)).sum(axis=(1, 2)) == 0) if flat.shape[1] > 1 else np.ones(len(flat), bool)
    if stuck.any():
        faults.append(f"{int(stuck.sum())} of {len(flat)} walkers never moved")
    return faults


def far_below(log_density: np.ndarray) -> float:
    """Return the log density below which no draw is expected, from those of all draws; −∞ if they do not determine it.

    A place that holds a share of the posterior, however low its density, widens the quartiles.
    """
    median, quartile = np.quantile(log_density, (0.5, 0.25))
    spread = median - quartile
    return float(median - 2 * np.log(max(_FAR_DRAWS, log_density.size)) / np.log(2) * spread) if spread > 0 else -np.inf


def _strays(log_density: np.ndarray) -> list[str]:
    """Return how many walkers began far below the bulk if none went from it; shape (ensembles, steps, walkers)."""
    far = log_density < far_below(log_density)
    entered = far[:, 1:] & ~far[:, :-1]
    strays = int(far.any(axis=1).sum())
    if not strays or entered.any():
        return []
    return [f"{strays} walkers began far below the log density of the others, and no other walker came there later"]


def _by_walker(chain: np.ndarray) -> np.ndarray:
    """Return chains (ensembles, steps, walkers, D) as one of each walker, (ensembles · walkers, steps, D)."""
    return chain.transpose(0, 2, 1, 3).reshape(-1, chain.shape[1], chain.shape[3])


def _effective_sizes(chain: np.ndarray) -> dict[str, np.ndarray]:
    """Return effective sizes (D,) of chains (ensembles, steps, walkers, D), by what they are effective for."""
    flat = _by_walker(chain)
    ess = arviz("sampling_diagnostics").ess
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        sizes = {what: np.asarray(ess(flat, chain_axis=0, draw_axis=1, method=what)) for what in ("bulk", "mean", "sd")}
        sizes["tail"] = np.asarray(ess(flat, chain_axis=0, draw_axis=1, method="tail", prob=INTERVAL))
    return sizes


def _halves(chain: np.ndarray) -> np.ndarray:
    """Return the halves of chains (ensembles, steps, …) as ensembles of their own; of short ones, the chains."""
    half = chain.shape[1] // 2
    return np.concatenate([chain[:, :half], chain[:, half : 2 * half]]) if half > 1 else chain


def _too_few(r_hat: np.ndarray, sizes: Mapping[str, np.ndarray], needed: float, names: Sequence[str]) -> list[str]:
    """Return where ensembles or their halves disagree, and where effective sizes are too small."""
    faults = []
    worst = int(np.argmax(np.where(np.isnan(r_hat), np.inf, r_hat)))
    if not r_hat[worst] <= NESTED_R_HAT:
        words = f"nested R-hat {r_hat[worst]:.3f} > {NESTED_R_HAT}"
        faults.append(f"the ensembles disagree on {names[worst]}, or with themselves later ({words})")
    for what, size in sizes.items():
        least = int(np.argmin(np.where(np.isnan(size), -np.inf, size)))
        if not size[least] >= needed:
            faults.append(f"{what} effective size of {names[least]} is {size[least]:.0f}, below {needed:.0f}")
    return faults


def _missed_tails(weighed: WeighedProposal, steps: int) -> list[str]:
    """Return what the weights of the proposal say against chains of so many steps."""
    long_enough = weighed.pareto_k <= WORST_PARETO_K and steps >= STAYS * weighed.largest
    if not weighed.heavy_tailed or long_enough:
        return []
    words = f"Pareto k {weighed.pareto_k:.2f} > {PARETO_K}, largest weight {weighed.largest:.0f}, {steps} steps"
    return [f"the proposal misses tails of the posterior ({words})"]


def against_weights(
    chain: np.ndarray, chain_error: np.ndarray, names: Sequence[str], weighed: WeighedProposal
) -> list[str]:
    """Return the standard deviation that disagrees most with that of the weighted draws of the proposal, if any does.

    Parameters
    ----------
    chain : shape (ensembles, steps, walkers, D).
    chain_error : shape (D,), relative Monte Carlo errors of the standard deviations of the chain.
    """
    _, sd, error = weighed.moments()
    with np.errstate(divide="ignore", invalid="ignore"):
        difference = chain.std(axis=(0, 1, 2)) / sd - 1
        errors = np.abs(difference) / np.hypot(error, chain_error)
    apart = (np.abs(difference) > _SD_SHARE) & (errors > _SD_ERRORS)
    worst = int(np.argmax(np.where(apart, errors, 0.0)))
    if not apart[worst]:
        return []
    words = f"is {1 + difference[worst]:.2f} of that of weighted draws"
    return [f"the standard deviation of {names[worst]} {words}"]


def nested_r_hat(chain: np.ndarray) -> np.ndarray:
    """Return nested R̂ of each parameter, shape (D,); rank-normalised, the larger of location and spread.

    Source: Margossian, Hoffman, Sountsov, Riou-Durand, Vehtari, Gelman, "Nested R̂", Bayesian Analysis 2024.
    """
    ensembles, _, walkers, _ = chain.shape
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        return np.asarray(
            arviz("sampling_diagnostics").rhat_nested(
                _by_walker(chain), superchain_ids=np.repeat(np.arange(ensembles), walkers), chain_axis=0, draw_axis=1
            )
        )

"""A campaign as the model would give it: truths from the priors, outputs with the noise that the likelihood assumes.

What is simulated here and fitted with the same model is calibrated by construction: over many seeds a 95 % interval
covers 95 % of the truths, also for what the runs do not determine.  That checks the inference; the physics is checked
by data that share no code with it (`data/generators`).

Every quantity has a random stream of its own, named after it: an effect added to the model, or a run added to the
campaign, leaves all other truths and readings as they were.
"""

import hashlib
import math
from collections.abc import Mapping
from dataclasses import dataclass, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from imubayes.errors import InputError, Issue, closest_first
from imubayes.model.bind import Model
from imubayes.model.derived_quantities import derived_quantities
from imubayes.model.noise_covariance import NoiseDistribution, Series, noise_distribution, whitener
from imubayes.model.problem import Problem, predict, prior_widths, values_of
from imubayes.parameters.vector import Layout, Parameter
from imubayes.run import Campaign
from imubayes.types import Array, Float


@dataclass(frozen=True)
class Simulated:
    """A simulated campaign with everything that is true of it.

    Attributes
    ----------
    campaign : with the simulated outputs in the place of those it came with.
    z, h : truths in z, shapes (P,) and (H,).
    parameters, derived : name → truth, in the unit of the name.
    offsets : (channel, run) → offset that all rows of the run have in common, output units.
    """

    campaign: Campaign
    z: np.ndarray
    h: np.ndarray
    parameters: dict[str, float]
    derived: dict[str, float]
    offsets: dict[tuple[str, str], float]


def simulate(model: Model, seed: int, truth: Mapping[str, float] | None = None, where: str = "truth") -> Simulated:
    """Return a simulated campaign.

    Parameters
    ----------
    model : declared on a campaign whose runs say where there are values (any finite output).
    seed : of all random numbers.
    truth : parameter name → value in the unit of its table; what is not named is drawn from its prior.
    where : place of the truths, for errors.

    Raises
    ------
    InputError
        where a name is unknown, a value is impossible under its prior, or the campaign holds a free tumble.
    """
    _refuse_tumbles(model)
    given = dict(truth or {})
    _refuse_unknown(given, model, where)
    problem = model.problem
    h = _true_z(model.hyper_layout, given, np.ones(len(model.hyper_layout)), seed, where)
    widths = np.asarray(prior_widths(problem, jnp.asarray(h)))
    z = _true_z(model.layout, given, widths, seed, where)
    clean, law, series = _expected(problem, jnp.asarray(z), jnp.asarray(h))
    observed, offsets = _with_noise(model, np.asarray(clean), law, series, seed)
    runs = tuple(replace(run, observed=one) for run, one in zip(model.campaign.runs, observed, strict=True))
    values, hyper_values = _in_si(problem, jnp.asarray(z), jnp.asarray(h))
    derived = derived_quantities(model.assembly)
    return Simulated(
        campaign=replace(model.campaign, runs=runs),
        z=z,
        h=h,
        parameters=_in_units(model.layout, values) | _in_units(model.hyper_layout, hyper_values),
        derived=dict(
            zip(
                [name.name for name in derived.names],
                map(float, _derived(derived.derivation, problem, jnp.asarray(z))),
                strict=True,
            )
        ),
        offsets=offsets,
    )


def random_stream(seed: int, name: str) -> np.random.Generator:
    """Return the random numbers of one named quantity."""
    digest = hashlib.sha256(f"{seed}/{name}".encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "little"))


@eqx.filter_jit
def _expected(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]):
    return predict(problem, z), noise_distribution(problem, h), whitener(problem, h).series


@eqx.filter_jit
def _in_si(problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]):
    return problem.priors.values(z), problem.hyper_priors.values(h)


@eqx.filter_jit
def _derived(derivation, problem: Problem, z: Float[Array, " P"]):
    return derivation(values_of(problem, z))


def _true_z(layout: Layout, given: Mapping[str, float], widths: np.ndarray, seed: int, where: str) -> np.ndarray:
    """Return the truths in z: given ones turned into z, the others drawn."""
    z, issues = np.zeros(len(layout)), []
    for place, parameter in enumerate(layout.parameters):
        if parameter.name in given:
            z[place] = _z_of(parameter, given[parameter.name])
            if not math.isfinite(z[place]):
                issues.append(_impossible(parameter, given[parameter.name], where))
        else:
            z[place] = widths[place] * random_stream(seed, parameter.name).standard_normal()
    if issues:
        raise InputError(issues)
    return z


def _z_of(parameter: Parameter, value: float) -> float:
    try:
        return float(parameter.prior.z(value * parameter.factor))
    except (ValueError, ZeroDivisionError, OverflowError):
        return math.nan


def _impossible(parameter: Parameter, value: float, where: str) -> Issue:
    return Issue(
        f"{parameter.name} = {value:g} is impossible under its prior",
        f"{where}, '{parameter.name}'",
        f"a value in {parameter.unit} that {type(parameter.prior).__name__.lower()} allows",
        "give another value, or another prior in the model file",
    )


def _with_noise(
    model: Model, clean: np.ndarray, law: NoiseDistribution, series: Series | None, seed: int
) -> tuple[list[np.ndarray], dict[tuple[str, str], float]]:
    """Return the outputs of every run, shape (R, C) each, and the offset of every run and channel."""
    entries, campaign = model.entries, model.campaign
    observed = [np.full(run.observed.shape, np.nan) for run in campaign.runs]
    offsets = {}
    deviation, common = np.sqrt(np.asarray(law.squared_scale)), np.sqrt(np.asarray(law.shared_variance))
    tail = np.zeros(len(clean)) if law.tail is None else np.asarray(law.tail)
    group = np.asarray(model.problem.observations.group)
    for one in range(len(common)):
        chosen = np.flatnonzero(group == one)
        run, channel = int(entries.run[chosen[0]]), int(entries.channel[chosen[0]])
        names = (campaign.channels[channel].name, campaign.runs[run].name)
        stream = random_stream(seed, "readings of {} in {}".format(*names))
        offset = float(common[one] * stream.standard_normal())
        alone = _in_series(series, chosen, stream.standard_normal(len(chosen)))
        far = heavy_tailed(tail[chosen], random_stream(seed, "tails of {} in {}".format(*names)))
        observed[run][entries.row[chosen], channel] = clean[chosen] + offset + deviation[chosen] * far * alone
        if common[one] > 0:
            offsets[names] = offset
    return observed, offsets


def heavy_tailed(tail: np.ndarray, stream: np.random.Generator) -> np.ndarray:
    """Return the factors that make t variables of normal ones; `tail` is one over their degrees of freedom."""
    if not tail.any():
        return np.ones(tail.shape)
    degrees = 1 / np.where(tail > 0, tail, 1.0)
    return np.where(tail > 0, np.sqrt(degrees / stream.chisquare(degrees)), 1.0)


def _in_series(series: Series | None, chosen: np.ndarray, independent: np.ndarray) -> np.ndarray:
    """Return unit noise of some entries of one run and channel, each remembering the one before it."""
    if series is None:
        return independent
    before, correlation = np.asarray(series.before)[chosen], np.asarray(series.correlation)[chosen]
    place = {int(entry): k for k, entry in enumerate(chosen)}
    following = {int(entry): k for k, entry in enumerate(before)}
    found = independent.copy()
    k = next(k for k in range(len(chosen)) if int(before[k]) not in place)
    while int(chosen[k]) in following:
        earlier, k = found[k], following[int(chosen[k])]
        found[k] = correlation[k] * earlier + math.sqrt(1 - correlation[k] ** 2) * independent[k]
    return found


def _in_units(layout: Layout, values) -> dict[str, float]:
    return dict(zip(layout.names, (np.asarray(values) / layout.factors()).tolist(), strict=True))


def _refuse_unknown(given: Mapping[str, float], model: Model, where: str) -> None:
    names = model.layout.names + model.hyper_layout.names
    unknown = [name for name in given if name not in names]
    if unknown:
        raise InputError(
            Issue(
                f"the model has no parameter '{name}'",
                f"{where}, '{name}'",
                closest_first(name, names),
                "correct the name, or add the effect to the model",
            )
            for name in unknown
        )


def _refuse_tumbles(model: Model) -> None:
    tumbles = [run.name for run in model.campaign.runs if run.tumble is not None]
    if tumbles:
        raise InputError(
            Issue(
                "a free tumble cannot be simulated: its rotations are recorded, not planned",
                f"campaign '{model.campaign.name}', run '{name}'",
                "runs on a table, thermal ramps and current injections",
                "leave the run out",
            )
            for name in tumbles
        )

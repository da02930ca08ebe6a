"""Would I have found it?  Each effect that the model lacks is planted into data simulated from the fit itself.

The campaign keeps its rows and stimulus; the outputs are those of the fitted model with the effect added, and the
fitted noise.  The model without the effect is fitted again, from where it stood, and screened as real data are.
Simulations without any effect give the rate of false alarms.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy import stats

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import searchable
from imubayes.criticism.diagnosis import Diagnosis, judge
from imubayes.criticism.warm_start import extended, whitened
from imubayes.errors import InputError, Issue
from imubayes.inference.fitted import Fitted
from imubayes.inference.posterior_mode import find_mode, message
from imubayes.model.bind import Model, bind
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import Problem, predict
from imubayes.parameters.parameter import Declared
from imubayes.run import Campaign
from imubayes.simulation.simulate import random_stream, simulate

Screen = Callable[[Fitted], Diagnosis]


@dataclass(frozen=True)
class Size:
    """How large an effect is planted.

    Attributes
    ----------
    delta_chi2 : by how much chi² would fall if the effect were added to the model.
    typical : instead, a multiple of the largest size that is met in practice.
    """

    delta_chi2: float = 50.0
    typical: float | None = None

    def __post_init__(self):
        for name, value in (("delta_chi2", self.delta_chi2), ("size", self.typical)):
            if value is not None and not (np.isfinite(value) and value > 0):
                raise InputError(
                    Issue(f"{name} = {value:g} is no size", "plant", "a number more than 0", f"correct {name}")
                )


@dataclass(frozen=True)
class Trial:
    """One effect planted.

    Attributes
    ----------
    effect : its name.
    planted : parameter name, value and unit.
    delta_chi2 : by how much chi² would fall if it were added to the model, noise aside.
    verdict, sentence, p_global : of the diagnosis.
    effects : the first group of the diagnosis.
    """

    effect: str
    planted: tuple[dict[str, Any], ...]
    delta_chi2: float
    verdict: str
    sentence: str
    p_global: float
    effects: tuple[str, ...]

    @property
    def detected(self) -> bool:
        """Whether the diagnosis said that something is wrong."""
        return self.verdict not in ("adequate", "not_converged")

    @property
    def group_first(self) -> bool:
        """Whether the first group holds the effect."""
        return self.effect in self.effects


@dataclass(frozen=True)
class Trials:
    """What was planted and what became of it.

    Attributes
    ----------
    campaign, model : names.
    size, seed : as asked.
    trials : one for each effect.
    skipped : effect → why it was not planted.
    nulls : verdicts of the simulations without any effect.
    threshold : chance of a false alarm that the screen allows.
    """

    campaign: str
    model: str
    size: Size
    seed: int
    trials: tuple[Trial, ...]
    skipped: dict[str, str]
    nulls: tuple[str, ...]
    threshold: float

    @property
    def false_alarms(self) -> int:
        """How many simulations without any effect were not found adequate."""
        return sum(verdict != "adequate" for verdict in self.nulls)

    @property
    def json(self) -> dict[str, Any]:
        """As `imubayes plant --json` prints it."""
        count, alarms = len(self.nulls), self.false_alarms
        typical = self.size.typical
        size = {"delta_chi2": self.size.delta_chi2} if typical is None else {"typical": typical}
        low = float(stats.beta.ppf(0.025, alarms, count - alarms + 1)) if alarms else 0.0
        high = float(stats.beta.ppf(0.975, alarms + 1, count - alarms)) if alarms < count else 1.0
        return {
            "format": 1,
            "campaign": self.campaign,
            "model": self.model,
            "size": size,
            "seed": self.seed,
            "effects": [
                {
                    "effect": one.effect,
                    "planted": list(one.planted),
                    "delta_chi2": one.delta_chi2,
                    "verdict": one.verdict,
                    "detected": one.detected,
                    "group_first": one.group_first,
                    "first_group": list(one.effects),
                    "p_global": one.p_global,
                    "sentence": one.sentence,
                }
                for one in self.trials
            ],
            "detected": sum(one.detected for one in self.trials),
            "group_first": sum(one.group_first for one in self.trials),
            "skipped": [{"effect": name, "reason": reason} for name, reason in self.skipped.items()],
            "null": {
                "draws": count,
                "false_alarms": alarms,
                "rate": alarms / count if count else None,
                "interval_95": [low, high] if count else None,
                "allowed": self.threshold,
            },
        }  # fmt: skip

    def __repr__(self) -> str:
        found = self.json
        return (
            f"{found['detected']} of {len(self.trials)} planted effects detected, the right group first for "
            f"{found['group_first']}; {self.false_alarms} false alarms in {len(self.nulls)} draws"
        )


def plant_effects(
    fitted: Fitted,
    effects: Sequence[str] | None,
    size: Size,
    draws: int,
    seed: int,
    tell: Callable[[str], None] = lambda text: None,
    screen: Screen = judge,
) -> Trials:
    """Plant effects one by one, and nothing at all a number of times; screen each.

    Parameters
    ----------
    fitted : the fit to simulate from.
    effects : names; all that the model lacks and could have where None.
    size : how large.
    draws : simulations without any effect.
    seed : of the simulations.
    tell : called with a short text as the work goes on.
    screen : the diagnosis.

    Raises
    ------
    InputError
        for an effect that does not exist, and for free tumbles, which cannot be simulated.
    """
    if draws < 0:
        raise InputError(Issue(f"draws = {draws}", "plant", "a number of simulations, 0 or more", "correct draws"))
    threshold, nulls, trials, skipped = 0.0, [], [], {}
    for draw in range(draws):
        tell(f"nothing planted, {draw + 1} of {draws}")
        simulated = simulate(fitted.model, _seed(seed, f"null {draw}"), _truth(fitted.model, fitted.z, fitted.h))
        found = screen(refitted(fitted, simulated.campaign))
        threshold = float(found.json.get("threshold", 0.0))
        nulls.append(found.verdict)
    names = list(effects) if effects else list(_lacking(fitted))
    clear = _Clear.of(fitted)
    for place, name in enumerate(names):
        tell(f"{name}, {place + 1} of {len(names)}")
        trial = _trial(fitted, clear, name, size, seed, screen, asked=effects is not None)
        if isinstance(trial, str):
            skipped[name] = trial
        else:
            trials.append(trial)
    campaign, model = fitted.model.campaign.name, fitted.model.spec.name
    return Trials(campaign, model, size, seed, tuple(trials), skipped, tuple(nulls), threshold)


def refitted(fitted: Fitted, campaign: Campaign) -> Fitted:
    """Return the model fitted to other outputs of the same campaign, from where it stood."""
    model = bind(fitted.model.spec, campaign, fitted.model.registry.without_files())
    mode = find_mode(model.problem, jnp.asarray(fitted.z), jnp.asarray(fitted.h))
    return Fitted(model, np.asarray(mode.z), np.asarray(mode.h), bool(mode.converged), message(mode))


def _seed(seed: int, name: str) -> int:
    return int(random_stream(seed, name).integers(2**31))


def _lacking(fitted: Fitted) -> Iterator[str]:
    there = {one.name for one in fitted.model.assembly.effects}
    for member in searchable(fitted.model.registry):
        if member.name not in there:
            yield member.name


@dataclass(frozen=True)
class _Clear:
    """What the old model can take up, projected out of a change of the prediction."""

    problem: Problem
    h: np.ndarray
    basis: np.ndarray

    @staticmethod
    def of(fitted: Fitted) -> "_Clear":
        parts = whitened(fitted.model.problem, jnp.asarray(fitted.z), jnp.asarray(fitted.h))
        _, jacobian, widths = (np.asarray(part) for part in parts)
        return _Clear(fitted.model.problem, fitted.h, np.linalg.qr(np.concatenate([jacobian, np.diag(1 / widths)]))[0])

    def chi2(self, change: np.ndarray) -> float:
        """Return what chi² would fall by if this change of the entries, (E,), were modelled."""
        column = np.asarray(_white(self.problem, jnp.asarray(change), jnp.asarray(self.h)))
        taken = self.basis[: len(column)].T @ column
        return float(column @ column - taken @ taken)


_white = eqx.filter_jit(lambda problem, change, h: whiten(problem, whitener(problem, h), change))


def _trial(fitted: Fitted, clear: _Clear, name: str, size: Size, seed: int, screen: Screen, asked: bool) -> Trial | str:
    """Return what became of one effect, or why it was not planted."""
    old = fitted.model
    spec = extended(old.spec, [name], None, old.campaign, old.registry.without_files())
    try:
        model = bind(spec, old.campaign, old.registry.without_files())
    except InputError as error:
        if asked:
            raise
        return error.issues[0].what
    shape, unit = _direction(model, old, name, seed)
    null = _carried(model, fitted, shape)
    base = np.asarray(predict(model.problem, jnp.asarray(null)))

    def strength(scale: float) -> float:
        z = _placed(model, null, unit, scale)
        return clear.chi2(np.asarray(predict(model.problem, jnp.asarray(z))) - base)

    scale = size.typical
    if scale is None:
        scale = _scaled(strength, size.delta_chi2)
        if scale is None:
            return "the model takes up all of it: no size of it could be seen in these runs"
    z = _placed(model, null, unit, scale)
    names = model.layout.names
    factors = model.layout.factors()
    values = np.asarray(model.problem.priors.values(jnp.asarray(z))) / factors
    planted = tuple(
        {"name": names[place], "value": float(values[place]), "unit": model.layout.parameters[place].unit}
        for place in (*unit, *shape)
    )
    drop = strength(scale)
    h = model.hyper_layout.carried(fitted.model.hyper_layout, fitted.h)
    simulated = simulate(model, _seed(seed, name), _truth(model, z, h))
    found = screen(refitted(fitted, simulated.campaign))
    groups = found.json.get("groups") or []
    return Trial(
        name, planted, drop, found.verdict, found.sentence, float(found.json["p_global"]),
        tuple(groups[0]["effects"]) if groups else (),
    )  # fmt: skip


def _scaled(strength: Callable[[float], float], target: float) -> float | None:
    """Return the scale at which a strength is reached; None where none of any use does."""
    scale = 1e-3
    for _ in range(thresholds.SIZING_STEPS):
        there = strength(scale)
        if not there > 1e-12 or not np.isfinite(there):
            return None
        if abs(there / target - 1) < thresholds.SIZING_TOLERANCE:
            break
        scale *= float(np.sqrt(target / there))
    return scale


def _direction(model: Model, old: Model, name: str, seed: int) -> tuple[dict[int, float], dict[int, float]]:
    """Return shape parameters (place → value in its unit) and coefficients (place → largest typical size, signed)."""
    declared = next(one.declared for one in model.assembly.effects if one.name == name)
    known, shape, unit = set(old.layout.names), {}, {}
    for place, parameter in enumerate(model.layout.parameters):
        if parameter.effect != name or parameter.name in known:
            continue
        one: Declared = declared[parameter.field]
        if one.shape:
            shape[place] = one.shape[len(one.shape) // 2]
        else:
            sign = 1.0 if random_stream(seed, f"sign of {parameter.name}").random() < 0.5 else -1.0
            unit[place] = sign * one.typical[1] if parameter.z_at(-one.typical[1]) is not None else one.typical[1]
    return shape, unit


def _carried(model: Model, fitted: Fitted, shape: dict[int, float]) -> np.ndarray:
    """Return the fit in the layout of the larger model, what is new at its null or shape."""
    declared = {one.name: one.declared for one in model.assembly.effects}
    new = np.zeros(len(model.layout))
    for place, one in enumerate(model.layout.parameters):
        null = declared[one.effect][one.field].null / one.factor
        new[place] = one.z_at(shape.get(place, null)) or 0.0
    return model.layout.carried(fitted.model.layout, fitted.z, new)


def _placed(model: Model, null: np.ndarray, unit: dict[int, float], scale: float) -> np.ndarray:
    z = null.copy()
    for place, value in unit.items():
        found = model.layout.parameters[place].z_at(scale * value)
        z[place] = z[place] if found is None else found
    return z


def _truth(model: Model, z: np.ndarray, h: np.ndarray) -> dict[str, float]:
    """Return all parameters by name, in their units."""
    values = np.asarray(model.problem.priors.values(jnp.asarray(z))) / model.layout.factors()
    hyper = np.asarray(model.problem.hyper_priors.values(jnp.asarray(h))) / model.hyper_layout.factors()
    truth = dict(zip(model.layout.names, values.tolist(), strict=True))
    return truth | dict(zip(model.hyper_layout.names, hyper.tolist(), strict=True))


__all__ = ["Size", "Trial", "Trials", "plant_effects", "refitted"]

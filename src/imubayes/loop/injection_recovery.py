"""Injection recovery: each effect that the model lacks is injected into data simulated from the fit, and looked for.

The campaign keeps its rows and stimulus; the outputs are those of the fitted model with the effect added, and the
fitted noise.  The model without the effect is refitted from where it stood, and diagnosed as real data are.
Simulations without any effect give the rate of false alarms.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.criticism.explanation_records import Verdict
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import InputError, input_error
from imubayes.foundations.progress import counted
from imubayes.foundations.records import Presented
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import whitened_columns
from imubayes.inference.posterior_mode import find_mode
from imubayes.inference.run_fit import judged_fit
from imubayes.loop.warm_start import extended, whitened
from imubayes.model.bind import Model, bind
from imubayes.model.problem import Problem, predict
from imubayes.parameters.declarations import Declared, prior_values
from imubayes.responses.candidate_effects import searchable
from imubayes.simulation.simulate import random_stream, simulate

_SIZING_STEPS, _SIZING_TOLERANCE = 6, 0.02
"""Steps to find the injected size, and relative tolerance of its Δχ².  Numerical."""

Screen = Callable[[Fit], Diagnosis]


@dataclass(frozen=True)
class Size:
    """Size of an injected effect.

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
                raise input_error(
                    f"{name} = {value:g} is not a size", "plant", "a number more than 0", f"correct {name}"
                )


@dataclass(frozen=True)
class InjectedParameter:
    """A parameter of an injected effect with its true value, in its unit."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True)
class Trial:
    """One effect injected.

    Attributes
    ----------
    effect : its name.
    planted : its parameters.
    delta_chi2 : expected drop of χ² were it added to the model, without noise.
    diagnosis : of the refit without the effect.
    """

    effect: str
    planted: tuple[InjectedParameter, ...]
    delta_chi2: float
    diagnosis: Diagnosis

    @property
    def effects(self) -> tuple[str, ...]:
        """The first group of the diagnosis."""
        return self.diagnosis.groups[0].effects if self.diagnosis.groups else ()

    @property
    def detected(self) -> bool:
        """Whether the diagnosis found the model inadequate."""
        return self.diagnosis.verdict not in ("adequate", "not_converged")

    @property
    def group_first(self) -> bool:
        """Whether the first group holds the effect."""
        return self.effect in self.effects


@dataclass(frozen=True, repr=False)
class Trials(Presented):
    """Effects injected, and what the diagnosis found.

    Attributes
    ----------
    campaign, model : names.
    size, seed : as asked.
    trials : one for each effect.
    skipped : effect → why it was not injected.
    nulls : verdicts of the simulations without any effect.
    """

    campaign: str
    model: str
    size: Size
    seed: int
    trials: tuple[Trial, ...]
    skipped: dict[str, str]
    nulls: tuple[Verdict, ...]

    @property
    def detected(self) -> int:
        """Number of effects with which the diagnosis found the model inadequate."""
        return sum(trial.detected for trial in self.trials)

    @property
    def group_first(self) -> int:
        """Number of effects that the first group holds."""
        return sum(trial.group_first for trial in self.trials)

    @property
    def false_alarms(self) -> int:
        """Number of simulations without any effect that were not found adequate."""
        return sum(verdict != "adequate" for verdict in self.nulls)

    @property
    def false_alarm_interval(self) -> tuple[float, float]:
        """The 95 % interval of the false-alarm rate (Clopper & Pearson)."""
        count, alarms = len(self.nulls), self.false_alarms
        low = float(scipy.stats.beta.ppf(0.025, alarms, count - alarms + 1)) if alarms else 0.0
        high = float(scipy.stats.beta.ppf(0.975, alarms + 1, count - alarms)) if alarms < count else 1.0
        return low, high


def plant_effects(
    fitted: Fit,
    effects: Sequence[str] | None,
    size: Size,
    draws: int,
    seed: int,
    tell: Callable[[str], None] = lambda text: None,
    screen: Screen = judge,
) -> Trials:
    """Inject effects one by one, and none a number of times; diagnose each.

    Parameters
    ----------
    fitted : the fit to simulate from.
    effects : names; all that the model lacks and could have if None.
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
        raise input_error(f"draws = {draws}", "plant", "a number of simulations, 0 or more", "correct draws")
    nulls, trials, skipped = [], [], {}
    for draw in counted(tell, "without injection", range(draws)):
        simulated = simulate(fitted.model, _seed(seed, f"null {draw}"), _truth(fitted.model, fitted.z, fitted.h))
        nulls.append(screen(refitted(fitted, simulated.campaign)).verdict)
    names = list(effects) if effects else list(_lacking(fitted))
    clear = _Clear.of(fitted)
    for name in counted(tell, "injecting effects", names):
        trial = _trial(fitted, clear, name, size, seed, screen, asked=effects is not None)
        if isinstance(trial, str):
            skipped[name] = trial
        else:
            trials.append(trial)
    campaign, model = fitted.model.campaign.name, fitted.model.spec.name
    return Trials(campaign, model, size, seed, tuple(trials), skipped, tuple(nulls))


def refitted(fitted: Fit, campaign: Campaign) -> Fit:
    """Return the model fitted to other outputs of the same campaign, from where it stood."""
    model = bind(fitted.model.spec, campaign, fitted.model.registry.without_files())
    mode = find_mode(model.problem, np.asarray(fitted.z), np.asarray(fitted.h))
    return replace(judged_fit(model, mode), mode=None)


def _seed(seed: int, name: str) -> int:
    return int(random_stream(seed, name).integers(2**31))


def _lacking(fitted: Fit) -> Iterator[str]:
    there = {effect.name for effect in fitted.model.assembly.effects}
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
    def of(fitted: Fit) -> "_Clear":
        _, jacobian, widths = whitened(fitted.model.problem, fitted.z, fitted.h)
        return _Clear(fitted.model.problem, fitted.h, np.linalg.qr(np.concatenate([jacobian, np.diag(1 / widths)]))[0])

    def chi2(self, change: np.ndarray) -> float:
        """Return what chi² would fall by if this change of the entries, (E,), were modelled."""
        column = whitened_columns(self.problem, self.h, change)
        taken = self.basis[: len(column)].T @ column
        return float(column @ column - taken @ taken)


def _trial(fitted: Fit, clear: _Clear, name: str, size: Size, seed: int, screen: Screen, asked: bool) -> Trial | str:
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
    base = np.asarray(predict(model.problem, np.asarray(null)))

    def strength(scale: float) -> float:
        z = _placed(model, null, unit, scale)
        return clear.chi2(np.asarray(predict(model.problem, np.asarray(z))) - base)

    scale = size.typical
    if scale is None:
        scale = _scaled(strength, size.delta_chi2)
        if scale is None:
            return "the model absorbs all of it: no size of it is detectable in these runs"
    z = _placed(model, null, unit, scale)
    values = np.asarray(prior_values(model.problem.priors, z)) / model.layout.factors()
    planted = tuple(
        InjectedParameter(parameter.name, float(values[place]), parameter.shown_unit)
        for place, parameter in ((place, model.layout.parameters[place]) for place in (*unit, *shape))
    )
    drop = strength(scale)
    h = model.hyper_layout.carried(fitted.model.hyper_layout, fitted.h)
    simulated = simulate(model, _seed(seed, name), _truth(model, z, h))
    return Trial(name, planted, drop, screen(refitted(fitted, simulated.campaign)))


def _scaled(strength: Callable[[float], float], target: float) -> float | None:
    """Return the scale at which a strength is reached; None if none of any use does."""
    scale = 1e-3
    for _ in range(_SIZING_STEPS):
        there = strength(scale)
        if not there > 1e-12 or not np.isfinite(there):
            return None
        if abs(there / target - 1) < _SIZING_TOLERANCE:
            break
        scale *= float(np.sqrt(target / there))
    return scale


def _direction(model: Model, old: Model, name: str, seed: int) -> tuple[dict[int, float], dict[int, float]]:
    """Return shape parameters (place → value in its unit) and coefficients (place → largest typical size, signed)."""
    declared = next(effect.declared for effect in model.assembly.effects if effect.name == name)
    known, shape, unit = set(old.layout.names), {}, {}
    for place, parameter in enumerate(model.layout.parameters):
        if parameter.effect != name or parameter.name in known:
            continue
        own: Declared = declared[parameter.field]
        if own.shape:
            shape[place] = own.shape[len(own.shape) // 2]
        else:
            sign = 1.0 if random_stream(seed, f"sign of {parameter.name}").random() < 0.5 else -1.0
            unit[place] = sign * own.typical[1] if parameter.z_at(-own.typical[1]) is not None else own.typical[1]
    return shape, unit


def _carried(model: Model, fitted: Fit, shape: dict[int, float]) -> np.ndarray:
    """Return the fit in the layout of the larger model, what is new at its null or shape."""
    declared = {effect.name: effect.declared for effect in model.assembly.effects}
    new = np.zeros(len(model.layout))
    for place, parameter in enumerate(model.layout.parameters):
        null = declared[parameter.effect][parameter.field].null / parameter.factor
        new[place] = parameter.z_at(shape.get(place, null)) or 0.0
    return model.layout.carried(fitted.model.layout, fitted.z, new)


def _placed(model: Model, null: np.ndarray, unit: dict[int, float], scale: float) -> np.ndarray:
    z = null.copy()
    for place, value in unit.items():
        found = model.layout.parameters[place].z_at(scale * value)
        z[place] = z[place] if found is None else found
    return z


def _truth(model: Model, z: np.ndarray, h: np.ndarray) -> dict[str, float]:
    """Return all parameters by name, in their units."""
    values = np.asarray(prior_values(model.problem.priors, z)) / model.layout.factors()
    hyper = np.asarray(prior_values(model.problem.hyper_priors, h)) / model.hyper_layout.factors()
    truth = dict(zip(model.layout.names, values.tolist(), strict=True))
    return truth | dict(zip(model.hyper_layout.names, hyper.tolist(), strict=True))


__all__ = ["InjectedParameter", "Size", "Trial", "Trials", "plant_effects", "refitted"]

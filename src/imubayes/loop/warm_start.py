"""A model with effects added or removed, before its fit, and the start of its refit.

The refit starts at the mode before, with one-step estimates of what is new.  The model is linearised about the mode
before.  With its columns projected out, the new coefficients follow from one small linear system (the one-step
estimate).  The Δχ² of the refit and its coefficients are predicted before it is made.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import numpy as np
from scipy.linalg import solve_triangular

from imubayes.criticism.explanation_records import CoefficientEstimate, EffectChoice
from imubayes.effects.base import MotionEffect
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import Issue, refuse
from imubayes.foundations.records import finite
from imubayes.foundations.tail_probabilities import chi2_survival, normal_survival
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import linearise, whitened_about
from imubayes.model.bind import Model, bind, dry_run
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.model.problem import Problem
from imubayes.parameters.declarations import Declared, Layout, Parameter, declared_parameters
from imubayes.parameters.priors import HalfNormal, Normal, Prior, rounded_width
from imubayes.responses.candidate_effects import fitting_channels

_NOTHING = np.zeros(0)


@dataclass(frozen=True)
class ChangedModel:
    """A model with effects added or removed, before its fit.

    Attributes
    ----------
    model : as changed, bound.
    z, h : start of the fit, shapes (P,) and (H,).
    null : shape (P,), the mode before, with the new parameters at their null values.
    new : shape (P,), True for the parameters that the model before did not have.
    added, removed : what it has more and less than the model before.
    delta_chi2 : of effects added: predicted drop of χ² at the noise scales before; None if the gradient at the null
        values vanishes, and if the linear prediction is a rise.
    coefficients : of effects added: predicted, with uncertainty; empty if the gradient vanishes.
    asked : shape (K,), estimates of the new parameters from the data alone, SI, if they contradict the prior; 0
        elsewhere.
    widened : priors that were widened for these estimates, by ``effect.parameter``, as written in a model file.
    residual, explained : shape (E,), whitened residual and the part explained by the effects added, both projected off
        the model before: the added-variable plot, of slope 1 if the prediction is right.  Empty of a removal.
    """

    model: Model
    z: np.ndarray
    h: np.ndarray
    null: np.ndarray
    new: np.ndarray
    added: tuple[EffectChoice, ...] = ()
    removed: tuple[EffectChoice, ...] = ()
    delta_chi2: float | None = None
    coefficients: tuple[CoefficientEstimate, ...] = ()
    asked: np.ndarray = field(default_factory=_NOTHING.copy)
    residual: np.ndarray = field(default_factory=_NOTHING.copy)
    explained: np.ndarray = field(default_factory=_NOTHING.copy)
    widened: Mapping[str, str] = field(default_factory=dict)


def beyond(spec: ModelSpec, other: ModelSpec) -> tuple[EffectChoice, ...]:
    """Return the effects with their channels that a model has and another one lacks."""
    known = {(each.name, each.channels) for each in other.effects}
    return tuple(
        EffectChoice(effect=each.name, channels=each.channels)
        for each in spec.effects
        if (each.name, each.channels) not in known
    )


def new_in(layout: Layout, before: Layout) -> np.ndarray:
    """Return which parameters of a layout the one before lacks, shape (P,) bool."""
    known = set(before.names)
    return np.array([name not in known for name in layout.names], dtype=bool)


_NO_GRADIENT, _SINGULAR = 1e-14, 1e-9
"""A new coefficient whose squared whitened column is below this in prior units has no gradient at its null (it enters
as β² or |β|), and combinations this much weaker than the strongest are not determined.  Numerical."""
_PRIOR_CONFLICT_SD = 3.0
"""A prior contradicts the data if the estimate lies so many standard deviations of its prior predictive distribution
from the prior mean.  Convention (0.3 %): it is widened in an addition.  Larger lets a prior decide against the data."""
REFIT_LOSS = -0.5
"""A refit that loses more χ² than this is refused: a larger model cannot fit worse but for its new priors.  Derived."""


def extended(
    spec: ModelSpec,
    effects: Sequence[str],
    channels: Sequence[str] | None,
    campaign: Campaign,
    registry: Registry,
    files: Sequence[str] = (),
) -> ModelSpec:
    """Return a model with effects appended.

    Parameters
    ----------
    spec : the model before.
    effects : names of effects or noise members.
    channels : for effects that act on channels; if None, all that the effect can act on and does not act on yet.
    campaign, registry : determine which channels these are.
    files : Python files that define effects, beside those of the model.

    Raises
    ------
    InputError
        for an effect that does not exist.
    """
    files = tuple(dict.fromkeys((*spec.files, *files)))
    known = registry.with_files(files)
    added = []
    for name in effects:
        where = f"effect to add '{name}'"
        member = known.find(name, where)
        added.append(EffectSpec(name, _channels(spec, member, channels, campaign), where=where))
    return replace(spec, effects=(*spec.effects, *added), files=files)


def _channels(
    spec: ModelSpec, member: EffectClass, channels: Sequence[str] | None, campaign: Campaign
) -> tuple[str, ...] | None:
    if issubclass(member, MotionEffect) or "closure" in member.kinds:
        return None
    fitting = fitting_channels(member, campaign)
    if channels is not None:
        # Each of several effects takes the channels of its kind; if none fits, binding the model raises.
        return tuple(name for name in channels if name in fitting) or tuple(channels)
    taken = {
        name
        for entry in spec.effects
        if entry.name == member.name
        for name in (entry.channels if entry.channels is not None else fitting)
    }
    return tuple(name for name in fitting if name not in taken) or None


def extend(
    before: Fit,
    effects: Sequence[str],
    channels: Sequence[str] | None = None,
    shape: Mapping[str, float] | None = None,
    hints: Mapping[str, float] | None = None,
    estimates: Sequence[CoefficientEstimate] = (),
    files: Sequence[str] = (),
) -> ChangedModel:
    """Return the model of a fit with effects added, and the start of its refit.

    Parameters
    ----------
    before : the fit before.
    effects, channels : what is added (see `extended`).
    shape : parameter name → value in its unit about which the model is linearised, such as a scanned time constant; a
        name without its label stands for all labels.
    hints : parameter name → start value in its unit, for coefficients and noise scales without a gradient at the null
        value.
    estimates : of new coefficients, by a diagnosis; priors are widened for these, too.
    files : Python files that define effects, beside those of the model.

    Raises
    ------
    InputError
        with everything that does not fit the campaign.
    """
    registry = before.model.registry.without_files()
    spec = extended(before.model.spec, effects, channels, before.model.campaign, registry, files)
    found = _extension(before, spec, registry, shape or {}, hints or {})
    wider = _wider(found, {estimate.name: estimate for estimate in estimates})
    if not wider:
        return found
    kept = len(spec.effects) - len(effects)
    added = [replace(entry, prior=wider.get(entry.name, {})) for entry in spec.effects[kept:]]
    spec = replace(spec, effects=(*spec.effects[:kept], *added))
    widened = {f"{name}.{field}": text for name, priors in wider.items() for field, text in priors.items()}
    return replace(_extension(before, spec, registry, shape or {}, hints or {}), widened=widened)


def _extension(
    before: Fit, spec: ModelSpec, registry: Registry, shape: Mapping[str, float], hints: Mapping[str, float]
) -> ChangedModel:
    old, model = before.model, bind(spec, before.model.campaign, registry)
    dry_run(model.problem, model.assembly.effects, spec)
    refuse(_stated_as_exact(model, len(old.spec.effects)))
    null, new = model.layout.carried(old.layout, before.z, null_point(model)), new_in(model.layout, old.layout)
    h = model.hyper_layout.carried(old.hyper_layout, before.h)
    for place in np.flatnonzero(new).tolist():
        value = _given(model.layout.parameters[place], shape)
        null[place] = null[place] if value is None else value
    for place in np.flatnonzero(new_in(model.hyper_layout, old.hyper_layout)).tolist():
        value = _given(model.hyper_layout.parameters[place], {**shape, **hints})
        h[place] = h[place] if value is None else value
    found = _first_step(model, null, h, new, hints, _without_new(before, model, new))
    return replace(found, added=beyond(model.spec, old.spec))


def _stated_as_exact(model: Model, known: int) -> Iterator[Issue]:
    """Yield complaints about effects after the known ones of which the campaign leaves no parameter uncertain."""
    uncertain = {effect.name for effect in model.assembly.effects if effect.parameters}
    for entry in model.spec.effects[known:]:
        declared = declared_parameters(model.registry.find(entry.name, entry.where))
        stated = bool(declared) and all(each.equipment for each in declared.values())
        if stated and entry.name not in uncertain:
            yield Issue(
                f"'{entry.name}' would add nothing: the campaign takes this error as exactly 0",
                entry.where,
                "an error of which the campaign states an uncertainty, or the model a prior",
                f"state the uncertainty in campaign.toml (imubayes effects {entry.name} names its parameters), or add "
                f"the effect to the model file with prior = {{ {next(iter(declared))} = … }}",
            )


def _without_new(before: Fit, model: Model, new: np.ndarray) -> float | None:
    """Return χ² of the fit before if the new effect is not null at the point of linearisation, else None.

    The width of a dead zone cannot be zero: its prior excludes that, and the model is linearised at the prior median.
    """
    acts = [each for each in _chosen(model, new) if _null(model, each) is None and not _declared(model, each).shape]
    if not acts or model.hyper_layout.names != before.model.hyper_layout.names:
        return None
    residual, _, widths = whitened(before.model.problem, before.z, before.h)
    return float(residual @ residual + np.sum((before.z / widths) ** 2))


def _wider(extension: ChangedModel, estimates: Mapping[str, CoefficientEstimate]) -> dict[str, dict[str, str]]:
    """Return wider priors, by effect and parameter, if the estimate from the data alone contradicts the prior.

    The default prior covers typical sizes.  A refit held back by it would understate an effect that the data determine.
    Priors from a certificate of the equipment are not widened.
    """
    wanted: dict[str, dict[str, str]] = {}
    parameters = _chosen(extension.model, extension.new)
    asked_of = [
        max(abs(asked), _diagnosed(parameter, estimates.get(parameter.name)))
        for parameter, asked in zip(parameters, extension.asked.tolist(), strict=True)
    ]
    # Labels share one prior: the largest estimate comes last and sets it.
    for parameter, asked in sorted(zip(parameters, asked_of, strict=True), key=lambda pair: pair[1]):
        declared = _declared(extension.model, parameter)
        family = _about_zero(parameter.prior)
        if asked and family and not declared.equipment and not declared.spread:
            width = f"{rounded_width(asked / parameter.factor):g} {parameter.unit}"
            text = f"normal(0, {width})" if family == "normal" else f"halfnormal({width})"
            wanted.setdefault(parameter.effect, {})[parameter.field] = text
    return wanted


def _diagnosed(parameter: Parameter, estimate: CoefficientEstimate | None) -> float:
    """Return the size of a diagnosed estimate, SI, if the prior contradicts it; 0 elsewhere."""
    if estimate is None or estimate.value is None or not _about_zero(parameter.prior):
        return 0.0
    spread = np.hypot(_about(parameter.prior, 0.0)[2], (estimate.sd or 0.0) * parameter.factor)
    size = abs(estimate.value * parameter.factor)
    return size if size > _PRIOR_CONFLICT_SD * spread else 0.0


def _about_zero(prior: Prior) -> Literal["normal", "halfnormal", ""]:
    """Return the family of a prior whose width alone says what is usual; empty for any other."""
    if isinstance(prior, HalfNormal):
        return "halfnormal"
    return "normal" if isinstance(prior, Normal) and float(prior.mean) == 0 else ""


def _declared(model: Model, parameter: Parameter) -> Declared:
    return next(bound.declared for bound in model.assembly.effects if bound.name == parameter.effect)[parameter.field]


def _given(parameter: Parameter, values: Mapping[str, float]) -> float | None:
    """Return z of the value given for a parameter, by its full name or without label; None if there is none."""
    value = values.get(parameter.name, values.get(f"{parameter.effect}.{parameter.field}"))
    return None if value is None else parameter.z_at(value)


def null_point(model: Model) -> np.ndarray:
    """Return z of the null value of each parameter; 0 if its prior excludes that."""
    found = [_null(model, parameter) for parameter in model.layout.parameters]
    return np.array([0.0 if z is None else z for z in found])


def _null(model: Model, parameter: Parameter) -> float | None:
    """Return z of the null value of a parameter; None if its prior excludes that."""
    return parameter.z_at(_declared(model, parameter).null / parameter.factor)


def _chosen(model: Model, new: np.ndarray) -> list[Parameter]:
    """Return the parameters at the places that are True."""
    pairs = zip(model.layout.parameters, new.tolist(), strict=True)
    return [parameter for parameter, is_new in pairs if is_new]


def whitened(problem: Problem, z: np.ndarray, h: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Return whitened residual (E,), whitened Jacobian (E, P) and prior widths (P,)."""
    return whitened_about(problem, linearise(problem, np.asarray(z)), h)


def _first_step(
    model: Model, null: np.ndarray, h: np.ndarray, new: np.ndarray, hints: Mapping[str, float], without: float | None
) -> ChangedModel:
    residual, jacobian, widths = whitened(model.problem, null, h)
    entries, count = jacobian.shape[0], int(new.sum())
    old = np.concatenate([jacobian[:, ~new], np.diag(1 / widths[~new])])
    right = np.concatenate([residual, -null[~new] / widths[~new]])
    fresh = np.concatenate([jacobian[:, new], np.zeros((int((~new).sum()), count))])
    q, upper = np.linalg.qr(old)
    across, left = fresh - q @ (q.T @ fresh), right - q @ (q.T @ right)
    squares, drive = across.T @ across, across.T @ left
    prior = np.diag(widths[new] ** -2)
    covariance = np.linalg.inv(squares + prior)
    step = covariance @ (drive - prior @ null[new])
    z = null.copy()
    z[new] += step
    z[~new] += solve_triangular(upper, q.T @ (right - fresh @ step))
    flat = np.diag(squares) < _NO_GRADIENT
    for place, blind in zip(np.flatnonzero(new).tolist(), flat.tolist(), strict=True):
        if blind:
            z[place] = _away_from_null(model, place, null[place], hints)
    tells = bool(count) and not flat.all()
    # Δχ² refers to the model before; its χ² is that at the point of linearisation if the new effect is null there.
    without = float(right @ right) if without is None else without
    drop = float(2 * drive @ step - step @ squares @ step) + without - float(left @ left)
    sd = np.sqrt(np.diag(covariance))
    if tells and flat.any():
        # A scanned time constant lies near its true value and has a gradient once its coefficient is not zero.
        z, sd, drop, flat = _second_step(model, z, h, new, (sd, drop, flat), without)
    return ChangedModel(
        model, z, h, null, new, delta_chi2=drop if tells and drop > REFIT_LOSS else None,
        coefficients=tuple(_coefficients(model.layout, z, new, sd, flat)) if tells else (),
        asked=_contradicting(_chosen(model, new), null[new], squares, drive),
        residual=left[:entries], explained=(across @ step)[:entries],
    )  # fmt: skip


def _contradicting(
    parameters: Sequence[Parameter], null: np.ndarray, squares: np.ndarray, drive: np.ndarray
) -> np.ndarray:
    """Return the estimates from the data alone, (K,) in SI, of parameters whose prior they contradict; 0 elsewhere.

    The prior predictive distribution of an estimate has the variance of the prior plus that of the estimate (Evans and
    Moshonov 2006, prior–data conflict).  Each is compared by itself, and all together by their χ² over the directions
    that the data determine: of many coefficients none may be beyond doubt alone.

    Parameters
    ----------
    parameters : the new ones, K of them.
    null : shape (K,), z about which the model is linear.
    squares, drive : shapes (K, K) and (K,), of the projected whitened columns in z.
    """
    values, axes = np.linalg.eigh(squares)
    told = values > max(_SINGULAR * float(values.max(initial=0.0)), _NO_GRADIENT)
    if not told.any():
        return np.zeros(len(parameters))
    along = (axes[:, told].T @ drive) / values[told]
    step = axes[:, told] @ along
    variance = np.sum(axes[:, told] ** 2 / values[told], axis=1)
    first, slope, width = np.array(
        [_about(parameter.prior, z) for parameter, z in zip(parameters, null, strict=True)]
    ).T
    estimate = first + slope * step
    beyond = _PRIOR_CONFLICT_SD
    alone = np.abs(estimate) > beyond * np.sqrt(width**2 + slope**2 * variance)
    score = float(np.sum((along + axes[:, told].T @ null) ** 2 / (1 + 1 / values[told])))
    together = chi2_survival(score, int(told.sum())) < 2 * normal_survival(beyond)
    return np.where(alone | (together & (np.abs(estimate) > beyond * width)), estimate, 0.0)


def _about(prior: Prior, z: float) -> tuple[float, float, float]:
    """Return value, slope by z and width of a prior at z, in SI; a width without end if it is not about zero."""
    value, slope = prior.value(np.asarray(float(z))), prior.slope(np.asarray(float(z)))
    family = _about_zero(prior)
    scale = prior.scale if isinstance(prior, HalfNormal) else prior.sd()
    return float(value), float(slope), float(scale) if family else np.inf


def _second_step(
    model: Model,
    z: np.ndarray,
    h: np.ndarray,
    new: np.ndarray,
    first: tuple[np.ndarray, float, np.ndarray],
    before: float,
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Return z, standard deviations, drop of χ² and which new parameters have no gradient, after a second step.

    All parameters are moved; if that does not reduce χ², the first step is returned.

    Parameters
    ----------
    first : standard deviations, drop, and which new parameters had no gradient.
    before : χ² of the model before.
    """

    def at(point: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        residual, jacobian, widths = whitened(model.problem, point, h)
        square = float(residual @ residual + np.sum((point / widths) ** 2) - np.sum((point[new] / widths[new]) ** 2))
        return square, residual, jacobian, widths

    square, residual, jacobian, widths = at(z)
    precision = jacobian.T @ jacobian + np.diag(widths**-2)
    further = z + np.linalg.solve(precision, jacobian.T @ residual - z / widths**2)
    reached = at(further)[0]
    if not reached < square:
        return z, *first[:2], first[2]
    sd = np.sqrt(np.diag(np.linalg.inv(precision)))[new]
    return further, sd, before - reached, np.zeros_like(first[2])


def _away_from_null(model: Model, place: int, null: float, hints: Mapping[str, float]) -> float:
    """Return the start of a parameter without gradient: as given, or the lower end of its typical range."""
    parameter = model.layout.parameters[place]
    declared = _declared(model, parameter)
    if declared.shape:
        return null  # a time constant has no gradient while its coefficient is zero, and keeps its scanned value
    hint = _given(parameter, hints)
    if hint is not None:
        return hint
    if _null(model, parameter) is None:
        return null
    least = parameter.z_at(parameter.typical[0])
    return null if least is None else least


def _coefficients(
    layout: Layout, z: np.ndarray, new: np.ndarray, sd: np.ndarray, flat: np.ndarray
) -> Iterator[CoefficientEstimate]:
    for place, width, blind in zip(np.flatnonzero(new).tolist(), sd.tolist(), flat.tolist(), strict=True):
        parameter = layout.parameters[place]
        if not blind:
            # The standard deviation in the unit: a secant over one standard deviation to each side.
            low, here, high = (parameter.value_at(z[place] + side * width) for side in (-1, 0, 1))
            spread = abs(high - low) / 2
            yield CoefficientEstimate(
                name=parameter.name,
                value=finite(here),
                sd=finite(spread),
                unit=parameter.shown_unit,
            )

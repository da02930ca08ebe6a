"""A model with one effect more, and where its fit begins: the old mode, and what the data say of the new beforehand.

About the old mode the model is linear.  With the old columns projected out, the new coefficients follow from one small
system (the score test's one-step estimate): the refit starts there, and what it was expected to find is known before.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from scipy.linalg import solve_triangular

from imubayes.array_shapes import Array, Float
from imubayes.campaign_data import Campaign
from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import fitting_channels
from imubayes.criticism.diagnosis_record import CoefficientEstimate
from imubayes.effects.base import MotionEffect
from imubayes.inference.fitted_model import Fit
from imubayes.inference.posterior_precision import Linearised, linearise
from imubayes.json_record import finite
from imubayes.model.bind import Model, bind
from imubayes.model.dry_run import dry_run
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.model_spec import EffectSpec, ModelSpec
from imubayes.model.noise_covariance import whiten, whitener
from imubayes.model.problem import Problem, prior_widths
from imubayes.model.robust_likelihood import pseudo_values
from imubayes.parameters.parameter_declarations import Declared
from imubayes.parameters.priors import Normal
from imubayes.parameters.vector import Layout, Parameter


@dataclass(frozen=True)
class Extension:
    """A model with effects added, before its fit.

    Attributes
    ----------
    model : as declared.
    z, h : where the fit begins, shapes (P,) and (H,).
    null : shape (P,), the old mode with the new parameters at their nulls.
    new : shape (P,), True for the parameters that the old model did not have.
    delta_chi2 : expected drop of chi² at the old noise scales; None where the gradient at the null does not tell.
    coefficients : expected, with uncertainty; empty where the gradient does not tell.
    asked : shape (K,), z of the new parameters that the data alone ask for, 0 where they do not say.
    widened : prior that was made wider for what the data ask for, by ``effect.parameter``, as written.
    residual, added : shape (E,), whitened residual and what the new effect would explain, both with everything taken
        out that the old model can explain: the added-variable plot, of slope 1 where the expectation is right.
    """

    model: Model
    z: np.ndarray
    h: np.ndarray
    null: np.ndarray
    new: np.ndarray
    delta_chi2: float | None
    coefficients: tuple[CoefficientEstimate, ...]
    asked: np.ndarray
    residual: np.ndarray
    added: np.ndarray
    widened: Mapping[str, str] = field(default_factory=dict)


def extended(
    spec: ModelSpec, effects: Sequence[str], channels: Sequence[str] | None, campaign: Campaign, registry: Registry
) -> ModelSpec:
    """Return a model with effects appended.

    Parameters
    ----------
    spec : the model so far.
    effects : names of effects or noise members.
    channels : for effects that act on channels; without them all that the effect can act on and has not yet.
    campaign, registry : to know which channels these are.

    Raises
    ------
    InputError
        for an effect that does not exist.
    """
    known = registry.with_files(spec.files)
    added = []
    for name in effects:
        where = f"effect to add '{name}'"
        member = known.find(name, where)
        added.append(EffectSpec(name, _channels(spec, member, channels, campaign), where=where))
    return replace(spec, effects=(*spec.effects, *added))


def _channels(
    spec: ModelSpec, member: EffectClass, channels: Sequence[str] | None, campaign: Campaign
) -> tuple[str, ...] | None:
    if issubclass(member, MotionEffect) or "closure" in member.kinds:
        return None
    fitting = fitting_channels(member, campaign)
    if channels is not None:
        # Of channels for several effects each takes its own kind; where none fits, the model's reader says so.
        return tuple(name for name in channels if name in fitting) or tuple(channels)
    taken = {
        name
        for one in spec.effects
        if one.name == member.name
        for name in (one.channels if one.channels is not None else fitting)
    }
    return tuple(name for name in fitting if name not in taken) or None


def extend(
    before: Fit,
    effects: Sequence[str],
    channels: Sequence[str] | None = None,
    shape: Mapping[str, float] | None = None,
    hints: Mapping[str, float] | None = None,
) -> Extension:
    """Return a fitted model with effects added, and where to begin its fit.

    Parameters
    ----------
    before : the fit so far.
    effects, channels : what is added (see `extended`).
    shape : parameter name → value in its unit at which the rest is expanded, such as a time constant that was
        scanned; a name without its label stands for all labels.
    hints : parameter name → first value in its unit, for coefficients and noise scales whose null has no gradient.

    Raises
    ------
    InputError
        with everything that does not fit the campaign.
    """
    registry = before.model.registry.without_files()
    spec = extended(before.model.spec, effects, channels, before.model.campaign, registry)
    found = _extension(before, spec, registry, shape or {}, hints or {})
    wider = _wider(found)
    if not wider:
        return found
    kept = len(spec.effects) - len(effects)
    added = [replace(one, prior=wider.get(one.name, {})) for one in spec.effects[kept:]]
    spec = replace(spec, effects=(*spec.effects[:kept], *added))
    widened = {f"{name}.{field}": text for name, priors in wider.items() for field, text in priors.items()}
    return replace(_extension(before, spec, registry, shape or {}, hints or {}), widened=widened)


def _extension(
    before: Fit, spec: ModelSpec, registry: Registry, shape: Mapping[str, float], hints: Mapping[str, float]
) -> Extension:
    old, model = before.model, bind(spec, before.model.campaign, registry)
    dry_run(model.problem, model.assembly.effects, spec.files)
    null, new = model.layout.carried(old.layout, before.z, _nulls(model)), _new(old.layout, model.layout)
    h = model.hyper_layout.carried(old.hyper_layout, before.h)
    for place in np.flatnonzero(new).tolist():
        value = _given(model.layout.parameters[place], shape)
        null[place] = null[place] if value is None else value
    for place in np.flatnonzero(_new(old.hyper_layout, model.hyper_layout)).tolist():
        value = _given(model.hyper_layout.parameters[place], {**shape, **hints})
        h[place] = h[place] if value is None else value
    return _first_step(model, null, h, new, hints, _without_new(before, model, new))


def _without_new(before: Fit, model: Model, new: np.ndarray) -> float | None:
    """Return χ² of the fit so far where what is new acts already where the expansion begins, None where it does not.

    The width of a dead zone cannot be zero: its prior excludes that, and the expansion begins at the prior's middle.
    """
    parameters = [one for one, is_new in zip(model.layout.parameters, new, strict=True) if is_new]
    acts = [one for one in parameters if _null(model, one) is None and not _declared(model, one).shape]
    if not acts or model.hyper_layout.names != before.model.hyper_layout.names:
        return None
    parts = whitened(before.model.problem, jnp.asarray(before.z), jnp.asarray(before.h))
    residual, _, widths = (np.asarray(part) for part in parts)
    return float(residual @ residual + np.sum((before.z / widths) ** 2))


def _wider(extension: Extension) -> dict[str, dict[str, str]]:
    """Return priors, by effect and parameter, that hold what the data ask for where the usual ones would forbid it.

    A prior says what is usual before anything was measured.  What was measured says otherwise beyond doubt here, and a
    refit held back by the prior would show that the effect is not missing.  What a certificate states stands.
    """
    wanted: dict[str, dict[str, str]] = {}
    places = np.flatnonzero(extension.new)
    # The largest comes last, and stands.
    for one in np.argsort(np.abs(extension.asked)).tolist():
        parameter, z = extension.model.layout.parameters[int(places[one])], abs(float(extension.asked[one]))
        declared = _declared(extension.model, parameter)
        about_zero = isinstance(parameter.prior, Normal) and float(parameter.prior.mean) == 0
        if z > thresholds.UNUSUAL_PRIOR_SD and about_zero and not declared.equipment and not declared.spread:
            width = _rounded_up(z * parameter.prior_sd)
            wanted.setdefault(parameter.effect, {})[parameter.field] = f"normal(0, {width:g} {parameter.unit})"
    return wanted


def _rounded_up(value: float) -> float:
    """Return the next 1, 2 or 5 times a power of ten."""
    decade = 10.0 ** np.floor(np.log10(value))
    return float(next(step * decade for step in (1, 2, 5, 10) if step * decade >= value))


def _declared(model: Model, parameter: Parameter) -> Declared:
    return next(one.declared for one in model.assembly.effects if one.name == parameter.effect)[parameter.field]


def _given(parameter: Parameter, values: Mapping[str, float]) -> float | None:
    """Return z of a value that is given by full name or without its label."""
    value = values.get(parameter.name, values.get(f"{parameter.effect}.{parameter.field}"))
    return None if value is None else parameter.z_at(value)


def _nulls(model: Model) -> np.ndarray:
    """Return z of each parameter's null, 0 where its prior excludes that."""
    found = [_null(model, one) for one in model.layout.parameters]
    return np.array([0.0 if z is None else z for z in found])


def _null(model: Model, parameter: Parameter) -> float | None:
    """Return z of a parameter's null, None where its prior excludes that."""
    return parameter.z_at(_declared(model, parameter).null / parameter.factor)


def _new(old: Layout, model: Layout) -> np.ndarray:
    """Return which places of a layout another one lacks, shape (P,) bool."""
    known = set(old.names)
    return np.array([name not in known for name in model.names], dtype=bool)


def whitened(
    problem: Problem, z: Float[Array, " P"], h: Float[Array, " H"]
) -> tuple[Float[Array, " E"], Float[Array, "E P"], Float[Array, " P"]]:
    """Return whitened residual (E,), whitened Jacobian (E, P) and prior widths (P,)."""
    return _whitened(problem, linearise(problem, z), h)


@eqx.filter_jit
def _whitened(problem: Problem, about: Linearised, h: Float[Array, " H"]):
    by = whitener(problem, h)
    residual = whiten(problem, by, pseudo_values(problem, h, about.misfit))
    return residual, whiten(problem, by, about.jacobian), prior_widths(problem, h)


def _first_step(
    model: Model, null: np.ndarray, h: np.ndarray, new: np.ndarray, hints: Mapping[str, float], without: float | None
) -> Extension:
    parts = whitened(model.problem, jnp.asarray(null), jnp.asarray(h))
    residual, jacobian, widths = (np.asarray(part) for part in parts)
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
    flat = np.diag(squares) < thresholds.NO_GRADIENT
    for place, blind in zip(np.flatnonzero(new).tolist(), flat.tolist(), strict=True):
        if blind:
            z[place] = _away_from_null(model, place, null[place], hints)
    tells = bool(count) and not flat.all()
    # Counted from χ² without what is new, which is that of the place where the expansion begins if nothing acts there.
    without = float(right @ right) if without is None else without
    drop = float(2 * drive @ step - step @ squares @ step) + without - float(left @ left)
    sd = np.sqrt(np.diag(covariance))
    if tells and flat.any():
        # A time constant that was scanned lies beside its true value: with its coefficient it has a gradient.
        z, sd, drop, flat = _second_step(model, z, h, new, (sd, drop, flat), without)
    return Extension(
        model, z, h, null, new, drop if tells else None,
        _coefficients(model.layout, z, new, sd, flat) if tells else (),
        _without_prior(squares, drive) + null[new], left[:entries], (across @ step)[:entries],
    )  # fmt: skip


def _without_prior(squares: np.ndarray, drive: np.ndarray) -> np.ndarray:
    """Return the step in z, (K,), that the data alone ask for; 0 where they say nothing beyond doubt."""
    values, axes = np.linalg.eigh(squares)
    told = values > max(thresholds.SINGULAR * float(values.max(initial=0.0)), thresholds.NO_GRADIENT)
    inverse = (axes[:, told] / values[told]) @ axes[:, told].T
    step = inverse @ drive
    return np.where(np.abs(step) > thresholds.DETERMINED_SD * np.sqrt(np.diag(inverse)), step, 0.0)


def _second_step(
    model: Model,
    z: np.ndarray,
    h: np.ndarray,
    new: np.ndarray,
    first: tuple[np.ndarray, float, np.ndarray],
    before: float,
) -> tuple[np.ndarray, np.ndarray, float, np.ndarray]:
    """Return z, the deviations and the drop of χ² after one step more of all parameters; the first where it is no gain.

    Parameters
    ----------
    first : deviations, drop and which new parameters had no gradient.
    before : χ² without what is new.
    """

    def at(point: np.ndarray) -> tuple[float, np.ndarray, np.ndarray, np.ndarray]:
        parts = whitened(model.problem, jnp.asarray(point), jnp.asarray(h))
        residual, jacobian, widths = (np.asarray(part) for part in parts)
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
    """Return where a parameter without a gradient begins: as given, or at the least that is met in practice."""
    parameter = model.layout.parameters[place]
    declared = _declared(model, parameter)
    if declared.shape:
        return null  # a time constant has no gradient while its coefficient is zero, and stands where it was put
    hint = _given(parameter, hints)
    if hint is not None:
        return hint
    if _null(model, parameter) is None:
        return null
    least = parameter.z_at(declared.typical[0])
    return null if least is None else least


def _coefficients(
    layout: Layout, z: np.ndarray, new: np.ndarray, sd: np.ndarray, flat: np.ndarray
) -> tuple[CoefficientEstimate, ...]:
    found = []
    for place, width, blind in zip(np.flatnonzero(new).tolist(), sd.tolist(), flat.tolist(), strict=True):
        parameter = layout.parameters[place]
        if not blind:
            # The width in the unit: a secant over one standard deviation to each side.
            low, here, high = (
                float(parameter.prior.value(jnp.asarray(z[place] + side * width))) for side in (-1, 0, 1)
            )
            spread = abs(high - low) / 2
            found.append(
                CoefficientEstimate(
                    name=parameter.name,
                    value=finite(here / parameter.factor),
                    sd=finite(spread / parameter.factor),
                    unit=parameter.unit,
                )
            )
    return tuple(found)

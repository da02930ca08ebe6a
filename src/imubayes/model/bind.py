"""A model bound to a campaign: which parameters there are, what they mean, and the problem as arrays.

Names end here and arrays begin.  Everything that does not fit (an unknown effect, a channel of the wrong kind, an
effect that no run can show, two that exclude each other) is collected and reported at once.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float, Scalar
from imubayes.campaign_data import Campaign
from imubayes.effects.thermometer import TemperatureOffset
from imubayes.errors import InputError, Issue, closest_first, input_error
from imubayes.gather import on_device
from imubayes.jax_settings import prepare_jax
from imubayes.model.assembly import Assembly, assemble
from imubayes.model.bound_effects import (
    BoundEffect,
    ExactEquipmentError,
    NotObservableError,
    SingleRunError,
    UnknownCovariateError,
    bind_effect,
    unknown_covariates_issue,
)
from imubayes.model.build_problem import build_problem
from imubayes.model.compile_cache_limit import clear_if_crowded
from imubayes.model.dry_run import dry_run
from imubayes.model.effect_registry import EffectClass, Registry
from imubayes.model.grouping import Grouping
from imubayes.model.hyper_prior import hyper_correlation
from imubayes.model.likelihood import log_density
from imubayes.model.model_spec import EffectSpec, ModelSpec, SingleRunEffect
from imubayes.model.nodes_and_entries import Entries, NodeTable, join_entries, join_nodes, servo_runs
from imubayes.model.noise_priors import with_noise_priors
from imubayes.model.nominal_response import is_independent
from imubayes.model.parameter_priors import stated_uncertainty
from imubayes.model.problem import Problem
from imubayes.noise.base import EntryNoise
from imubayes.parameters.vector import Layout
from imubayes.procedures import PROCEDURES

# Unknowns of the procedures themselves, added whether or not the model file lists them.
_IMPLIED_BY_TUMBLE = ("pose_attitude", "tumble_heading", "rotation_closure")
_IMPLIED_BY_SERVO = ("servo_start",)


@dataclass(frozen=True)
class Model:
    """A model bound to a campaign.

    The vector z holds all parameters θ in the order of `layout`, then all hyperparameters h of noise and learnt prior
    widths in the order of `hyper_layout`: `parameter_names` lists both.  Its components are standard normal under the
    prior; `to_units` and `from_units` convert to and from the units of the parameters.

    Attributes
    ----------
    spec, registry, campaign : what was bound.
    layout, hyper_layout : names and priors of θ and of h, in the order of the flat vectors.
    problem : the arrays.
    assembly : the effects and channels they are made from.
    left_out : effects of the model that the campaign, having one run of their channels, cannot tell.
    """

    spec: ModelSpec
    registry: Registry
    campaign: Campaign
    layout: Layout
    hyper_layout: Layout
    problem: Problem
    nodes: NodeTable
    entries: Entries
    assembly: Assembly
    left_out: tuple[SingleRunEffect, ...] = ()

    @property
    def parameter_names(self) -> tuple[str, ...]:
        """Names of the components of z, `effect.parameter[label]`: parameters, then hyperparameters."""
        return self.layout.names + self.hyper_layout.names

    @property
    def parameter_units(self) -> tuple[str, ...]:
        """Units of the components of z, in the order of `parameter_names`."""
        return tuple(p.unit for p in (*self.layout.parameters, *self.hyper_layout.parameters))

    @property
    def spec_of_known(self) -> ModelSpec:
        """The model without what was left out of it, for a campaign with more runs."""
        gone = {each.effect for each in self.left_out}
        kept = {effect.name: effect.channels for effect in self.assembly.effects if effect.left_out}
        known = (
            replace(each, channels=kept.get(each.name, each.channels))
            for each in self.spec.effects
            if each.name not in gone or each.name in kept
        )
        return replace(self.spec, effects=tuple(known))

    def log_density(self, z: Float[Array, " D"]) -> Scalar:
        """Return log p(y, z), the joint log density of data and parameters; normalised in y and z.

        A pure function of z: it can be compiled, differentiated and batched (`jax.jit`, `jax.grad`, `jax.vmap`), and
        is the density that `imubayes.fit` maximises and samples.

        Parameters
        ----------
        z : shape (D,), in the order of `parameter_names`.
        """
        count = len(self.layout)
        return log_density(self.problem, z[:count], z[count:])

    def to_units(self, z: Float[Array, " D"]) -> Float[Array, " D"]:
        """Return the parameters of z, shape (D,), in their units; compiles, differentiates and batches as well."""
        count, problem = len(self.layout), self.problem
        values = jnp.concatenate([problem.priors.values(z[:count]), problem.hyper_priors.values(z[count:])])
        return values / np.concatenate([self.layout.factors(), self.hyper_layout.factors()])

    def from_units(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return z, shape (D,), of parameters in their units; ValueError where a prior excludes a value."""
        count = len(self.layout)
        return np.concatenate([self.layout.z_of(values[:count]), self.hyper_layout.z_of(values[count:])])


def bind(spec: ModelSpec, campaign: Campaign, registry: Registry | None = None, *, single_runs: bool = False) -> Model:
    """Return a model bound to a campaign.

    Parameters
    ----------
    registry : effects by name, user effects in it are not dry-run again; by default the package's own.
    single_runs : see `imubayes.model.bound_effects.bind_effect`.

    Raises
    ------
    InputError
        with everything in the model that does not fit the campaign.
    """
    prepare_jax()
    _refuse_unknown_procedures(campaign)
    new_files = registry is None
    registry = (registry or Registry()).with_files(spec.files)
    spec = _with_implied(with_noise_priors(spec, campaign, registry), campaign, registry)
    nodes, entries = join_nodes(campaign), join_entries(campaign)
    grouping = Grouping(campaign, nodes, entries)
    effects, left_out = _bind_effects(spec, grouping, registry, single_runs)
    clear_if_crowded()  # compiled code belongs to the structure of one model, and every model bound may be another
    assembly = assemble(effects, grouping)
    problem = on_device(build_problem(assembly, hyper_correlation(spec.correlations, assembly.hyper_layout)))
    if new_files:
        dry_run(problem, effects, spec.files)
    layouts = assembly.layout, assembly.hyper_layout
    return Model(spec, registry, campaign, *layouts, problem, nodes, entries, assembly, left_out)


def _bind_effects(
    spec: ModelSpec, grouping: Grouping, registry: Registry, single_runs: bool
) -> tuple[tuple[BoundEffect, ...], tuple[SingleRunEffect, ...]]:
    """Return all effects bound to the campaign, and those left out; raises InputError with all that does not fit."""
    effects: list[BoundEffect] = []
    left_out: list[SingleRunEffect] = []
    issues: list[Issue] = []
    unknown: dict[tuple, list[UnknownCovariateError]] = {}
    for entry in spec.effects:
        try:
            bound = bind_effect(entry, grouping, registry, single_runs=single_runs)
            effects.append(bound)
            left_out += [SingleRunEffect(effect=entry.name, channels=bound.left_out)] if bound.left_out else []
        except UnknownCovariateError as error:
            # An optional one too: other runs show it, and to drop it would put its part of their outputs elsewhere.
            unknown.setdefault((error.runs, error.missing), []).append(error)
        except ExactEquipmentError:
            continue  # the effect is known to be absent
        except SingleRunError as error:
            left_out.append(SingleRunEffect(effect=entry.name, channels=error.channels))
        except NotObservableError as error:
            issues.extend(() if entry.optional else error.issues)
        except InputError as error:
            issues.extend(error.issues)
    issues.extend(
        unknown_covariates_issue([each.effect for each in errors], runs, missing, errors[0].where)
        for (runs, missing), errors in unknown.items()
    )
    issues.extend(_conflicts(effects))
    _refuse_useless(effects, issues, spec, grouping)
    return tuple(effects), tuple(left_out)


def _refuse_useless(
    effects: Sequence[BoundEffect], issues: Sequence[Issue], spec: ModelSpec, grouping: Grouping
) -> None:
    """Raise InputError with all issues, a model without noise among them, or for a model with nothing to fit."""
    found = list(issues)
    if not any(_is_independent_noise(effect.effect_class, grouping.campaign) for effect in effects):
        found.append(
            Issue(
                "the model has no noise",
                spec.where,
                "white_noise",
                'add [[effect]] name = "white_noise": without it residuals have no scale',
            )
        )
    if found:
        raise InputError(found)
    if not any(effect.parameters for effect in effects):
        raise input_error(
            "the model has no parameter to fit: it lists noise and no effect that acts in these runs",
            spec.where,
            "at least one effect, such as gyro_bias or accel_bias",
            "add an [[effect]]; `imubayes effects --for CAMPAIGN` lists those that the runs could show",
        )


def _refuse_unknown_procedures(campaign: Campaign) -> None:
    unknown = [run for run in campaign.runs if run.procedure not in PROCEDURES]
    if unknown:
        raise InputError(
            Issue(
                f"a run of procedure '{run.procedure}' cannot be fitted",
                f"campaign '{campaign.name}', run '{run.name}'",
                closest_first(run.procedure, PROCEDURES),
                "take the run out of campaign.toml, or give it the procedure that describes it",
            )
            for run in unknown
        )


def _with_implied(spec: ModelSpec, campaign: Campaign, registry: Registry) -> ModelSpec:
    """Return the model with the unknowns of the procedures themselves, and of temperatures that are stated as such."""
    names = [*(_IMPLIED_BY_TUMBLE if any(run.tumble for run in campaign.runs) else ())]
    names += _IMPLIED_BY_SERVO if servo_runs(campaign) else ()
    listed = {effect.name for effect in spec.effects}
    names += _temperature_errors(listed, campaign, registry)
    where = f"{spec.where}: implied by the campaign"
    implied = tuple(EffectSpec(name, where=where) for name in names if name not in listed)
    return replace(spec, effects=spec.effects + implied)


def _temperature_errors(listed: Collection[str], campaign: Campaign, registry: Registry) -> list[str]:
    """Return the effects of the temperatures that listed effects depend on and runs state with an uncertainty.

    To take such a temperature as exact would be silently wrong; to leave the uncertainty out of campaign.toml says so.
    """
    needed = {need for name in listed if name in registry.effects for need in registry.effects[name].needs}
    return [
        member.name
        for member in registry.effects.values()
        if issubclass(member, TemperatureOffset)
        and member.covariate in needed
        and any(stated_uncertainty(member.covariate, {"run": run.name}, campaign) for run in campaign.runs)
    ]


def _conflicts(effects: Sequence[BoundEffect]) -> list[Issue]:
    """Return complaints about effects that are listed twice or exclude each other on the same channel."""
    found = []
    for other, effect in combinations(effects, 2):
        shared = sorted(set(effect.channels) & set(other.channels))
        whole_unit = not effect.channels and not other.channels
        same = effect.name == other.name
        excluded = other.name in effect.effect_class.excludes or effect.name in other.effect_class.excludes
        if (shared or whole_unit) and (same or excluded):
            pair = f"'{effect.name}' and '{other.name}' do not go together"
            what = f"the effect '{effect.name}' is listed twice" if same else pair
            on = f" on {', '.join(shared)}" if shared else ""
            remedy = f"keep one of them, or give each its own 'channels' ({other.spec.where} is the other)"
            found.append(Issue(what + on, effect.spec.where, "one effect for each cause and channel", remedy))
    return found


def _is_independent_noise(effect_class: EffectClass, campaign: Campaign) -> bool:
    """Tell whether a member gives every reading a variance of its own."""
    return issubclass(effect_class, EntryNoise) and is_independent(effect_class, campaign)

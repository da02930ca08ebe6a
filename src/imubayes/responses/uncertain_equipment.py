"""Equipment that the campaign itself says is not exact, and that the model of a fit takes as exact.

The campaign says so by a stated uncertainty, of instruments such as the clock as well, and by gravity that is normal
gravity: that of the ellipsoid, which nobody measured at the site.  No uncertainty of the fit contains it.  Report,
export and corrected recordings do.
"""

from imubayes.inference.fitted_model import Fit
from imubayes.model.bind import Model
from imubayes.model.model_file import GRAVITY, UncertainEquipment
from imubayes.model.parameter_priors import stated_uncertainty
from imubayes.parameters.declarations import declared_parameters
from imubayes.responses.candidate_effects import Coefficient, coefficients_of, lacking_effects
from imubayes.responses.instrument_errors import instrument_errors, stated_instruments


def uncertain_equipment(fit: Fit) -> tuple[UncertainEquipment, ...]:
    """Return what the campaign of a fit says is not exact and its model takes as exact."""
    model, found = fit.model, []
    for effect in lacking_effects(fit, model.registry.of_equipment())[0]:
        assumed = effect.name == GRAVITY and model.campaign.site.has_normal_gravity
        for coefficient in coefficients_of(effect):
            own, stated = coefficient.parameter, stated_size(model, effect.name, coefficient)
            if stated or (stated is None and assumed):
                size = own.prior_sd if stated is None else stated
                found.append(
                    UncertainEquipment(
                        effect=effect.name, parameter=own.name, unit=own.shown_unit, size=size,
                        stated=stated is not None,
                    )
                )  # fmt: skip
    instruments = instrument_errors(fit, tuple(stated)) if (stated := stated_instruments(model.campaign)) else ()
    found += [
        UncertainEquipment(effect=each.effect, parameter=each.name, unit=each.unit, size=each.size, stated=True)
        for each in instruments
    ]
    return tuple(found)


def stated_size(model: Model, effect: str, coefficient: Coefficient) -> float | None:
    """Return the standard uncertainty that the campaign states of a coefficient, in its unit; None without one."""
    campaign, parameter = model.campaign, coefficient.parameter
    equipment = {"table": campaign.tables, "mounting": campaign.mountings}
    labels = {axis: coefficient.owner for axis, known in equipment.items() if coefficient.owner in known}
    declared = declared_parameters(model.registry.effects[effect])[parameter.field]
    stated = stated_uncertainty(declared.equipment, labels, campaign)
    return None if stated is None else stated / parameter.factor

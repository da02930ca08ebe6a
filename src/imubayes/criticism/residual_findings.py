"""What the residuals show, as records of a diagnosis: structure, the strongest of it, and outliers."""

from collections.abc import Sequence

import numpy as np

from imubayes.covariates import COVARIATES
from imubayes.criticism import thresholds
from imubayes.criticism.diagnosis_record import (
    Amplitude,
    CovariateLabel,
    Outlier,
    ResidualStructure,
    StrongestStructure,
)
from imubayes.criticism.formula_search import Formula, coefficient_unit, find_formula
from imubayes.criticism.free_form_dependence import Structure
from imubayes.criticism.localised_structure import STEP
from imubayes.criticism.residual_covariates import ResidualCovariate
from imubayes.criticism.search_outcome import Significant
from imubayes.criticism.stepwise_search import SearchResult
from imubayes.criticism.unexplained_structure import mostly_step, simplest
from imubayes.json_record import finite
from imubayes.model.bind import Model


def residual_structures(found: SearchResult, unexplained: Sequence[Significant]) -> tuple[ResidualStructure, ...]:
    """Return the significant structures, with a formula for each channel where no effect explains them.

    Parameters
    ----------
    unexplained : those that no effect explains; where there are none, all that are significant are returned.
    """
    channels = dict.fromkeys(structure.channel for structure, _ in unexplained)
    # What happens once in one run has no formula in what runs share.
    lasting = [name for name in channels if not mostly_step(name, unexplained)][: thresholds.MAX_FORMULAS]
    formulas = {name: find_formula(found.first.projection, found.covariates, name) for name in lasting}
    listed = simplest(unexplained or found.structures)
    return tuple(_structure(found, structure, p, formulas.get(structure.channel)) for structure, p in listed)


def _structure(found: SearchResult, structure: Structure, p: float, formula: Formula | None) -> ResidualStructure:
    plain = ResidualStructure(
        channel=structure.channel,
        covariate=" × ".join(covariate.name for covariate in structure.covariates),
        test=structure.test if structure.step else f"{structure.test} {structure.family}".strip(),
        p=found.against_budget(float(p), thresholds.FALSE_ALARM_STRUCTURE),
        step=structure.step,
        coefficient=_height(found, structure),
    )
    if formula is None or structure.step:
        return plain
    first = formula.terms[0]
    content = {
        "shape": formula.text,
        "coefficient": Amplitude(value=first.value, sd=first.sd, unit=first.unit),
        "terms": formula.terms,
        "inclusion": formula.inclusion,
        "near": formula.near,
        "kind": formula.kind,
    }
    return plain.model_copy(update=content)


def _height(found: SearchResult, structure: Structure) -> Amplitude | None:
    """Return the height of a step at the input."""
    if structure.height is None:
        return None
    campaign = found.first.projection.fitted.model.campaign
    channel = next(each for each in campaign.channels if each.name == structure.channel)
    factor, unit = coefficient_unit(channel.kind, channel.scale_si, campaign.site.gravity)
    height, sd = structure.height
    return Amplitude(value=height / factor, sd=finite(sd / factor), unit=unit)


def strongest_structure(found: SearchResult) -> StrongestStructure:
    """Return the strongest of what remains beside the effects found, or of all; a step where it is most of that."""
    structures = found.remaining or found.structures
    step = next((structure for structure, _ in structures if structure.test == STEP), None)
    if step is not None and mostly_step(step.channel, structures):
        return StrongestStructure(channel=step.channel, covariates=(), step=step.step)
    first = structures[0][0]
    return StrongestStructure(
        channel=first.channel, covariates=tuple(covariate_label(each) for each in first.covariates)
    )


def outlying_samples(found: SearchResult) -> tuple[Outlier, ...]:
    """Return the outlying samples, the farthest first."""
    model, distance = found.first.projection.fitted.model, found.outlier_sd
    runs, channels, entries = model.campaign.runs, model.campaign.channels, model.entries
    return tuple(
        Outlier(
            run=runs[entries.run[place]].name,
            channel=channels[entries.channel[place]].name,
            row=int(entries.row[place]) + 1,
            distance=float(distance[place]),
            time_s=_read(model, "time", int(place)),
            table_angle_deg=_read(model, "table_angle", int(place)),
        )
        for place in np.argsort(-np.abs(distance), kind="stable")[: np.count_nonzero(distance)]
    )


def _read(model: Model, covariate: str, place: int) -> float | None:
    """Return what the row of an entry recorded of a covariate, in the unit of its column; None where nothing."""
    run = model.campaign.runs[model.entries.run[place]]
    if covariate not in run.covariates or model.entries.closing[place]:
        return None
    value = model.campaign.as_read(run, covariate)[model.entries.row[place]]
    known = np.isfinite(value) and (run.table is not None or not covariate.startswith("table_"))
    return float(value) / COVARIATES[covariate].factor() if known else None


def covariate_label(covariate: ResidualCovariate) -> CovariateLabel:
    """Return a covariate as a diagnosis names it."""
    return CovariateLabel(name=covariate.name, unit=covariate.unit, phrase=covariate.phrase)

"""Uncertainties of the equipment that the campaign states and the model takes as exact.

The rate of a table in error is a scale factor error to every gyro on it: no residual shows it, and no interval of a
model without it includes it.  Each such uncertainty is followed through the fit: by how much it would shift the
parameters, against their standard deviations.
"""

from collections.abc import Iterator

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.candidate_effects import stated_size
from imubayes.criticism.diagnosis_record import NeglectedUncertainty
from imubayes.criticism.stepwise_search import SearchResult


def neglected_uncertainties(found: SearchResult) -> tuple[NeglectedUncertainty, ...]:
    """Return the stated uncertainties that matter beside the posterior, the worst of each effect, the largest first."""
    worst: dict[str, NeglectedUncertainty] = {}
    for each in _shifts(found):
        known = worst.get(each.effect)
        if each.in_sd >= thresholds.NEGLECTED_SHIFT and (known is None or each.in_sd > known.in_sd):
            worst[each.effect] = each
    return tuple(sorted(worst.values(), key=lambda each: -each.in_sd))


def _shifts(found: SearchResult) -> Iterator[NeglectedUncertainty]:
    """Yield each stated uncertainty of a candidate with the shift of the parameter that it moves most."""
    at = found.first.projection
    model = at.fitted.model
    for prepared in found.first.prepared:
        effect = prepared.response.scan.effect
        for place, coefficient in enumerate(prepared.response.coefficients):
            stated = stated_size(model, effect, coefficient)
            if not stated:
                continue
            shift = at.absorb(prepared.whitened[:, place]) * stated / at.posterior_sd
            most = int(np.argmax(np.abs(shift)))
            yield NeglectedUncertainty(
                effect=effect,
                parameter=coefficient.parameter.name,
                value=stated,
                unit=coefficient.parameter.shown_unit,
                shifts=model.layout.names[most],
                in_sd=float(abs(shift[most])),
            )

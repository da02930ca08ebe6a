"""Which intervals rest on the prior of a noise scale that the data do not tell.

Few runs say little of the scatter between runs.  Where their offsets are also those of a parameter, the posterior of
that parameter is a mixture of narrow and wide ones, as the prior of the scatter has it: its tails are far beyond what
its standard deviation suggests, and another prior gives another interval.
"""

import numpy as np

from imubayes.inference.fitted_model import Fit
from imubayes.inference.identifiability import WEAK_SHARE, from_data
from imubayes.results.summary import PriorScatter

# Lowest and highest fifth of the draws of a scale; a standard deviation that changes by less between them is its own.
_FIFTH, _FACTOR = 0.2, 2.0


def prior_scatter(fit: Fit) -> tuple[PriorScatter, ...]:
    """Return the noise scales known from their priors alone, with the parameters whose intervals follow them."""
    if fit.posterior is None:
        return ()
    size, points, found = len(fit.z), fit.posterior.points, []
    for place, scale in enumerate(fit.model.hyper_layout.parameters):
        draws = points[:, size + place]
        share = float(from_data(float(np.var(draws)), 1.0))
        if share >= WEAK_SHARE:
            continue
        order, count = np.argsort(draws), max(int(_FIFTH * len(draws)), 2)
        narrow, wide = (points[rows, :size].std(axis=0) for rows in (order[:count], order[-count:]))
        with np.errstate(divide="ignore", invalid="ignore"):
            factor = np.nan_to_num(wide / narrow, nan=1.0, posinf=1.0)
        chosen = [
            parameter
            for parameter in np.argsort(-factor)
            if factor[parameter] > _FACTOR and not fit.model.layout.parameters[parameter].nuisance
        ]
        if chosen:
            names = tuple(fit.model.layout.names[parameter] for parameter in chosen)
            found.append(
                PriorScatter(scale=scale.name, from_data=share, parameters=names, factor=float(factor[chosen[0]]))
            )
    return tuple(found)

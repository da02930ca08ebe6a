"""Quantities that the data determined or did not, and estimates, priors and outputs that disagree with a fit.

For a quantity the share from the data is 1 − posterior variance / prior variance.  For combinations the same number is
an eigenvalue matter: in z the prior is the unit normal, so an eigenvalue λ of the posterior precision means that the
data contributed 1 − 1/λ along its direction.  The weak directions span a space without preferred axes; they are written
in reduced echelon form, one named parameter leading each, which is how an engineer thinks of them: "this one together
with those".  Quantities that are confused with each other are found among pairs of derived ones by the same measure.

Records hold what each test procedure contributes to a quantity, estimates that no working unit can have, outputs that a
fit leaves unexplained, and estimates far from their priors.
"""

from collections.abc import Sequence
from typing import Literal

import numpy as np
from pydantic import computed_field

from imubayes.foundations.records import Record
from imubayes.procedures.fitted_terms import written


class ProcedureShare(Record):
    """Standard deviation of a quantity from the runs of one procedure alone, and without them."""

    procedure: str
    alone: float
    without: float


class Contribution(Record):
    """Posterior standard deviation of a quantity, in all and for each test procedure."""

    quantity: str
    unit: str
    sd: float
    by: tuple[ProcedureShare, ...]


WEAK_SHARE = 0.5
"""A direction is reported where the data contributed less than this share of the knowledge."""
# Members of a combination below this share of its largest are left out of its name.
_NAMED_SHARE, _MOST_NAMED, _MOST_DIRECTIONS = 0.15, 5, 12
# A pair of derived quantities is a confusion if its worst combination is this unresolved, or if the two move
# together like this, along a direction that is this unresolved.
_CONFUSED_SHARE, _CONFUSED_CORRELATION = 0.1, 0.95


class WeakDirection(Record):
    """A combination of parameters or derived quantities that the data did not determine.

    Attributes
    ----------
    quantities : names of the members, largest weight first.
    weights : of the members, in prior standard deviations, 1 for the first; empty for a confusion.
    left_out : number of further members.
    kind : ``confusion`` for two derived quantities of which the data determine a combination only.
    from_data : share of the information along the combination that came from the data.
    """

    quantities: tuple[str, ...]
    weights: tuple[float, ...] = ()
    left_out: int = 0
    kind: Literal["confusion", "combination"] = "combination"
    from_data: float

    @computed_field
    @property
    def combination(self) -> str:
        """The combination as it is written, for `summary.json`."""
        return written(self.weights, self.quantities) if self.weights else ", ".join(self.quantities)


def from_data(posterior_variance: np.ndarray | float, prior_variance: np.ndarray | float) -> np.ndarray:
    """Return 1 − posterior/prior variance, within 0 … 1."""
    with np.errstate(divide="ignore", invalid="ignore"):
        share = 1 - np.asarray(posterior_variance) / np.asarray(prior_variance)
    return np.asarray(np.clip(np.nan_to_num(share, nan=0.0), 0.0, 1.0))


def effective_parameters(precision: np.ndarray) -> float:
    """Return the number of parameters that the data determined: the sum of 1 − 1/λ."""
    return float(np.sum(1 - 1 / np.maximum(np.linalg.eigvalsh(precision), 1.0)))


def weak_directions(precision: np.ndarray, names: Sequence[str], hidden: np.ndarray) -> list[WeakDirection]:
    """Return the combinations of parameters that the data left to the prior, weakest first.

    Parameters
    ----------
    precision : shape (P, P), posterior precision in z.
    names : of the parameters.
    hidden : shape (P,), True for parameters that should not lead a combination.
    """
    values, vectors = np.linalg.eigh(precision)
    weak = vectors[:, 1 - 1 / np.maximum(values, 1.0) < WEAK_SHARE]
    if not weak.size:
        return []
    basis = _echelon(weak, hidden)
    covariance = np.linalg.inv(precision)
    found = []
    for direction in basis.T:
        share = 1 - direction @ covariance @ direction / (direction @ direction)
        found.append(_named(direction, names, float(np.clip(share, 0.0, 1.0))))
    return sorted(found, key=lambda weak: weak.from_data)[:_MOST_DIRECTIONS]


def _echelon(space: np.ndarray, hidden: np.ndarray) -> np.ndarray:
    """Return a basis of the column space in which each vector has a leading parameter of its own."""
    rest, leads = space.copy(), []
    for _ in range(space.shape[1]):
        size = np.linalg.norm(rest, axis=1) * np.where(hidden, 0.1, 1.0)
        size[leads] = -1.0
        lead = int(np.argmax(size))
        leads.append(lead)
        row = rest[lead] / np.linalg.norm(rest[lead])
        rest = rest - np.outer(rest @ row, row)
    return space @ np.linalg.inv(space[leads])


def _named(direction: np.ndarray, names: Sequence[str], share: float) -> WeakDirection:
    """Return a direction by its leading members, largest weight first."""
    order = np.argsort(-np.abs(direction))
    direction = direction / direction[order[0]]
    members = [i for i in order if abs(direction[i]) >= _NAMED_SHARE]
    shown = members[:_MOST_NAMED]
    return WeakDirection(
        quantities=tuple(str(names[member]) for member in shown),
        weights=tuple(float(f"{direction[member]:.2g}") for member in shown),
        left_out=len(members) - len(shown),
        from_data=share,
    )


def confusions(
    prior: np.ndarray,
    posterior: np.ndarray,
    along: np.ndarray,
    names: Sequence[str],
    pairs: Sequence[tuple[int, int]],
) -> list[WeakDirection]:
    """Return pairs of derived quantities that the data do not distinguish, the worst first.

    Parameters
    ----------
    prior, posterior : shape (D, D), covariances of the derived quantities to first order.
    along : shape (D,), share from the data of the direction in z along which each quantity varies a posteriori.
    names : of the derived quantities.
    pairs : which pairs to look at.
    """
    found = []
    for i, j in pairs:
        pick = np.ix_([i, j], [i, j])
        scale = np.sqrt(np.diag(prior[pick]))
        if np.any(scale <= 0):
            continue
        before, after = prior[pick] / np.outer(scale, scale), posterior[pick] / np.outer(scale, scale)
        # Worst combination: the largest of posterior over prior variance.
        root = np.linalg.cholesky(before + 1e-12 * np.eye(2))
        whitened = np.linalg.solve(root, np.linalg.solve(root, after).T)
        share = float(np.clip(1 - np.linalg.eigvalsh(whitened)[-1], 0.0, 1.0))
        correlation = after[0, 1] / np.sqrt(after[0, 0] * after[1, 1])
        if abs(correlation) > _CONFUSED_CORRELATION:
            share = min(share, float(np.clip(along[i], 0.0, 1.0)))
        if share < _CONFUSED_SHARE and np.diag(after).max() > 1e-3:
            both = (names[i], names[j])
            found.append(WeakDirection(quantities=both, kind="confusion", from_data=share))
    return sorted(found, key=lambda weak: weak.from_data)


class ImplausibleEstimate(Record):
    """An estimate that a working unit on the stated equipment cannot have.

    Attributes
    ----------
    reason : outside the domain of the parameter, or far from its prior.
    name, unit, value : of the parameter, the value being that of the posterior mode.
    lowest, highest : ends of the domain in the unit; None if the reason is another.
    prior_mean, prior_sd : median and standard deviation of the prior, in the unit; None if it has none.
    distance : of the estimate from the middle of the prior, in its standard deviations.
    """

    reason: Literal["outside_domain", "far_from_prior"]
    name: str
    unit: str
    value: float
    lowest: float | None = None
    highest: float | None = None
    prior_mean: float | None
    prior_sd: float | None
    distance: float


class UnexplainedOutput(Record):
    """A channel whose outputs the model does not describe.

    Attributes
    ----------
    channel, unit : name, and unit of the input.
    residual, within_runs : rms of the residual, in all and about its mean in each run, in the unit.
    output : rms of the outputs, in the unit.
    noise : recorded standard deviation of the rows' means, in the unit.
    """

    channel: str
    unit: str
    residual: float
    within_runs: float
    output: float
    noise: float


class PriorConflict(Record):
    """A parameter whose prior disagrees with the data.

    Attributes
    ----------
    name, unit, effect, parameter : of the parameter.
    prior_mean, prior_sd : median and standard deviation of the prior, in the unit; None if it has none.
    value, sd : posterior mode and standard deviation, in the unit.
    data_value, data_sd : estimate from the data alone, in the unit.
    distance : between prior and data, in standard deviations of their difference.
    decided_by : which of the two contributes more to the estimate.
    stated_in : place of the prior: the model file, or the equipment's uncertainty in the campaign file.
    wider : a prior that includes that estimate, as written in a model file; empty for other families.
    """

    name: str
    unit: str
    effect: str
    parameter: str
    prior_mean: float
    prior_sd: float | None
    value: float
    sd: float
    data_value: float
    data_sd: float
    distance: float
    decided_by: Literal["prior", "data"]
    stated_in: Literal["model", "campaign"]
    wider: str

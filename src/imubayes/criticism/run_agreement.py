"""Which run, or which row of one, does not agree with all others, and what would make it agree.

At the noise known before the fit every run is predicted from the others, and every row.  What is predicted wrongly is
held against each wrong input of the record: the one that explains most is corrected, the model linearised anew there,
and the search goes on until the runs agree.  Only where they do in the end is a run told to disagree: where all runs
still scatter, something is missing in the model and no run is to blame.  A quantity that acts in all runs alike, an
effect of the catalogue, goes before where it explains as much with as few parameters.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from imubayes.campaign_data import Campaign
from imubayes.criticism import thresholds
from imubayes.criticism.deletion_diagnostics import LinearFit, Score, divide, linear_fit
from imubayes.criticism.disagreement_record import DoubtedRun
from imubayes.criticism.known_noise import known_scales, largest_scatter, scales_between_runs
from imubayes.criticism.wrong_inputs import Predictions, WrongInput, problem_of, suspected
from imubayes.inference.fitted_model import Fit
from imubayes.tail_probabilities import chi2_log_survival, chi2_survival, f_log_survival, f_survival

# How many wrong inputs are linearised anew, and from which share of the gain of the best.
_REFINED, _PROMISING = 6, 0.3
_STEPS = 3


@dataclass(frozen=True)
class InputExplanation:
    """A wrong input with its size and what it explains.

    Attributes
    ----------
    size, sd : shape (d,).
    drop : of χ², the model refitted, at the noise known before.
    log_p : logarithm of the chance of that, for all that was tried.
    cost : what its sizes count against it: the logarithm of the number of outputs for each, and of what was tried.
    """

    wrong: WrongInput
    size: np.ndarray
    sd: np.ndarray
    drop: float
    log_p: float
    cost: float

    @property
    def gain(self) -> float:
        """Twice the logarithm of the evidence, roughly (Schwarz's criterion)."""
        return self.drop - self.cost


@dataclass(frozen=True)
class Disagreeing:
    """A run or row that disagrees: explanations that the data do not distinguish, the best first.

    Attributes
    ----------
    chi2, dof : what it adds to that of all others.
    others : explanations by other runs or rows.
    """

    chi2: float
    dof: int
    best: InputExplanation
    equal: tuple[InputExplanation, ...]
    others: tuple[InputExplanation, ...]


@dataclass(frozen=True)
class Agreement:
    """What disagrees, and χ² at the noise known before with the corrections.

    Attributes
    ----------
    corrected : χ² of all with the corrections, priors included.
    cost : of the corrections.
    agree : whether all runs agree with the corrections.
    """

    found: tuple[Disagreeing, ...]
    corrected: float
    cost: float
    agree: bool


@dataclass(frozen=True)
class _At:
    """A model about parameters z for the record of a campaign."""

    fitted: Fit
    campaign: Campaign
    h: np.ndarray
    z: np.ndarray
    linear: LinearFit

    @staticmethod
    def make(fitted: Fit, campaign: Campaign, h: np.ndarray, z: np.ndarray) -> "_At | None":
        problem = problem_of(fitted.model, campaign)
        if problem is None or not np.isfinite(z).all():
            return None
        found = linear_fit(fitted.model, problem, z, h)
        return _At(fitted, campaign, h, z, found) if np.isfinite(found.misfit).all() else None

    def score(self, wrong: WrongInput, weight: np.ndarray) -> Score | None:
        """Return what a wrong input explains; None where it changes nothing."""
        columns = Predictions(self.fitted.model, self.z).response(wrong, self.campaign)
        if columns is None:
            return None
        divided = divide(self.fitted.model.problem, self.h, columns)
        return self.linear.weighted_by(weight).score(columns, divided)

    def moved(self, campaign: Campaign, shift: np.ndarray) -> "_At | None":
        return _At.make(self.fitted, campaign, self.h, self.z + shift)


def known_before(fitted: Fit) -> np.ndarray:
    """Return the noise scales at which runs are judged, in z: as known beforehand, or as fitted where that is less.

    A scatter between runs that is less as fitted tells nothing: beside a gross error white noise takes it all.
    """
    known, between = known_scales(fitted, correlated=True), scales_between_runs(fitted.model)
    return np.where(between, known, np.minimum(known, np.asarray(fitted.h)))


def agreement_of_runs(fitted: Fit, linear: LinearFit, h: np.ndarray) -> Agreement:
    """Return which runs and rows of a converged fit, linear at noise scales h, do not agree with the others."""
    campaign = fitted.model.campaign
    at, found = _At(fitted, campaign, h, fitted.z, linear), []
    most = _most_wrong(len(campaign.runs))
    while len(found) < most + thresholds.MOST_WRONG_ROWS:
        one = _disagreeing(at)
        if one is None or (one.best.wrong.row is None and sum(each.best.wrong.row is None for each in found) == most):
            break
        after = _corrected(at, one.best)
        if after is None:
            break
        found.append(one)
        at = after
    cost = sum(each.best.cost for each in found)
    return Agreement(tuple(found), at.linear.chi2, cost, _agree(at.linear, largest_scatter(fitted.model)))


def _agree(linear: LinearFit, largest: np.ndarray) -> bool:
    """Whether no channel scatters more than what is known of its noise allows, (K,), as a factor."""
    ratios = linear.noise_ratios(linear.weight > 0)
    return bool(np.all(ratios <= np.where(linear.weight > 0, largest[linear.at.channel] ** 2, np.inf)))


def doubted_runs(fitted: Fit) -> tuple[DoubtedRun, ...]:
    """Return the runs that the others do not predict although they agree with one another, the least probable first."""
    if not fitted.optimised:
        return ()
    linear = linear_fit(fitted.model, fitted.model.problem, fitted.z, known_before(fitted))
    names, found = [run.name for run in fitted.model.campaign.runs], []
    largest = largest_scatter(fitted.model)
    for run, log_p in disagreeing_runs(linear).items():
        others = linear.weighted_by(np.where(linear.at.run != run, linear.weight, 0.0))
        if _agree(others, largest) and log_p < math.log(thresholds.RUN_TOLD_P):
            found.append(DoubtedRun(run=names[run], p=math.exp(log_p)))
    return tuple(sorted(found, key=lambda each: each.p))


def disagreeing_runs(linear: LinearFit) -> dict[int, float]:
    """Return the log p-value of what each run adds to the χ² of the others, corrected for the number of runs."""
    found = {}
    runs = np.unique(linear.at.run[linear.weight > 0]).tolist()
    for run in runs if len(runs) > 1 else ():
        chi2, dof, freedom = _deletion(linear, run)
        f = chi2 / max(dof, 1)
        # Where the others scatter more than was known their noise is an estimate.
        log_p = float(f_log_survival(f, dof, freedom)) if freedom else 0.0
        found[run] = log_p + np.log(len(runs))
    return found


def most_that_runs_explain(fitted: Fit, linear: LinearFit) -> float | None:
    """Return the χ² beyond its expectation of as many runs and rows as may be wrong, at known noise.

    Corrections of the same explain no more.  None where the others do not agree without them: then something is missing
    in the model.
    """
    left, allowed = linear, largest_scatter(fitted.model)[linear.at.channel] ** 2
    most, agree = 0.0, False
    for _ in range(_most_wrong(len(fitted.model.campaign.runs)) + 1):
        used = left.weight > 0
        rows = np.sort(left.row_deletions(_rows(left))[0])[-thresholds.MOST_WRONG_ROWS :].sum()
        agree |= left.chi2 - rows < max(float(allowed @ left.freedom(used)), 1.0)
        most = max(most, float(linear.chi2 - left.chi2 + rows - (linear.weight > 0).sum() + used.sum()))
        names = np.unique(left.at.run[used]).tolist()
        if len(names) < 2:
            break
        without = [left.weighted_by(np.where(left.at.run != run, left.weight, 0.0)) for run in names]
        left = min(without, key=lambda each: each.chi2 / max(float((each.weight > 0).sum()), 1.0))
    return most if agree else None


def _most_wrong(runs: int) -> int:
    """Return how many runs may be wrong: of more, the others would be."""
    return max(1, (runs - 1) // 2)


def _rows(linear: LinearFit) -> np.ndarray:
    """Number the rows of all runs that are used, (E,); what is no row is −1."""
    used = (linear.weight > 0) & (linear.at.row >= 0)
    places = np.stack([linear.at.run, linear.at.row])[:, used]
    found = np.full(len(used), -1)
    found[used] = np.unique(places, axis=1, return_inverse=True)[1].ravel()
    return found


def _deletion(linear: LinearFit, run: int) -> tuple[float, int, float]:
    """Return the χ² that a run adds to the others, its number of outputs, and degrees of freedom of the others."""
    rest = linear.without_run(run)
    own = (linear.at.run == run) & (linear.weight > 0)
    weight = rest.weight + np.where(own, _ratio_of_channels(rest, own), 0.0)
    freedom = max(float((rest.weight > 0).sum()) - len(rest.shift), 1.0)
    return max(linear.weighted_by(weight).chi2 - rest.chi2, 0.0), int(own.sum()), freedom


def _ratio_of_channels(rest: LinearFit, own: np.ndarray) -> np.ndarray:
    """Return the weight of each entry of a run, (E,): that of its channel in the other runs, or else of all."""
    used = rest.weight > 0
    found = np.full(len(own), float(np.median(rest.weight[used])) if used.any() else 1.0)
    for channel in np.unique(rest.at.channel[own]):
        same = used & (rest.at.channel == channel)
        if same.any():
            found[rest.at.channel == channel] = float(rest.weight[same][0])
    return found


def _disagreeing(at: _At) -> Disagreeing | None:
    """Return the run or row that disagrees most, with its explanations; None where all agree."""
    candidates = _screened(at)
    if not candidates:
        return None
    promising = [each[1:] for each in candidates[:_REFINED] if each[0] > _PROMISING * candidates[0][0]]
    refined = [found for each in promising if (found := _refined(at, *each)) is not None]
    refined = [each for each in refined if math.exp(each.log_p) < thresholds.DISAGREEMENT_P]
    if not refined:
        return None
    refined.sort(key=lambda each: -each.gain)
    best = refined[0]
    equal = [each for each in refined if each.gain > best.gain - thresholds.DISAGREEMENT_EQUAL]
    same = [each for each in equal if (each.wrong.run, each.wrong.row) == (best.wrong.run, best.wrong.row)]
    others = [each for each in equal if each not in same]
    return Disagreeing(*_left_out(at.linear, best), best, tuple(same), tuple(others))


def _left_out(linear: LinearFit, best: InputExplanation) -> tuple[float, int]:
    """Return what the run or row of an explanation adds to the χ² of all others, and its number of outputs."""
    if best.wrong.row is None:
        return _deletion(linear, best.wrong.run)[:2]
    own = (linear.at.run == best.wrong.run) & (linear.at.row == best.wrong.row)
    chi2, sizes = linear.row_deletions(own.astype(int) - 1)
    return float(chi2[0]), int(sizes[0])


def _screened(at: _At) -> list[tuple[float, WrongInput, np.ndarray, float]]:
    """Return gain, wrong input, the weights it is judged at and the log of the number of looks, the best first."""
    linear, campaign = at.linear, at.campaign
    runs = np.unique(linear.at.run[(linear.weight > 0) & (linear.at.row >= 0)]).tolist()
    columns = Predictions(at.fitted.model, at.z).responses_of_columns(campaign)
    found: list[tuple[float, WrongInput, np.ndarray, float]] = []
    for run in runs:
        weight = _weights(linear, run, len(runs))
        judged = linear.weighted_by(weight)
        own = (linear.at.run == run) & (linear.at.row >= 0)
        log_looks = float(np.log(sum(1 for _ in suspected(campaign, run)) * len(runs)))
        if len(runs) > 1 and _doubted(at, judged, run, columns, own):
            about = _from_the_others(at, run)
            for wrong in suspected(campaign, run):
                score = about.score(wrong, weight) if about is not None else None
                if score is not None and score.freedom:
                    found.append((score.drop - _cost(score.freedom, own, log_looks), wrong, weight, log_looks))
        found += _screened_rows(judged, run, columns)
    found.sort(key=lambda each: -each[0])
    return [each for each in found if each[0] > 0]


def _doubted(at: _At, judged: LinearFit, run: int, columns: Mapping[str, np.ndarray], own: np.ndarray) -> bool:
    """Whether a run adds more to the χ² of the others than most would, or a column of its record explains something.

    That is judged about the fit, where a wrong run has shifted the parameters, but costs no further prediction.
    """
    chi2, dof, freedom = _deletion(at.linear, run)
    if f_survival(chi2 / max(dof, 1), dof, freedom) < thresholds.DOUBTED_RUN_P:
        return True
    responses = [np.where(own, column, 0.0)[:, None] for column in columns.values()]
    responses += [
        np.where(own & (judged.at.channel == k), 1.0, 0.0)[:, None] for k in np.unique(judged.at.channel[own])
    ]
    stacked = np.concatenate(responses, axis=1)
    divided = divide(at.fitted.model.problem, at.h, stacked)
    drops = [judged.score(stacked[:, [k]], divided[:, [k]]).drop for k in range(stacked.shape[1])]
    return bool(chi2_survival(max(drops), 1) * len(drops) < thresholds.DOUBTED_RUN_P)


def _screened_rows(
    judged: LinearFit, run: int, columns: Mapping[str, np.ndarray]
) -> list[tuple[float, WrongInput, np.ndarray, float]]:
    """Return the wrong inputs of the row of a run that each column, or the outputs, explain best."""
    own = (judged.at.run == run) & (judged.at.row >= 0)
    rows = np.where(own, judged.at.row, -1)
    log_looks = float(np.log(max(own.sum(), 1) * (len(columns) + 1)))
    chi2, sizes = judged.row_deletions(rows)
    row = int(np.argmax(chi2))
    gain = float(chi2[row]) - _cost(int(sizes[row]), own, log_looks)
    found = [(gain, WrongInput(run, "output_offset", row=row), judged.weight, log_looks)]
    # No column of a row explains more than the row adds to all others.
    if chi2[row] < _cost(1, own, log_looks):
        return []
    for name, column in columns.items():
        drop, _ = judged.row_scores(np.where(own, column, 0.0), rows)
        row = int(np.argmax(drop))
        gain = float(drop[row]) - _cost(1, own, log_looks)
        found.append((gain, WrongInput(run, "offset", name, row), judged.weight, log_looks))
    return found


def _cost(freedom: int, own: np.ndarray, log_looks: float) -> float:
    return freedom * float(np.log(max(own.sum(), 2))) + 2 * log_looks


def _weights(linear: LinearFit, run: int, runs: int) -> np.ndarray:
    """Return the weights at which a run is judged: those of the noise that the others show, if it is larger."""
    if runs == 1:
        return linear.weight / linear.noise_ratios(linear.weight > 0)
    rest = linear.without_run(run)
    own = (linear.at.run == run) & (linear.weight > 0)
    return rest.weight + np.where(own, _ratio_of_channels(rest, own), 0.0)


def _from_the_others(at: _At, run: int) -> _At | None:
    """Return the model about the parameters that all other runs give: a wrong run has not shifted them."""
    return at.moved(at.campaign, at.linear.without_run(run).shift)


def _refined(at: _At, wrong: WrongInput, weight: np.ndarray, log_looks: float) -> InputExplanation | None:
    """Return a wrong input at its best size, the model and its response linearised anew there."""
    start = _from_the_others(at, wrong.run) if wrong.row is None else at
    if start is None:
        return None
    size, where, score = np.zeros(wrong.freedom(at.campaign)), start, None
    for _ in range(_STEPS):
        score = where.score(wrong, weight)
        if score is None or not score.freedom:
            return None
        size = size + score.size
        corrected = wrong.corrected(at.campaign, size)
        moved = where.moved(corrected, np.zeros(len(where.z)))
        following = None if moved is None else moved.moved(corrected, moved.linear.weighted_by(weight).shift)
        if following is None:
            return None
        where = following
    score = where.score(wrong, weight)
    if score is None or not wrong.possible(at.campaign, size):
        return None
    drop = at.linear.weighted_by(weight).chi2 - where.linear.weighted_by(weight).chi2
    # What the others show of the noise differs with the run that is left out: runs are compared at what is known.
    known = at.linear.chi2 - where.linear.weighted_by(at.linear.weight).chi2
    own = (at.linear.at.run == wrong.run) & (at.linear.at.row >= 0)
    log_p = float(chi2_log_survival(max(drop, 1e-9), score.freedom)) + log_looks
    sd = np.sqrt(np.diag(score.covariance))
    return InputExplanation(wrong, size, sd, known, log_p, _cost(score.freedom, own, log_looks))


def _corrected(at: _At, found: InputExplanation) -> _At | None:
    """Return the model for the record without a wrong input."""
    campaign = found.wrong.corrected(at.campaign, found.size)
    moved = at.moved(campaign, np.zeros(len(at.z)))
    return None if moved is None else moved.moved(campaign, moved.linear.shift)

"""A wrong record of a run, weighed against the model of the user at the noise known beforehand.

A gross error of the record distorts the parameters, so that the linear response to it about the fit leads nowhere.
Every suspected error is therefore corrected in the campaign, from several starts, and the parameters are estimated
beside it anew: the model is linear about the corrected record.  The noise of a channel is that known before the fit, or
larger if the residuals say so, which keeps what the model lacks from being reported as a wrong record.

`fit` says the most probable beside its intervals, and `diagnose` begins from it (`imubayes.criticism.evidence`).
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from imubayes.adequacy.adequacy_record import DoubtedRun
from imubayes.adequacy.deletion_diagnostics import (
    LinearFit,
    WeightedFit,
    agree,
    disagreeing_runs,
    divide,
    known_before,
    linear_fit,
    runs_apart,
)
from imubayes.adequacy.known_noise import largest_scatter
from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.covariates import COVARIATES
from imubayes.foundations.units import to_si
from imubayes.foundations.wrong_records import RATIO, WIDTHS, WrongRecord
from imubayes.inference.fitted_model import Fit
from imubayes.inference.parameter_fit import linearise
from imubayes.model.noise_covariance import noise_distribution
from imubayes.responses.wrong_inputs import Predictions, WrongInput, exchanged, of_sensors, problem_of, suspected

_WIDTHS = {"degC": WIDTHS["degC"], "rad": 1.0}
"""Standard deviations of errors of a column by its SI unit; of a ratio and of the attitude of a seat `RATIO`."""
_STARTS = {"degC": (0.0, -60.0, -25.0, 25.0, 60.0), "rad": (0.0, -1.5, 1.5, 3.0)}
"""Sizes from which the best one is looked for."""
_SIGN = -2.0  # of a factor, what reverses the sign of a column
_DOUBTED = 4
"""Runs that agree least with the others, whose records are weighed."""
_ROUNDS, _REWEIGHED = 5, 3
_FEWER, _LOG_COUNTS = 4.0, 4.0
"""Least ratio of stated to true samples that is reported, and the standard deviation of its logarithm beforehand."""
_FEW_ROWS, _TYPICAL, _ALIKE = 6, 0.15, 6.0
"""Rows of a channel that determine its scatter; least median over mean of their squares, 0.45 of white noise, below
which single rows make it; and the largest ratio of mean squares between channels.  Convention: beyond chance in 12
rows."""
_DISAGREES = math.log(0.005)
"""Log chance of what a run adds to the others, above which nothing in any record is weighed (convention)."""
_TOLD, NEAR = 10.0, 3.0
"""Log odds from which a wrong record is reported, and within which it is not distinguished from the most probable."""
_LEFT = 1e-3
"""Share of the worst ratio of χ² to degrees of freedom that a wrong record may leave of a fit that failed."""
_PRIOR_ODDS = math.log(0.05)
"""Of a wrong record in the campaign, shared by those that are weighed.  Convention, as in a diagnosis."""


@dataclass(frozen=True)
class WeighedRecord:
    """An error of the record with its size.

    Attributes
    ----------
    size, sd : what has to be added to the record, (d,), and its standard deviation.
    z : the parameters beside it, (P,).
    log_odds : natural logarithm of the odds against the record as it is.
    explains : whether with it the runs agree with one another at the noise known beforehand.
    left : largest ratio of χ² to degrees of freedom of a channel with it.
    """

    wrong: WrongInput
    size: np.ndarray
    sd: np.ndarray
    z: np.ndarray
    log_odds: float
    explains: bool
    left: float


def weighed_records(fitted: Fit) -> tuple[WeighedRecord, ...]:
    """Return the errors of the record that are likelier than the record as it is, the most probable first.

    Empty if the runs agree with one another.
    """
    return _weighed(_Weighing(fitted)) if _predicts(fitted) else ()


def _weighed(weighing: "_Weighing") -> tuple[WeighedRecord, ...]:
    told = sorted(weighing.disagreeing.items(), key=lambda each: each[1])
    doubted = [run for run, log_p in told if log_p < _DISAGREES][:_DOUBTED]
    suspects = [*_suspects(weighing.fitted, doubted)]
    each = math.log(len(suspects) or 1) - _PRIOR_ODDS
    found = [weighing.weighed(wrong) for wrong in suspects]
    odds = [replace(one, log_odds=one.log_odds - each) for one in found if one is not None]
    return tuple(sorted((one for one in odds if one.log_odds > 0), key=lambda one: -one.log_odds))


def _suspects(fitted: Fit, runs: Sequence[int]) -> Iterator[WrongInput]:
    campaign = fitted.model.campaign
    for run in runs:
        yield from (
            each for each in suspected(campaign, run) if each.form != "output_offset" or each.channel is not None
        )
        if len(campaign.runs) > 2:
            yield WrongInput(run, "unit")
        if float(np.median(campaign.runs[run].samples)) > 1:
            yield WrongInput(run, "samples")
    yield from (each for each in exchanged(campaign) if {each.run, each.other} <= {*runs})


def doubted_runs(fitted: Fit) -> tuple[DoubtedRun, ...]:
    """Return the runs that the others do not predict, and what in their record would make them agree.

    If an error of the record is likelier than the record as it is, and all runs agree with it corrected, the run of
    the most probable is reported, with what the runs cannot distinguish from it; else the runs without which the others
    agree with one another.  If they do not, something is missing in the model and no run is to blame.
    """
    if not _predicts(fitted):
        return ()
    weighing = _Weighing(fitted)
    weighed = _weighed(weighing)
    if not weighed or weighed[0].log_odds < _TOLD or not weighing.explained_by(weighed[0]):
        return runs_apart(fitted, weighing.stated, weighing.disagreeing)
    campaign, best = fitted.model.campaign, weighed[0]
    near = [each for each in weighed if each.log_odds > best.log_odds - NEAR and each.wrong.run == best.wrong.run]
    odds = np.array([each.log_odds for each in near])
    share = np.exp(odds - np.logaddexp.reduce(odds))
    causes = [wrong_record(fitted, e.wrong, e.size, e.sd, p) for e, p in zip(near, share.tolist(), strict=True)]
    log_p = weighing.disagreeing[best.wrong.run]
    return (DoubtedRun(run=campaign.runs[best.wrong.run].name, p=math.exp(log_p), causes=tuple(causes)),)


def wrong_record(fitted: Fit, wrong: WrongInput, size: np.ndarray, sd: np.ndarray, probability: float) -> WrongRecord:
    """Return an error of the record in its unit.

    Parameters
    ----------
    fitted : of the campaign as recorded.
    size, sd : what has to be added to the record, (d,), and its standard deviation.
    probability : among all wrong inputs.
    """
    campaign = fitted.model.campaign
    if wrong.form == "prior":
        return _narrow_prior(fitted, wrong, size, sd, probability)
    run = campaign.runs[wrong.run]
    recorded: float | None = None
    kind = "" if wrong.channel is None else campaign.channels[wrong.channel].kind
    if wrong.form == "samples":
        recorded = float(np.median(run.samples))
        # The size is a ratio.
        quantity, unit, factor, size = "samples", "1", 1 / recorded, size - 1
    elif wrong.form in ("exchange", "unit"):
        quantity = COVARIATES[wrong.covariate].column if wrong.covariate else "unit"
        unit, recorded, factor = "1", 0.0, 1.0
    elif wrong.form.endswith("factor"):
        quantity = COVARIATES[wrong.covariate].column if wrong.covariate else _outputs(campaign, wrong)
        unit, recorded, factor = "1", 1.0, 1.0
    elif wrong.form == "seat":
        quantity, unit, recorded, factor = "mounting", "arcmin", 0.0, to_si("arcmin")
    elif wrong.covariate:
        column = COVARIATES[wrong.covariate]
        values = campaign.as_read(run, wrong.covariate)
        quantity, unit, factor = column.column, column.unit, column.factor(campaign.site.gravity)
        recorded = float(np.nanmean(values) if wrong.row is None else values[wrong.row]) / factor
    else:
        # The outputs of all channels, or of one.
        channel = campaign.channels[wrong.channel or 0]
        quantity = _outputs(campaign, wrong)
        unit, recorded, factor = channel.output_unit, 0.0, 1.0
    return WrongRecord(
        run=run.name, row=None if wrong.row is None else wrong.row + 1, kind=kind, about=_about(campaign, wrong),
        form=wrong.form, quantity=quantity, unit=unit, recorded=recorded,
        agreeing=tuple((recorded + size / factor).tolist()), sd=tuple((sd / abs(factor)).tolist()),
        probability=probability, other="" if wrong.other is None else campaign.runs[wrong.other].name,
    )  # fmt: skip


def _about(campaign: Campaign, wrong: WrongInput) -> float:
    """Return the offset that a factor on the outputs of one channel leaves as it is; 0 of all else."""
    of_outputs = wrong.form == "output_factor" and wrong.channel is not None
    return campaign.channels[wrong.channel or 0].offset if of_outputs else 0.0


def _narrow_prior(fitted: Fit, wrong: WrongInput, size: np.ndarray, sd: np.ndarray, probability: float) -> WrongRecord:
    """Return the parameter that is farthest off a prior that is too narrow, in its standard deviations."""
    # The estimate of the fit, which its summary states as well; elsewhere that beside which nothing is left.
    places = list(wrong.parameters)
    off = np.asarray(fitted.z)[places]
    off = off if np.abs(off).max() > np.abs(size).max() / 3 else off + size
    farthest = int(np.argmax(np.abs(off)))
    return WrongRecord(
        form="prior", quantity=fitted.model.layout.parameters[places[farthest]].name, unit="1", recorded=0.0,
        agreeing=(float(off[farthest]),), sd=(float(sd[farthest]),), probability=probability,
    )  # fmt: skip


def _outputs(campaign: Campaign, wrong: WrongInput) -> str:
    return "outputs" if wrong.channel is None else campaign.channels[wrong.channel].name


def _predicts(fitted: Fit) -> bool:
    """Return whether the model has numbers where records are weighed: one whose fit failed may have none anywhere."""
    if fitted.optimised:
        return True
    about = linearise(fitted.model.problem, np.zeros(len(fitted.z)))
    return all(np.isfinite(np.asarray(each)).all() for each in (about.misfit, about.jacobian, fitted.h))


class _Weighing:
    """The evidence of the campaign of a fit, as recorded and corrected.

    If a fit failed, its parameters say nothing: the model is linear about the centres of the priors instead.
    """

    def __init__(self, fitted: Fit):
        self.optimised = fitted.optimised
        fitted = fitted if fitted.optimised else replace(fitted, z=np.zeros(len(fitted.z)))
        self.fitted, self.model, self.h = fitted, fitted.model, known_before(fitted)
        self.stated = linear_fit(self.model, self.model.problem, fitted.z, self.h)
        self.disagreeing = disagreeing_runs(self.stated)
        whole, self.as_recorded = _evidence(self.stated)
        self.worst = _worst(whole)
        self.largest = largest_scatter(fitted.model)

    def explained_by(self, found: WeighedRecord) -> bool:
        """Return whether all runs agree with a record corrected.

        A fit that failed is at values that no unit has, whatever the model lacks: there the record explains what it
        takes away nearly all of.
        """
        return found.explains or (not self.optimised and found.left < _LEFT * self.worst)

    def _noise(self, entries: np.ndarray) -> np.ndarray:
        """Return the noise of entries as known beforehand, output units, but for what their run shares."""
        return np.sqrt(noise_distribution(self.model.problem, self.h).squared_scale[entries])

    def weighed(self, wrong: WrongInput) -> WeighedRecord | None:
        """Return an error of the record at its best size; None if it explains nothing."""
        if wrong.form == "unit":
            return self._of_other_unit(wrong)
        if wrong.form == "samples":
            return self._of_samples(wrong)
        if wrong.channel is not None:
            return self._of_one_output(wrong)
        z = np.asarray(self.fitted.z)
        starts = [self._at(wrong, size, z, free=False) for size in self._starts(wrong)]
        known = [each for each in starts if each is not None]
        best = max(known, key=lambda each: each.log_odds, default=None)
        for _ in range(_ROUNDS):
            further = self._at(wrong, best.size, best.z, free=True) if best is not None else None
            if best is None or further is None or not wrong.possible(further.size):
                break
            settled = bool(np.all(np.abs(further.size - best.size) < 0.1 * further.sd))
            best = further
            if settled:
                break
        return best if best is not None and len(best.sd) else None

    def _starts(self, wrong: WrongInput) -> list[np.ndarray]:
        if wrong.form == "exchange":
            return [np.ones(1)]
        freedom = wrong.freedom(self.model.campaign)
        if wrong.form == "offset":
            return [np.array([size]) for size in _STARTS.get(COVARIATES[wrong.covariate].si, (0.0,))]
        return [np.zeros(freedom), *([np.array([_SIGN])] if wrong.form.endswith("factor") else [])]

    def _width(self, wrong: WrongInput) -> float:
        return _WIDTHS.get(COVARIATES[wrong.covariate].si, RATIO) if wrong.form == "offset" else RATIO

    def _at(self, wrong: WrongInput, size: np.ndarray, z: np.ndarray, free: bool) -> WeighedRecord | None:
        """Return the record corrected by about a size, which is estimated beside parameters near z if it is free."""
        campaign = wrong.corrected(self.model.campaign, size)
        problem = problem_of(self.model, campaign)
        if problem is None:
            return None
        linear = linear_fit(self.model, problem, z, self.h)
        count = len(linear.precision)
        if not np.isfinite(linear.misfit).all():
            return None
        if free:
            response = Predictions(self.model, z).response(wrong, campaign)
            if response is None:
                return None
            # Of an exchange 1 is the name, and the estimate determines whether it is one.
            centre = 1.0 if wrong.form == "exchange" else 0.0
            linear = _beside(linear, divide(problem, self.h, response), response, self._width(wrong), centre - size)
        fit, evidence = _evidence(linear)
        sd = np.sqrt(np.diag(np.linalg.inv(fit.whole)))[count:]
        moved = fit.shift[count:] if free else np.zeros(len(size))
        return WeighedRecord(
            wrong,
            size + moved,
            sd,
            z + fit.shift[:count],
            evidence - self.as_recorded,
            agree(fit, self.largest),
            _worst(fit),
        )

    def _of_other_unit(self, wrong: WrongInput) -> WeighedRecord:
        own = of_sensors(self.model)
        here = (self.stated.run == wrong.run)[:, None]
        response, weighted = self.stated.jacobian[:, own] * here, self.stated.weighted[:, own] * here
        return self._linearly(wrong, _beside(self.stated, weighted, response, math.sqrt(2.0), np.zeros(len(own))))

    def _of_samples(self, wrong: WrongInput) -> WeighedRecord | None:
        """Return that rows are means of fewer samples than stated: the noise of the run is larger by one ratio.

        None if it is not white, or not alike on all channels: something else makes it.
        """
        here, ratio = self.stated.runs[wrong.run], 1.0
        fit, evidence, chi2 = self._at_fewer_samples(here, ratio)
        for _ in range(_ROUNDS):
            ratio = len(here) / max(chi2, float(np.finfo(float).tiny))
            fit, evidence, chi2 = self._at_fewer_samples(here, ratio)
        if ratio > 1 / _FEWER or not self._alike_in_all_rows(here, fit):
            return None
        sd = math.sqrt(2 / len(here))
        evidence += 0.5 * len(here) * math.log(ratio) + math.log(min(sd / _LOG_COUNTS, 1.0))
        size = np.array([ratio])
        odds, agrees = evidence - self.as_recorded, agree(fit, self.largest)
        return WeighedRecord(wrong, size, sd * size, self.fitted.z + fit.shift, odds, agrees, _worst(fit))

    def _alike_in_all_rows(self, here: np.ndarray, fit: WeightedFit) -> bool:
        """Whether the rows of a run scatter about their mean as white noise does, and on all channels alike."""
        linear, means = self.stated, list[float]()
        left = linear.misfit[here] - linear.jacobian[here] @ fit.shift
        for k in np.unique(linear.channel[here]).tolist():
            own, known = left[linear.channel[here] == k], self._noise(here[linear.channel[here] == k])
            if len(own) >= _FEW_ROWS:
                squares = ((own - own.mean()) / known) ** 2
                means.append(float(squares.mean()))
                if np.median(squares) < _TYPICAL * means[-1]:
                    return False
        return bool(means) and max(means) < _ALIKE * min(means)

    def _at_fewer_samples(self, here: np.ndarray, ratio: float) -> tuple[WeightedFit, float, float]:
        """Return the fit with the precision of some entries times a ratio, its evidence, and their χ² as known."""
        linear = self.stated
        fit, evidence = _evidence(_noisier(linear, here, ratio))
        left = linear.misfit[here] - linear.jacobian[here] @ fit.shift
        return fit, evidence, float(left @ (linear.pulled[here] - linear.weighted[here] @ fit.shift))

    def _of_one_output(self, wrong: WrongInput) -> WeighedRecord:
        """Return what is wrong with one channel in a run, to which its outputs respond linearly.

        A reversed sign is far from the record: the outputs are reversed, and the factor is estimated from there.
        """
        campaign = self.model.campaign
        response = Predictions(self.model, np.asarray(self.fitted.z)).response(wrong, campaign)
        assert response is not None  # outputs always have one
        width = RATIO
        if wrong.form == "output_offset":
            known = np.concatenate([run.observed[:, wrong.channel] for run in campaign.runs])
            width *= float(np.nanmax(np.abs(known - campaign.channels[wrong.channel or 0].offset))) or 1.0
        weighted = divide(self.model.problem, self.h, response)
        about = [self._linearly(wrong, _beside(self.stated, weighted, response, width, np.zeros(1)))]
        if wrong.form == "output_factor" and (reversed_ := self._reversed(wrong)) is not None:
            # Outputs respond to a factor by what is predicted over the factor about which they stand.
            beside = _beside(reversed_, -weighted, -response, width, np.array([-_SIGN]))
            found = self._linearly(wrong, beside)
            about.append(replace(found, size=found.size + _SIGN))
        return max(
            (each for each in about if wrong.possible(each.size)), key=lambda each: each.log_odds, default=about[0]
        )

    def _reversed(self, wrong: WrongInput) -> LinearFit | None:
        """Return the fit as linearised, with the outputs concerned reversed; None if the nodes are not the same."""
        problem = problem_of(self.model, wrong.corrected(self.model.campaign, np.array([_SIGN])))
        if problem is None:
            return None
        moved = np.asarray(problem.observations.value) - np.asarray(self.model.problem.observations.value)
        pulled = self.stated.pulled + divide(self.model.problem, self.h, moved[:, None])[:, 0]
        return replace(self.stated, misfit=self.stated.misfit + moved, pulled=pulled)

    def _linearly(self, wrong: WrongInput, linear: LinearFit) -> WeighedRecord:
        fit, evidence = _evidence(linear)
        count = len(self.stated.precision)
        z, size = self.fitted.z + fit.shift[:count], fit.shift[count:]
        sd = np.sqrt(np.diag(np.linalg.inv(fit.whole)))[count:]
        odds, agrees = evidence - self.as_recorded, agree(fit, self.largest)
        return WeighedRecord(wrong, size, sd, z, odds, agrees, _worst(fit))


def _worst(fit: WeightedFit) -> float:
    """Return the largest ratio of χ² to degrees of freedom of a channel."""
    return float(fit.noise_ratios.max())


def _noisier(linear: LinearFit, here: np.ndarray, ratio: float) -> LinearFit:
    """Return a linear fit in which some entries have their precision times a ratio."""
    weight = np.ones(len(linear.misfit))
    weight[here] = ratio
    return replace(linear, weighted=weight[:, None] * linear.weighted, pulled=weight * linear.pulled)


def _beside(
    linear: LinearFit, weighted: np.ndarray, response: np.ndarray, width: float, centre: np.ndarray
) -> LinearFit:
    """Return a linear fit with further columns, (E, d), whose coefficients have a prior."""
    return replace(
        linear,
        jacobian=np.concatenate([linear.jacobian, response], axis=1),
        weighted=np.concatenate([linear.weighted, weighted], axis=1),
        precision=np.append(linear.precision, np.full(len(centre), width**-2.0)),
        centre=np.append(linear.centre, centre),
    )


def _evidence(linear: LinearFit) -> tuple[WeightedFit, float]:
    """Return a linear fit at the noise that its channels show, no less than known, and the log of its evidence."""
    whole = linear.whole
    fit = linear.fit(whole)
    for _ in range(_REWEIGHED):
        fit = linear.fit(whole, 1 / fit.noise_ratios)
    scale = np.repeat(np.log(fit.weight), whole.count).sum()
    volume = np.linalg.slogdet(fit.whole)[1] - np.log(linear.precision).sum()
    return fit, 0.5 * float(scale - fit.chi2 - volume)

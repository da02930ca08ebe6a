"""Textbook regression on known inputs: terms of the model equation that rows separate, and combinations of terms.

The output is E = K·(Σ c_j x_j) with the input itself first, c = 1: for an accelerometer a_i + K0 + δ_o a_p − δ_p a_o +
K2 a_i² + … (IEEE Std 1293), for a gyro ω_i + D_F + δ_o ω_o + … + D_I a_i + … (IEEE Std 517).  It is fitted by least
squares.  Terms enter in the order of their list as long as the rows distinguish them from those before.  Of those left
out the higher orders of an accelerometer are assumed zero and named; those of a gyro stay in sums with what they are
not separable from, such as D_F + D_II.

Estimable functions are the combinations of coefficients that a design determines.  With y = X β + ν a combination wᵀβ
has an unbiased linear estimate exactly if w lies in the row space of X.  Single coefficients come first, then the
combinations that textbooks quote, and last the rows of the reduced row echelon form of X, which complete a basis of the
row space.  Source: Searle, Linear Models (1971), § 5.4.

Standard combinations are what a test determines if it does not separate the parameters themselves.  Every procedure
declares its own, with the symbols of its standard; the textbook evaluation and the joint fit report them under the same
names.  A combination is declared for what the test determines at best: whether it was determined is found from the
information in the data, never from this declaration.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.quantity_names import MOUNTING_ANGLE, SCALE_FACTOR, name_of
from imubayes.foundations.units import to_si
from imubayes.procedures import textbook
from imubayes.procedures.kinematics import AXES, felt, row_means, serial_stimulus
from imubayes.procedures.textbook import Evaluation, TextbookResult, Undetermined

# Singular values below this fraction of the largest are zero; nominal geometry is exact to rounding.
_RANK = 1e-7


@dataclass(frozen=True)
class Combination:
    """A linear combination of coefficients, wᵀβ.

    Attributes
    ----------
    symbol : `D_I`, or the sum as it is written: `D_II-D_SS`.
    weights : shape (p,).
    """

    symbol: str
    weights: np.ndarray

    @property
    def single(self) -> bool:
        """Whether this is one coefficient by itself."""
        return int(np.count_nonzero(self.weights)) == 1


def estimable(
    design: np.ndarray, names: Sequence[str], standard: Mapping[str, np.ndarray] | None = None
) -> list[Combination]:
    """Return independent combinations that span the row space of a design.

    Parameters
    ----------
    design : shape (n, p).
    names : of the p coefficients.
    standard : symbol → weights, shape (p,), of the combinations to prefer, in order.
    """
    basis = _row_space(design)
    singles = dict(zip(names, np.eye(len(names)), strict=True))
    # The echelon form is complete only for itself: singles and standard combinations take the place of its rows.
    wanted = [Combination(symbol, weights) for symbol, weights in (singles | dict(standard or {})).items()]
    wanted += [Combination(written(row, names), row) for row in echelon(basis)]
    found: list[Combination] = []
    for candidate in wanted:
        if len(found) == len(basis):
            break
        unit = candidate.weights / np.linalg.norm(candidate.weights)
        if np.linalg.norm(unit - basis.T @ (basis @ unit)) > 1e-6:
            continue
        weights = np.array([each.weights / np.linalg.norm(each.weights) for each in (*found, candidate)])
        if np.linalg.matrix_rank(weights, tol=1e-6) == len(weights):
            found.append(candidate)
    return found


def rank(design: np.ndarray) -> int:
    """Return the number of independent combinations that a design determines."""
    return len(_row_space(design))


def _row_space(design: np.ndarray) -> np.ndarray:
    """Return an orthonormal basis of the row space, shape (rank, p)."""
    _, values, rows = np.linalg.svd(design, full_matrices=False)
    return rows[values > _RANK * max(values.max(initial=0.0), np.finfo(float).tiny)]


def echelon(rows: np.ndarray) -> np.ndarray:
    """Return the reduced row echelon form of independent rows, shape (r, p), with 1 at every pivot."""
    reduced = rows.copy()
    place = 0
    for column in range(reduced.shape[1]):
        if place == len(reduced):
            break
        pivot = place + int(np.argmax(np.abs(reduced[place:, column])))
        if abs(reduced[pivot, column]) < 1e-6:
            continue
        reduced[[place, pivot]] = reduced[[pivot, place]]
        reduced[place] /= reduced[place, column]
        others = np.arange(len(reduced)) != place
        reduced[others] -= np.outer(reduced[others, column], reduced[place])
        place += 1
    return np.where(np.abs(reduced) < 1e-6, 0.0, reduced)


def written(weights: Sequence[float] | np.ndarray, names: Sequence[str]) -> str:
    """Return a combination as it is written: `D_F+0.683·D_SS`."""
    text = ""
    for weight, name in zip(weights, names, strict=True):
        if weight:
            factor = "" if abs(abs(weight) - 1) < 1e-6 else f"{abs(weight):.3g}·"
            text += f"{'-' if weight < 0 else '+' if text else ''}{factor}{name}"
    return text


# Of the columns at unit length: beyond it a coefficient loses four of the digits of the readings.
_LARGEST_CONDITION = 1e4
# Weights below this are rounding, or the Earth's rotation: a thousandth of what they stand beside.
_LEAST_WEIGHT = 1e-2
_LEAST_RATE = 1e-6  # rad/s, a seventieth of the Earth rate


@dataclass(frozen=True)
class KnownInput:
    """What a channel experiences at the nodes of some rows, along its own axes I, O and S.

    Attributes
    ----------
    rate : shape (n, 3), rad/s.
    force : shape (n, 3), g.
    """

    rate: np.ndarray
    force: np.ndarray


@dataclass(frozen=True)
class FittedTerm:
    """One term of a model equation.

    Attributes
    ----------
    symbol : of the coefficient, as in the standard; with a minus sign if that has one, −δ_p a_o.
    name : of the parameter in the joint fit.
    unit : of the coefficient.
    column : the known input → its values at the nodes, (n,), in the unit of the input: rad/s or g.
    assumed_zero : whether the standard neglects the term if it is not separable; if not, it is named together with
        those that it is not separable from.
    least : size of the column, rms, below which it is not seen at all.
    """

    symbol: str
    name: str
    unit: str
    column: Callable[[KnownInput], np.ndarray]
    assumed_zero: bool = False
    least: float = 1e-3


def _force(*axes: int) -> Callable[[KnownInput], np.ndarray]:
    return lambda known: np.prod(known.force[:, axes], axis=1)


def _rate(axis: int) -> Callable[[KnownInput], np.ndarray]:
    return lambda known: known.rate[:, axis]


def _with_sign(known: KnownInput) -> np.ndarray:
    return known.force[:, 0] * np.abs(known.force[:, 0])


ACCELEROMETER = (
    FittedTerm("K1", "scale_factor", "", _force(0)),
    FittedTerm("K0", "accel_bias.bias", "ug", _force()),
    FittedTerm("−δ_p", "accel_misalignment.toward_o", "arcsec", _force(1), assumed_zero=True),
    FittedTerm("δ_o", "accel_misalignment.toward_p", "arcsec", _force(2), assumed_zero=True),
    FittedTerm("K2", "accel_quadratic.quadratic", "ug/g^2", _force(0, 0), assumed_zero=True),
    FittedTerm("K3", "accel_cubic.cubic", "ug/g^3", _force(0, 0, 0), assumed_zero=True),
    FittedTerm("K_oq", "accel_odd_quadratic.odd_quadratic", "ug/g^2", _with_sign, assumed_zero=True),
    FittedTerm("K_io", "accel_cross_coupling.k_io", "ug/g^2", _force(0, 1), assumed_zero=True),
    FittedTerm("K_ip", "accel_cross_coupling.k_ip", "ug/g^2", _force(0, 2), assumed_zero=True),
    FittedTerm("K_oo", "accel_cross_axis_quadratic.k_oo", "ug/g^2", _force(1, 1), assumed_zero=True),
    FittedTerm("K_pp", "accel_cross_axis_quadratic.k_pp", "ug/g^2", _force(2, 2), assumed_zero=True),
)
GYRO = (
    FittedTerm("K", "scale_factor", "", _rate(0), least=_LEAST_RATE),
    FittedTerm("D_F", "gyro_bias.bias", "deg/h", _force()),
    FittedTerm("δ_o", "gyro_misalignment.toward_o", "arcsec", _rate(1), True, _LEAST_RATE),
    FittedTerm("δ_s", "gyro_misalignment.toward_s", "arcsec", _rate(2), True, _LEAST_RATE),
    FittedTerm("D_I", "gyro_g_sensitivity.d_i", "deg/h/g", _force(0)),
    FittedTerm("D_O", "gyro_g_sensitivity.d_o", "deg/h/g", _force(1)),
    FittedTerm("D_S", "gyro_g_sensitivity.d_s", "deg/h/g", _force(2)),
    FittedTerm("D_II", "gyro_g2_sensitivity.d_ii", "deg/h/g^2", _force(0, 0)),
    FittedTerm("D_OO", "gyro_g2_sensitivity.d_oo", "deg/h/g^2", _force(1, 1)),
    FittedTerm("D_SS", "gyro_g2_sensitivity.d_ss", "deg/h/g^2", _force(2, 2)),
    FittedTerm("D_IO", "gyro_g2_sensitivity.d_io", "deg/h/g^2", _force(0, 1)),
    FittedTerm("D_OS", "gyro_g2_sensitivity.d_os", "deg/h/g^2", _force(1, 2)),
    FittedTerm("D_SI", "gyro_g2_sensitivity.d_si", "deg/h/g^2", _force(2, 0)),
)


def model_terms(channel: Channel) -> tuple[FittedTerm, ...]:
    """Return the model equation of a channel."""
    return ACCELEROMETER if channel.kind == "accelerometer" else GYRO


def separated(design: np.ndarray, terms: Sequence[FittedTerm]) -> list[int]:
    """Return the columns of a design (R, p) that the rows separate, in their order, the first ones preferred."""
    length = np.linalg.norm(design, axis=0)
    least = np.array([term.least for term in terms]) * np.sqrt(len(design))
    kept: list[int] = []
    for column in range(design.shape[1]):
        if length[column] < least[column] or len(kept) + 1 >= len(design):
            continue
        tried = [*kept, column]
        if np.linalg.cond(design[:, tried] / length[tried]) < _LARGEST_CONDITION:
            kept.append(column)
    return kept


def combinations_of(design: np.ndarray, terms: Sequence[FittedTerm], kept: Sequence[int]) -> list[np.ndarray]:
    """Return what the coefficient of each kept term estimates: weights of all coefficients, (p,) each.

    By least squares on the kept columns X a coefficient estimates its own and, of the columns Z left out, (X⁺Z) times
    theirs (the alias matrix; Box and Draper, Empirical Model-Building, § 3.10).  Those assumed zero are not counted.
    """
    alias = np.linalg.lstsq(design[:, kept], design, rcond=None)[0]
    counted = np.array([place in kept or not term.assumed_zero for place, term in enumerate(terms)])
    return [np.where(counted & (np.abs(row) > _LEAST_WEIGHT), np.round(row, 6), 0.0) for row in alias]


def known_rows(campaign: Campaign, runs: Sequence[Run], place: int, still_only: bool) -> tuple[np.ndarray, np.ndarray]:
    """Return the design of a channel's model equation, (R, p), and its outputs less the nominal offset, (R,).

    Parameters
    ----------
    place : of the channel in the campaign.
    still_only : whether to leave out rows that turn.
    """
    channel, designs, outputs = campaign.channels[place], [], []
    for run in runs:
        good = np.isfinite(run.observed[:, place])
        if still_only:
            good &= ~np.any([run.covariates.get(f"{axis}_rate", np.zeros(run.rows)) != 0 for axis in AXES], axis=0)
        designs.append(_design(campaign, run, channel)[good])
        outputs.append(run.observed[good, place] - channel.offset)
    return np.concatenate(designs), np.concatenate(outputs)


def _design(campaign: Campaign, run: Run, channel: Channel) -> np.ndarray:
    stimulus = serial_stimulus(run, campaign)
    rate, force = (vector @ channel.axes.T for vector in felt(stimulus, campaign.site))
    known = KnownInput(rate, force / campaign.site.gravity)
    return row_means(stimulus, np.stack([term.column(known) for term in model_terms(channel)], axis=1))


def term_estimates(
    campaign: Campaign, tested: Sequence[Run], place: int, still_only: bool, method: str
) -> list[TextbookResult]:
    """Return the coefficients of a channel that rows determine, and which they leave open.

    Parameters
    ----------
    tested : the runs; those without outputs of the channel are passed over.
    place, still_only : as for `known_rows`.
    method : for the estimates.
    """
    recorded = [run for run in tested if np.isfinite(run.observed[:, place]).any()]
    if not recorded:
        return []
    channel, gravity, runs = campaign.channels[place], campaign.site.gravity, textbook.names_of(recorded)
    design, output = known_rows(campaign, recorded, place, still_only)
    terms = model_terms(channel)
    kept = separated(design, terms)
    if 0 not in kept:
        return [Undetermined(runs, f"{channel.name}: its input axis sees no known input that varies")]
    length = np.linalg.norm(design[:, kept], axis=0)
    value, covariance, _ = textbook.least_squares(design[:, kept] / length, output)
    value, covariance = value / length, covariance / np.outer(length, length)
    scale, freedom = float(value[0]), len(output) - len(kept)
    per = to_si(channel.per, gravity) / (1.0 if channel.kind == "gyro" else to_si("g", gravity))
    evaluation = f"type A: residuals of the fitted terms, {freedom} degrees of freedom"
    of_channel, scale_sd = Evaluation(channel.name, runs, method, evaluation), np.sqrt(covariance[0, 0])
    found: list[TextbookResult] = [
        of_channel.estimate(
            "scale_factor", scale * per, abs(scale_sd * per), f"{channel.output_unit} per {channel.per}"
        )
    ]
    relative, spread = _over_first(value, covariance)
    for column, weights, size, error in zip(kept, combinations_of(design, terms, kept), relative, spread, strict=True):
        term, factor = terms[column], _factor(channel, terms[column])
        alone = term.assumed_zero or np.count_nonzero(weights) == 1
        name = term.name if alone else written(weights, [each.symbol for each in terms])
        if column:
            how = term.symbol if alone else ""
            found.append(of_channel.estimate(name, size * factor, error * factor, term.unit, how))
    return [*found, *_left_open(channel, terms, kept, runs)]


def _over_first(value: np.ndarray, covariance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return the coefficients over the first, and their standard uncertainties by the delta method, (p,) each."""
    relative = value / value[0]
    gradient = np.eye(len(value)) / value[0]
    gradient[:, 0] -= relative / value[0]
    return relative, np.sqrt(np.diag(gradient @ covariance @ gradient.T))


def _left_open(channel: Channel, terms: Sequence[FittedTerm], kept: Sequence[int], runs: str) -> list[TextbookResult]:
    """Return which terms are assumed zero, and which are estimated together with others only."""
    left = [term for place, term in enumerate(terms) if place not in kept]
    zero = ", ".join(term.symbol.removeprefix("−") for term in left if term.assumed_zero)
    unseen = ", ".join(term.symbol for term in left if not term.assumed_zero)
    sentences = [f"{zero} cannot be separated from the others; assumed zero"] if zero else []
    sentences += [f"{unseen} are determined only in combinations"] if unseen else []
    return [Undetermined(runs, f"{channel.name}: {sentence}") for sentence in sentences]


def _factor(channel: Channel, term: FittedTerm) -> float:
    """Return the factor from a coefficient of the regression, relative to the scale factor, to its unit."""
    if term.unit == "arcsec":
        return 1 / to_si("arcsec")
    return 1 / to_si("deg/h") if channel.kind == "gyro" else 1e6


DRIFT_COEFFICIENTS = {
    "D_F": "gyro_bias.bias",
    "D_I": "gyro_g_sensitivity.d_i", "D_O": "gyro_g_sensitivity.d_o", "D_S": "gyro_g_sensitivity.d_s",
    "D_II": "gyro_g2_sensitivity.d_ii", "D_OO": "gyro_g2_sensitivity.d_oo", "D_SS": "gyro_g2_sensitivity.d_ss",
    "D_IO": "gyro_g2_sensitivity.d_io", "D_OS": "gyro_g2_sensitivity.d_os", "D_SI": "gyro_g2_sensitivity.d_si",
}  # fmt: skip
"""Textbook symbol of a drift coefficient (IEEE Std 517) → parameter of the joint fit."""
LEAST_COSINE = 0.1
"""Gyros with |cos θ| below this to the axis of a rate table are not evaluated."""
_ROUNDING = 1e-9
_ANGLES = np.arange(72) * np.pi / 36


@dataclass(frozen=True)
class LinearCombination:
    """A sum of parameters.

    Attributes
    ----------
    name : symbol and label: `D_F+D_II[g]`.
    unit : of the sum, with each parameter in its own unit.
    weights : name of the parameter → its weight.
    constant : added to the sum, in `unit`.
    total : whether the sum stands for everything that acts together, so that a model may lack some of its members.
    middle_of : run in the middle of whose record it holds, if it changes with time; else empty.
    """

    name: str
    unit: str
    weights: Mapping[str, float]
    total: bool = False
    constant: float = 0.0
    middle_of: str = ""


@dataclass(frozen=True)
class ProjectedScaleFactor:
    """k′ = k cos θ, the slope of the output against the table rate.

    Attributes
    ----------
    name, unit : `k′[gx,pyramid]`, in the unit of the scale factor.
    scale, angle : names of the derived quantities k and θ.
    """

    name: str
    unit: str
    scale: str
    angle: str


StandardCombination = LinearCombination | ProjectedScaleFactor


def drift_terms(force: np.ndarray) -> np.ndarray:
    """Return the terms of the drift coefficients at specific forces along I, O and S in g, (3, n) → (n, 10)."""
    i, o, s = force
    return np.stack([np.ones_like(i), i, o, s, i * i, o * o, s * s, i * o, o * s, s * i], axis=1)


def of_drift(
    symbol: str, channel: str, unit: str, terms: Mapping[str, float], total: bool = False
) -> LinearCombination:
    """Return a combination of the drift coefficients of a gyro; `terms` are textbook symbol → weight."""
    weights = {f"{DRIFT_COEFFICIENTS[term]}[{channel}]": weight for term, weight in terms.items()}
    return LinearCombination(f"{symbol}[{channel}]", unit, weights, total)


def turn_mean_drift(campaign: Campaign, run: Run, channel: Channel) -> dict[str, float]:
    """Return the drift of a gyro as the mean over a whole turn of the table: textbook symbol → weight."""
    mean = drift_terms(textbook.components(run, campaign, channel, _ANGLES)).mean(axis=0)
    terms = zip(DRIFT_COEFFICIENTS, mean, strict=True)
    return {symbol: float(weight) for symbol, weight in terms if abs(weight) > _ROUNDING}


def projected_scale_factors(campaign: Campaign, runs: Sequence[Run]) -> Iterator[ProjectedScaleFactor]:
    """Return k′ of every gyro in every mounting, except where its axis is nearly across that of the table."""
    for mounting, run in {run.mounting: run for run in runs if run.mounting is not None}.items():
        for channel in campaign.of_kind("gyro"):
            if abs(float(textbook.along_table(run, campaign, channel.axes[0])[2])) > LEAST_COSINE:
                unit, labels = f"{channel.output_unit} per {channel.per}", (channel.name, mounting)
                scale, angle = name_of(SCALE_FACTOR, channel.name), name_of(MOUNTING_ANGLE, *labels)
                yield ProjectedScaleFactor(name_of("k′", *labels), unit, scale, angle)

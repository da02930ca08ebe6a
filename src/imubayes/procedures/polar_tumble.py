"""Polar-axis tumble: a gyro in static positions about an axis parallel to the Earth's axis (P4).

The textbook treats a single-degree-of-freedom gyro with torque-rebalance readout.  With the output axis along (O→Np)
or against (O→Sp) the table axis and the input axis in the plane of the table, the Earth rate along the input axis is
zero, and the output over the torquer scale factor is the drift

    d = D_F + D_I f_I + D_O f_O + D_S f_S + D_II f_I² + D_OO f_O² + D_SS f_S²
            + D_IO f_I f_O + D_OS f_O f_S + D_SI f_S f_I.

At the table angle φ gravity is (0, −cos L, sin L) in the table's axes at φ = 0.  With ψ = φ + φ0 such that
f_I = −cos L sin ψ, the spin axis S = I × O sees f_S = ±cos L cos ψ and the output axis f_O = ±sin L, + for O→Np.
So the five Fourier coefficients of the two sweeps are, + for N and − for S,

    B0 = D_F ± D_O sin L + D_OO sin² L + ½(D_II + D_SS) cos² L
    S1 = −D_I cos L ∓ ½ D_IO sin 2L        C1 = ±D_S cos L + ½ D_OS sin 2L
    C2 = ½(D_SS − D_II) cos² L             S2 = ∓½ D_SI cos² L

(IEEE Std 517).  Sweeps with the spin axis (S→Np, S→Sp) or the input axis (I→Np, I→Sp) along the pole have the same form
with the axes exchanged; if the input axis sees a component of the Earth rate, that is subtracted.

Every sweep gives its coefficients by least squares, and all sweeps of a gyro together determine what is estimable of
the ten drift coefficients: each Fourier coefficient is a linear function of them.  For one sweep O→Np and one O→Sp this
is the textbook's half sum and half difference.  Two sweeps leave D_F + D_OO sin² L + ½(D_II + D_SS) cos² L as a sum and
D_II − D_SS as a difference.  Sweeps with another axis along the pole separate these, except D_F from
D_II + D_OO + D_SS, since f_I² + f_O² + f_S² = 1 g² in every static position.

Sweeps in the same mounting at the same temperature are repetitions.  The scatter of their Fourier coefficients gives
the repeatability of a drift coefficient, that of one determination by one sweep in each mounting, and replaces the
scatter within the sweeps if it is larger (Birge).
"""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.earth import earth_rate
from imubayes.procedures import fitted_terms, textbook
from imubayes.procedures.base import PlanRules, Procedure, Reduction, position_rows
from imubayes.procedures.fitted_terms import DRIFT_COEFFICIENTS, Combination, StandardCombination
from imubayes.procedures.kinematics import turned_back
from imubayes.procedures.textbook import DEGREE_PER_HOUR, Evaluation, TextbookResult, Undetermined

METHOD = "IEEE Std 517 polar-axis tumble"
COEFFICIENTS = tuple(DRIFT_COEFFICIENTS)
_AXES = "IOS"
_TOLERANCE = 1e-9
_LARGEST_CONDITION = 1e3


@dataclass(frozen=True)
class Sweep:
    """The Fourier coefficients of one sweep as a linear function of the ten drift coefficients.

    Attributes
    ----------
    run : the sweep.
    kept : which of B0, C1, S1, C2, S2 its positions determine; four positions leave out one of the second harmonics.
    value : shape (m,), those coefficients in deg/h.
    design : shape (m, 10), their dependence on the drift coefficients.
    shape : shape (m, m), covariance of `value` for unit variance of a position.
    squares, freedom : sum of the squared residuals, (deg/h)², and its degrees of freedom.
    """

    run: Run
    kept: list[int]
    value: np.ndarray
    design: np.ndarray
    shape: np.ndarray
    squares: float
    freedom: int


def standard_combinations(latitude: float) -> dict[str, np.ndarray]:
    """Return the combinations of drift coefficients that textbooks quote for polar sweeps, symbol → weights (10,)."""
    sine, cosine = np.sin(latitude), np.cos(latitude)
    place = {name: index for index, name in enumerate(COEFFICIENTS)}

    def weights(**terms: float) -> np.ndarray:
        found = np.zeros(len(COEFFICIENTS))
        for name, weight in terms.items():
            found[place[name]] = weight
        return found

    found = {
        "D_II-D_SS": weights(D_II=1, D_SS=-1),
        "D_II-D_OO": weights(D_II=1, D_OO=-1),
        "D_OO-D_SS": weights(D_OO=1, D_SS=-1),
        "D_F+D_II": weights(D_F=1, D_II=1),
        "D_F+D_OO": weights(D_F=1, D_OO=1),
        "D_F+D_SS": weights(D_F=1, D_SS=1),
    }
    for along, y, z in ("OIS", "SIO", "IOS"):
        square = {f"D_{along * 2}": sine**2, f"D_{y * 2}": cosine**2 / 2, f"D_{z * 2}": cosine**2 / 2}
        name = f"D_{along * 2}·sin²L+½(D_{y * 2}+D_{z * 2})·cos²L"
        found[f"D_F+{name}"] = weights(D_F=1, **square)
        for sign, text in ((1, "+"), (-1, "-")):
            found[f"D_F{text}D_{along}·sinL+{name}"] = weights(D_F=1, **square, **{f"D_{along}": sign * sine})
            for other in (y, z):
                cross = next(n for n in ("D_IO", "D_OS", "D_SI") if along in n[2:] and other in n[2:])
                found[f"D_{other}{text}{cross}·sinL"] = weights(**{f"D_{other}": 1, cross: sign * sine})
    return found


def combinations(campaign: Campaign, _runs: Sequence[Run]) -> list[StandardCombination]:
    """Return the combinations that textbooks quote, of every gyro."""
    found: list[StandardCombination] = []
    for channel in campaign.of_kind("gyro"):
        for symbol, weights in standard_combinations(campaign.site.latitude).items():
            terms = {COEFFICIENTS[place]: float(weights[place]) for place in np.flatnonzero(weights)}
            found.append(fitted_terms.of_drift(symbol, channel.name, _unit(Combination(symbol, weights)), terms))
    return found


def polar_tumble_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return what the sweeps of every gyro determine of its drift coefficients, temperature by temperature."""
    found: list[TextbookResult] = []
    for place, channel in enumerate(campaign.channels):
        for group in textbook.by_temperature(runs) if channel.kind == "gyro" else ():
            sweeps: list[Sweep] = []
            for run in group:
                sweep = _sweep(run, campaign, channel, run.observed[:, place])
                if sweep is None:
                    found.append(Undetermined(run.name, f"{channel.name}: {_TOO_FEW}"))
                else:
                    sweeps.append(sweep)
            if sweeps:
                found += _of_channel(campaign, channel, sweeps)
    return found


_TOO_FEW = "its positions do not determine the first two harmonics; 4 or more evenly spaced over the circle do"


def _sweep(run: Run, campaign: Campaign, channel: Channel, output: np.ndarray) -> Sweep | None:
    """Return the Fourier coefficients of a sweep; None if its positions do not determine them."""
    there = np.isfinite(output)
    angle = run.covariates["table_angle"][there]
    waves = _waves(angle)
    kept = next((kept for kept in _HARMONICS if _determined(waves[:, kept])), None)
    if kept is None:
        return None
    force = textbook.components(run, campaign, channel, angle)
    signal = (output[there] - channel.offset) / channel.scale_si - _earth(run, campaign, channel, angle)
    drift = signal / DEGREE_PER_HOUR
    inverse = np.linalg.pinv(waves[:, kept])
    residual = drift - waves[:, kept] @ (inverse @ drift)
    return Sweep(
        run, kept, inverse @ drift, inverse @ fitted_terms.drift_terms(force), inverse @ inverse.T,
        float(residual @ residual), len(drift) - len(kept),
    )  # fmt: skip


# Four positions determine one of the second harmonics.
_HARMONICS = ([0, 1, 2, 3, 4], [0, 1, 2, 3], [0, 1, 2, 4])


def _waves(angle: np.ndarray) -> np.ndarray:
    """Return the terms of B0, C1, S1, C2, S2 at table angles, (n,) → (n, 5)."""
    columns = [np.ones_like(angle), np.cos(angle), np.sin(angle), np.cos(2 * angle), np.sin(2 * angle)]
    return np.stack(columns, axis=1)


def _determined(waves: np.ndarray) -> bool:
    return len(waves) >= waves.shape[1] and bool(np.linalg.cond(waves) < _LARGEST_CONDITION)


def _earth(run: Run, campaign: Campaign, channel: Channel, angle: np.ndarray) -> np.ndarray:
    """Return the Earth rate along the input axis at table angles, rad/s, (n,)."""
    assert run.table is not None
    assert run.mounting is not None
    in_table = turned_back(campaign.tables[run.table].to_local.T @ earth_rate(campaign.site.latitude), angle)
    return campaign.mountings[run.mounting].body_to_table @ channel.axes[0] @ in_table


def _of_channel(campaign: Campaign, channel: Channel, sweeps: Sequence[Sweep]) -> list[TextbookResult]:
    design = np.concatenate([sweep.design for sweep in sweeps])
    # A first or second harmonic of n positions has twice the variance of their mean.
    weight = np.concatenate([1 / np.diag(sweep.shape) for sweep in sweeps])
    solve = np.linalg.pinv(design * np.sqrt(weight)[:, None], rcond=_TOLERANCE) * np.sqrt(weight)
    coefficients = solve @ np.concatenate([sweep.value for sweep in sweeps])
    scatter = Scatter.of(campaign, sweeps)
    covariance = solve @ scatter.covariance(sweeps) @ solve.T
    tested = Evaluation(channel.name, textbook.names_of([sweep.run for sweep in sweeps]), METHOD, scatter.evaluation)
    combinations = fitted_terms.estimable(design, COEFFICIENTS, standard_combinations(campaign.site.latitude))
    found: list[TextbookResult] = []
    for each in combinations:
        name, sd = DRIFT_COEFFICIENTS.get(each.symbol, each.symbol), np.sqrt(each.weights @ covariance @ each.weights)
        found.append(tested.estimate(name, each.weights @ coefficients, sd, _unit(each)))
    found += _repeatability(tested, sweeps, scatter, combinations)
    return [*found, *_advice(campaign, tested, design, combinations)]


def _unit(combination: Combination) -> str:
    """Return the unit of a combination; terms of several orders are a drift rate at 1 g."""
    orders = {len(COEFFICIENTS[place]) - 2 for place in np.flatnonzero(combination.weights)}
    fixed = bool(combination.weights[0])
    return "deg/h" if fixed else {1: "deg/h/g", 2: "deg/h/g^2"}[min(orders)]


@dataclass(frozen=True)
class Scatter:
    """Scatter within and between the sweeps of a gyro.

    Attributes
    ----------
    within : variance of a position, (deg/h)², pooled over the sweeps; NaN without degrees of freedom.
    between : shape (5, 5), covariance of the Fourier coefficients of repeated sweeps, pooled; None without repetitions.
    freedom : degrees of freedom of `between`.
    evaluation : how the standard uncertainty is evaluated.
    """

    within: float
    between: np.ndarray | None
    freedom: int
    evaluation: str

    @classmethod
    def of(cls, campaign: Campaign, sweeps: Sequence[Sweep]) -> "Scatter":
        """Return the scatter of sweeps, those in the same mounting being repetitions."""
        freedom = sum(sweep.freedom for sweep in sweeps)
        within = sum(sweep.squares for sweep in sweeps) / freedom if freedom else float("nan")
        text = f"type A: residuals of the sweeps, {freedom} degrees of freedom"
        total, repeated = np.zeros((5, 5)), 0
        for group in _in_same_mounting(campaign, sweeps):
            values = np.array([sweep.value for sweep in group if len(sweep.kept) == 5])
            if len(values) > 1:
                total += (values - values.mean(axis=0)).T @ (values - values.mean(axis=0))
                repeated += len(values) - 1
        if not repeated:
            return cls(within, None, 0, text)
        text += f", or the scatter between repeated sweeps, {repeated}, if it is larger"
        return cls(within, total / repeated, repeated, text)

    def covariance(self, sweeps: Sequence[Sweep]) -> np.ndarray:
        """Return the covariance of the Fourier coefficients of all sweeps."""
        blocks = [self._of_sweep(sweep) for sweep in sweeps]
        size = sum(len(block) for block in blocks)
        found, place = np.zeros((size, size)), 0
        for block in blocks:
            found[place : place + len(block), place : place + len(block)] = block
            place += len(block)
        return found

    def _of_sweep(self, sweep: Sweep) -> np.ndarray:
        within = self.within * sweep.shape
        if self.between is None:
            return within
        between = np.diag(self.between)[sweep.kept]
        if not np.isfinite(self.within):
            return np.diag(between)
        inflation = np.sqrt(np.maximum(1.0, between / np.maximum(np.diag(within), np.finfo(float).tiny)))
        return within * np.outer(inflation, inflation)


def _in_same_mounting(campaign: Campaign, sweeps: Iterable[Sweep]) -> list[list[Sweep]]:
    groups: dict[tuple[str | None, bytes], list[Sweep]] = {}
    for sweep in sweeps:
        assert sweep.run.mounting is not None
        seat = np.round(campaign.mountings[sweep.run.mounting].body_to_table, 6) + 0.0
        groups.setdefault((sweep.run.table, seat.tobytes()), []).append(sweep)
    return list(groups.values())


def _repeatability(
    tested: Evaluation, sweeps: Sequence[Sweep], scatter: Scatter, combinations: Sequence[Combination]
) -> list[TextbookResult]:
    """Return the standard deviation of single determinations, by one sweep in each mounting."""
    if scatter.between is None:
        return []
    first = {sweep.design.round(9).tobytes(): sweep for sweep in sweeps if len(sweep.kept) == 5}.values()
    solve = np.linalg.pinv(np.concatenate([sweep.design for sweep in first]), rcond=_TOLERANCE)
    covariance = solve @ np.kron(np.eye(len(first)), scatter.between) @ solve.T
    spreads = [np.sqrt(max(each.weights @ covariance @ each.weights, 0.0)) for each in combinations]
    how = "standard deviation of one determination"
    evaluation = f"type A: {scatter.freedom} degrees of freedom between repeated sweeps"
    found: list[TextbookResult] = [
        tested.estimate(
            f"repeatability({each.symbol})", spread, spread / np.sqrt(2 * scatter.freedom), _unit(each), how,
            uncertainty=evaluation,
        )
        for each, spread in zip(combinations, spreads, strict=True)
    ]  # fmt: skip
    return found


def _advice(
    campaign: Campaign, tested: Evaluation, design: np.ndarray, combinations: Sequence[Combination]
) -> list[TextbookResult]:
    """Return what the sweeps do not separate, and the sweep that would separate most of it."""
    single = {each.symbol for each in combinations if each.single}
    together = [name for name in COEFFICIENTS if name not in single]
    if not together:
        return []
    before, standard = fitted_terms.rank(design), standard_combinations(campaign.site.latitude)
    best, gained, further = "", before, design
    for text, sweep in _possible_sweeps(campaign.site.latitude).items():
        reached = fitted_terms.rank(np.concatenate([design, sweep]))
        if reached > gained:
            best, gained, further = text, reached, np.concatenate([design, sweep])
    sentence = f"{tested.of}: {', '.join(together)} are not separated from each other; "
    if not best:
        return [
            Undetermined(tested.run, f"{sentence}no sweep separates them, since |f| = 1 g in every static position")
        ]
    after = [each.symbol for each in fitted_terms.estimable(further, COEFFICIENTS, standard)]
    new = [symbol for symbol in after if symbol not in {each.symbol for each in combinations}]
    return [Undetermined(tested.run, f"{sentence}a sweep {best} would determine {', '.join(new)}")]


def _possible_sweeps(latitude: float) -> dict[str, np.ndarray]:
    """Return the drift terms over a sweep with each axis along the pole, in words → (n, 10)."""
    angle = np.arange(8) * np.pi / 4
    plane, found = np.cos(latitude) * np.stack([np.cos(angle), np.sin(angle)]), {}
    for place, letter in enumerate(_AXES):
        for sign, pole in ((1, "Np"), (-1, "Sp")):
            force = np.insert(plane, place, sign * np.sin(latitude), axis=0)
            found[f"{letter}→{pole}"] = fitted_terms.drift_terms(force)
    return found


POLAR_TUMBLE = Procedure(
    name="polar_tumble",
    reference="IEEE Std 517, tumble test with an axis of the gyro parallel to the Earth's axis",
    columns=(("table_angle_deg",),),
    needs_table=True,
    reduction=Reduction.AT_REST,
    abscissae=("table_angle", "time"),
    plan=PlanRules(("positions", "angles_deg"), ("converter_temperature_degC",), 10.0, position_rows),
    evaluate=polar_tumble_test,
    purposes=("gyro_g_sensitivity", "gyro_g2_sensitivity"),
    combinations=combinations,
)

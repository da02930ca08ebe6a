"""Dividing head: multipoint tumble in static positions about a horizontal axis (P7).

The textbook derives the model coefficients from harmonics of the output.  The output or the pendulous axis lies along
the horizontal axis; ψ is the angle from a_i = +1 g, so that a_i = cos ψ and a_x = sin ψ, x the other axis in the plane
of rotation.  By the power-to-multiple-angle identities

    E/K1 = K0 + a_i + K2 a_i² + K3 a_i³ + K_oq a_i|a_i| + K_xx a_x² + δ a_x + K_ix a_i a_x

has the harmonics (over K1)

    B0 = K0 + (K2 + K_xx)/2           C1 = 1 + 3/4 K3 + 8/(3π) K_oq      S1 = δ
    C2 = (K2 − K_xx)/2                S2 = K_ix/2
    C3 = K3/4 + 8/(15π) K_oq          C5 = −8/(105π) K_oq

(IEEE Std 1293, multipoint tumble).  At n positions harmonics k and n − k are not distinct, and the series of K_oq does
not end; hence the coefficients are fitted directly, by least squares with these terms.  As sin² + cos² = 1, K_xx is not
separable; like the textbook, assume K_xx = 0.  Of K1, K3 and K_oq the positions determine as many as there are
different |a_i| > 0; those beyond, K_oq first, are assumed zero as well.  Every assumption is named.  In a 1 g field the
three are strongly correlated; their sum in C1, which the positions determine best, is given beside them.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.units import to_si
from imubayes.procedures import textbook
from imubayes.procedures.base import PlanRules, Procedure, Reduction, position_rows
from imubayes.procedures.fitted_terms import LinearCombination, StandardCombination
from imubayes.procedures.textbook import ARCSEC, Evaluation, TextbookResult, Undetermined

METHOD = "IEEE Std 1293 tumble test"
_ACROSS = 0.05
_LARGEST_CONDITION = 1e4
_UNITS = {"K0": "ug", "K2": "ug/g^2", "K3": "ug/g^3", "K_oq": "ug/g^2"}
_JOINT = {
    "K0": "accel_bias.bias", "K2": "accel_quadratic.quadratic", "K3": "accel_cubic.cubic",
    "K_oq": "accel_odd_quadratic.odd_quadratic",
}  # fmt: skip
"""Textbook symbol → parameter of the joint fit."""


def tumble_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the model coefficients of every accelerometer whose input axis turns in the vertical plane."""
    found: list[TextbookResult] = []
    for run in runs:
        angle = run.covariates["table_angle"] % (2 * np.pi)
        positions = len(np.unique(np.round(angle, 9)))
        gaps = np.diff(np.sort(angle), append=np.sort(angle)[0] + 2 * np.pi)
        if positions < 4 or gaps.max() > 1.5 * 2 * np.pi / positions:
            found.append(Undetermined(run.name, f"{positions} positions are not evenly spaced over the circle"))
            continue
        for channel, output in textbook.measured(run, campaign, "accelerometer"):
            found += _of_channel(run, campaign, channel, output, positions)
    return found


@dataclass(frozen=True)
class Terms:
    """The terms of the model that a set of positions separates.

    Attributes
    ----------
    names : K1 first; δ and K_ix stand for the axis in the plane of rotation.
    design : shape (R, len(names)).
    assumed : the terms assumed zero.
    """

    names: tuple[str, ...]
    design: np.ndarray
    assumed: tuple[str, ...]


def separable_terms(a: np.ndarray, x: np.ndarray) -> Terms:
    """Return the terms separated by positions with the specific forces a along the input axis and x across, g, (R,)."""
    columns = {
        "K1": a, "K0": np.ones_like(a), "δ": x, "K2": a**2, "K_ix": a * x, "K3": a**3, "K_oq": a * np.abs(a),
    }  # fmt: skip
    kept: list[str] = []
    assumed = ["K_xx"]
    for name in columns:
        design = np.stack([columns[each] for each in (*kept, name)], axis=1)
        if np.linalg.cond(design) < _LARGEST_CONDITION and len(a) >= design.shape[1]:
            kept.append(name)
        else:
            assumed.append(name)
    return Terms(tuple(kept), np.stack([columns[name] for name in kept], axis=1), tuple(assumed))


def _of_channel(
    run: Run, campaign: Campaign, channel: Channel, output: np.ndarray, positions: int
) -> list[TextbookResult]:
    axes = [textbook.along_table(run, campaign, axis) for axis in channel.axes]
    if abs(axes[0][2]) > _ACROSS:
        return []  # along the axis of rotation, or oblique to it: not a tumble of this channel
    other = next((place for place in (1, 2) if abs(axes[place][2]) < _ACROSS), None)
    if other is None:
        return [Undetermined(run.name, f"{channel.name}: neither its output nor its pendulous axis lies in the plane")]
    force = textbook.components(run, campaign, channel)
    letter = "o" if other == 1 else "p"
    terms = separable_terms(force[0], force[other])
    value, covariance, _ = textbook.least_squares(terms.design, output)
    k1 = float(value[0])
    # Coefficients are relative to K1, whose own uncertainty does not matter to them.
    relative = dict(zip(terms.names, value / k1, strict=True))
    spread = dict(zip(terms.names, np.sqrt(np.diag(covariance)) / abs(k1), strict=True))
    gravity, per = campaign.site.gravity, to_si(channel.per, campaign.site.gravity)
    unit = f"{channel.output_unit} per {channel.per}"
    names = {"δ": (f"accel_misalignment.toward_{letter}", "arcsec"), "K_ix": (_cross(letter), "ug/g^2")}
    names |= {symbol: (_JOINT[symbol], _UNITS[symbol]) for symbol in _JOINT}
    freedom = len(output) - len(terms.names)
    evaluation = f"type A: residuals of the fitted terms, {freedom} degrees of freedom"
    tested, k1_sd = Evaluation(channel.name, run.name, METHOD, evaluation), spread["K1"] * abs(k1)
    found: list[TextbookResult] = [tested.estimate("scale_factor", k1 / gravity * per, k1_sd / gravity * per, unit)]
    for symbol in terms.names[1:]:
        name, of = names[symbol]
        factor = 1 / ARCSEC if of == "arcsec" else 1e6
        found.append(tested.estimate(name, relative[symbol] * factor, spread[symbol] * factor, of))
    found += _first_harmonic(run, channel, terms, value, covariance, per / gravity)
    return [*found, Undetermined(run.name, _left_open(channel.name, letter, terms, positions))]


_ODD_TERMS = {"K1": "accel_scale_factor.scale", "K3": "accel_cubic.cubic", "K_oq": "accel_odd_quadratic.odd_quadratic"}
_FIRST_HARMONIC = {"K1": ("K1", 1.0), "K3": ("¾K3", 0.75), "K_oq": ("8/(3π)K_oq", 8 / (3 * np.pi))}


def _first_harmonic(
    run: Run, channel: Channel, terms: Terms, value: np.ndarray, covariance: np.ndarray, factor: float
) -> list[TextbookResult]:
    """Return the sum of the odd terms in the first harmonic, which is determined far better than each of them."""
    if "K3" not in terms.names:
        return []
    weights = np.array([_FIRST_HARMONIC.get(name, ("", 0.0))[1] for name in terms.names])
    symbol = "+".join(text for name, (text, _) in _FIRST_HARMONIC.items() if name in terms.names)
    sd, unit = np.sqrt(weights @ covariance @ weights), f"{channel.output_unit} per {channel.per}"
    tested, how = Evaluation(channel.name, run.name, METHOD), "amplitude of the first harmonic"
    return [tested.estimate(symbol, weights @ value * factor, sd * factor, unit, how)]


def combinations(campaign: Campaign, _runs: Sequence[Run]) -> list[StandardCombination]:
    """Return the amplitude of the first harmonic of every accelerometer, with the odd terms that a model may have."""
    found: list[StandardCombination] = []
    for channel in campaign.of_kind("accelerometer"):
        for terms in (("K1", "K3", "K_oq"), ("K1", "K3"), ("K1", "K_oq")):
            symbol = "+".join(_FIRST_HARMONIC[term][0] for term in terms)
            weights = {
                f"{_ODD_TERMS[term]}[{channel.name}]": channel.scale * 1e-6 * _FIRST_HARMONIC[term][1] for term in terms
            }
            unit = f"{channel.output_unit} per {channel.per}"
            if channel.per == "g":
                found.append(LinearCombination(f"{symbol}[{channel.name}]", unit, weights, constant=channel.scale))
    return found


def _cross(letter: str) -> str:
    return f"accel_cross_coupling.k_i{letter}"


def _left_open(name: str, letter: str, terms: Terms, positions: int) -> str:
    """Return which terms are not determined, and what is assumed of them."""
    written = {"K_xx": f"K_{letter}{letter}", "K_ix": f"K_i{letter}"}
    reasons = {
        "K_xx": f"K_{letter}{letter} is not separated from K0 and K2 (sin² + cos² = 1)",
        "K3": f"K3 is not separated from K1 ({positions} positions)",
        "K_oq": f"K_oq is not separated from K1 and K3 ({positions} positions)",
    }
    reason = "; ".join(
        reasons.get(symbol, f"{written.get(symbol, symbol)} is not determined ({positions} positions)")
        for symbol in terms.assumed
    )
    perpendicular = "p" if letter == "o" else "o"
    beyond = f"δ_{perpendicular}, K_i{perpendicular} and K_{perpendicular * 2} (no specific force along that axis)"
    return f"{name}: {reason}; the textbook assumes zero. Not determined either: {beyond}"


DIVIDING_HEAD = Procedure(
    name="dividing_head",
    reference="IEEE Std 1293, multipoint tumble test",
    columns=(("table_angle_deg",),),
    needs_table=True,
    reduction=Reduction.AT_REST,
    abscissae=("table_angle", "time"),
    plan=PlanRules(("positions", "angles_deg"), ("converter_temperature_degC",), 10.0, position_rows),
    evaluate=tumble_test,
    purposes=("accel_quadratic", "accel_cubic", "accel_odd_quadratic", "accel_cross_coupling"),
    combinations=combinations,
)

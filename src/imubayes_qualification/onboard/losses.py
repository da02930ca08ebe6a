"""Effects that a format for constants on board cannot hold, with their errors; and noise densities.

A loss is *significant* if the error of leaving it out is larger than its expanded uncertainty, k = 2 (GUM § 6.2):
then the constants are not those of the fit, and the format is refused unless the loss is accepted.  A smaller one is
within what is known of it.

The noise of a triad is given as filters ask for it: white noise density and random walk, of its noisiest axis.
"""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Literal

import numpy as np

from imubayes.foundations.campaign_data import Campaign
from imubayes.foundations.errors import input_error
from imubayes.foundations.quantity_names import QuantityName, family_of, name_of
from imubayes.results.result import Result
from imubayes_qualification.onboard.record import OnboardConstants, ThermalPolynomial, TriadConstants
from imubayes_qualification.onboard.response import NEGLIGIBLE
from imubayes_recordings.noise_analysis.noise_record import NoiseDensity, StaticNoise

_SECONDS = math.sqrt(3600.0)


def read_noise(file: Path) -> StaticNoise:
    """Read what `imubayes noise --out` wrote.

    Raises
    ------
    InputError
        if the file is missing or no such record.
    """
    file = file / "noise.json" if file.is_dir() else file
    try:
        return StaticNoise.model_validate_json(file.read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        fault = "there is no such file" if not file.is_file() else "the file is not a noise record"
        allowed = "noise.json, as `imubayes noise CAMPAIGN --out FOLDER` writes it"
        raise input_error(fault, str(file), allowed, "give its path") from error


def refuse_other_unit(noise: StaticNoise, campaign: Campaign, where: str) -> None:
    """Raise InputError if a noise record is of another unit, or if nothing shows whether it is of this one."""
    if noise.serial == campaign.serial and (noise.serial or noise.campaign == campaign.name):
        return
    of = f"unit {noise.serial}" if noise.serial else f"campaign {noise.campaign}, which states no serial number"
    mine = f"unit {campaign.serial}" if campaign.serial else f"campaign {campaign.name}, which states no serial number"
    raise input_error(
        f"the noise record is from {of}, the constants are of {mine}", where, "a static record of the same unit",
        "record this unit and run `imubayes noise` on it, or use that record nevertheless with --noise-of-another-unit",
    )  # fmt: skip


def of_fit(result: Result, constants: OnboardConstants, rate: float | None) -> dict[str, NoiseDensity]:
    """Return the noise that a fit knows: white noise of one sample at a rate in Hz, a random walk if it has one."""
    walks = {
        QuantityName.of(line.name).label: line.mean
        for line in result.summary.parameters
        if family_of(line.name) == "random_walk_noise.k" and line.mean is not None
    }
    return {triad.kind: of_triad(triad, walks, rate) for triad in constants.triads}


def of_triad(triad: TriadConstants, walks: Mapping[str, float], rate: float | None) -> NoiseDensity:
    """Return the noise of a triad from that of a sample and random walks by channel, in output units over 1 h."""
    scales = dict(zip(triad.channels, triad.nominal_scale, strict=True))
    own = [walks.get(name, walks.get("all", 0.0)) / abs(scale) / _SECONDS for name, scale in scales.items()]
    return NoiseDensity(max(triad.sample_noise) / math.sqrt(rate) if rate else None, max(own) or None)


COVERAGE = 2.0
_TEMPERATURES = 11
_ALONG = 0.9

LossKind = Literal[
    "misalignment", "scale_factor", "g_sensitivity", "gain_temperature", "bias_order", "converter_temperature", "effect"
]


@dataclass(frozen=True)
class Abilities:
    """What a format holds beside biases.

    Attributes
    ----------
    matrix, g_sensitivity, gain_temperature : whether M, A and κ(T) are held.
    scale : kinds of channels of which the diagonal of M is held.
    bias_order : highest power of sensor temperature in b(T); None if there is no limit.
    converter : whether polynomials may depend on the converter's temperature.
    """

    matrix: bool
    g_sensitivity: bool
    gain_temperature: bool
    scale: tuple[str, ...]
    bias_order: int | None
    converter: bool


@dataclass(frozen=True)
class Loss:
    """One thing that a format cannot hold.

    Attributes
    ----------
    kind : what it is.
    triad : kind of channels.
    size, sd : largest error within the ranges of the campaign and its standard uncertainty, m/s² or rad/s.
    unit : of the two.
    effect : name of the effect, if it is one.
    """

    kind: LossKind
    triad: str
    size: float
    sd: float
    unit: str
    effect: str = ""

    @property
    def significant(self) -> bool:
        """Whether the error is larger than its expanded uncertainty."""
        return self.size > COVERAGE * self.sd


def losses(constants: OnboardConstants, able: Abilities) -> tuple[Loss, ...]:
    """Return what a format loses of the constants of a unit."""
    found: list[Loss] = []
    for triad in constants.triads:
        found += [] if able.matrix else _of_matrix(constants, triad, able)
        if triad.g_sensitivity is not None and not able.g_sensitivity:
            found.append(_of_g_sensitivity(constants, triad))
        if triad.gain.terms and not able.gain_temperature:
            found.append(_of_polynomial(constants, triad, "gain", np.ones(len(triad.gain.terms), dtype=bool)))
        found += _of_bias(constants, triad, able)
    units = {triad.kind: triad.unit for triad in constants.triads}
    found += [
        Loss("effect", each.kind, each.size or 0.0, each.sd or 0.0, units[each.kind], each.effect)
        for each in constants.unexpressed
        if each.kind in units
    ]
    return tuple(loss for loss in found if loss.size > NEGLIGIBLE)


def along_axes(triad: TriadConstants) -> bool:
    """Return whether there are three channels and each lies along its own body axis, x, y and z in this order."""
    matrix = np.array(triad.matrix)
    return matrix.shape == (3, 3) and bool((np.diag(matrix) > _ALONG * np.abs(matrix).sum(axis=1)).all())


def _names(triad: TriadConstants) -> np.ndarray:
    return np.array([[name_of("M", axis, name) for name in triad.channels] for axis in "xyz"])


def _deviations(constants: OnboardConstants, names: list[str]) -> np.ndarray:
    """Return the covariance of constants by name."""
    places = {constant.name: place for place, constant in enumerate(constants.constants)}
    chosen = [places[name] for name in names]
    return np.array(constants.covariance)[np.ix_(chosen, chosen)]


def _length(constants: OnboardConstants, values: np.ndarray, names: list[str]) -> tuple[float, float]:
    """Return the length of a vector of constants, and its standard uncertainty."""
    size = float(np.linalg.norm(values))
    toward = values / size if size else np.zeros(len(values))
    return size, float(np.sqrt(toward @ _deviations(constants, names) @ toward))


def _worst(kind: LossKind, triad: TriadConstants, sizes: list[tuple[float, float]], factor: float) -> Loss:
    """Return the loss of the worst of several errors, each with its standard uncertainty, times a factor."""
    size, sd = max(sizes, key=lambda each: each[0] - COVERAGE * each[1])
    return Loss(kind, triad.kind, size * factor, sd * factor, triad.unit)


def _of_matrix(constants: OnboardConstants, triad: TriadConstants, able: Abilities) -> list[Loss]:
    """Return the loss of the elements off the diagonal, of the worst axis, and of scale factors."""
    matrix, names = np.array(triad.matrix), _names(triad)
    rows = []
    for row in range(3):
        off = [column for column in range(matrix.shape[1]) if column != row]
        rows.append(_length(constants, matrix[row, off], names[row, off].tolist()))
    found = [_worst("misalignment", triad, rows, triad.input_range)]
    if triad.kind not in able.scale:
        sds = [float(np.sqrt(_deviations(constants, [names[k, k]])[0, 0])) for k in range(3)]
        scales = [(float(abs(matrix[k, k] - 1)), sd) for k, sd in enumerate(sds)]
        found.append(_worst("scale_factor", triad, scales, triad.input_range))
    return found


def _of_g_sensitivity(constants: OnboardConstants, triad: TriadConstants) -> Loss:
    accelerometers = constants.triad("accelerometer")
    span = accelerometers.input_range if accelerometers is not None else constants.gravity_m_s2
    rows = [
        _length(constants, row, [f"A[{axis},{other}]" for other in "xyz"])
        for axis, row in zip("xyz", np.array(triad.g_sensitivity), strict=True)
    ]
    return _worst("g_sensitivity", triad, rows, span)


def _of_bias(constants: OnboardConstants, triad: TriadConstants, able: Abilities) -> Iterator[Loss]:
    terms = triad.bias.terms
    by_converter = np.array([term.converter > 0 for term in terms])
    too_high = np.array([able.bias_order is not None and term.sensor > able.bias_order for term in terms])
    if not able.converter and by_converter.any():
        yield _of_polynomial(constants, triad, "converter_temperature", by_converter)
    if (too_high & ~by_converter).any():
        yield _of_polynomial(constants, triad, "bias_order", too_high & ~by_converter)


def _of_polynomial(
    constants: OnboardConstants,
    triad: TriadConstants,
    part: Literal["gain", "bias_order", "converter_temperature"],
    lost: np.ndarray,
) -> Loss:
    """Return the loss of some terms of a polynomial, at the worst temperature and channel."""
    of_gain = part == "gain"
    found: ThermalPolynomial = triad.gain if of_gain else triad.bias
    terms = [term for term, gone in zip(found.terms, lost, strict=True) if gone]
    grid = np.array(list(product(*(_span(constants, name) for name in ("temperature", "converter_temperature")))))
    warmer = grid - constants.reference_degC
    basis = np.stack([warmer[:, 0] ** term.sensor * warmer[:, 1] ** term.converter for term in terms], axis=1)
    name, each_channel = "gain" if of_gain else "bias", []
    powers = [f",{t.sensor},{t.converter}" if t.sensor or t.converter else "" for t in terms]
    for channel, coefficients in zip(triad.channels, np.array(found.coefficients)[:, lost], strict=True):
        covariance = _deviations(constants, [f"{name}[{channel}{power}]" for power in powers])
        sizes = np.abs(basis @ coefficients)
        place = int(sizes.argmax())
        sd = float(np.sqrt(basis[place] @ covariance @ basis[place]))
        each_channel.append((float(sizes[place]), sd))
    kind: LossKind = "gain_temperature" if part == "gain" else part
    return _worst(kind, triad, each_channel, triad.input_range if of_gain else 1.0)


def _span(constants: OnboardConstants, name: str) -> np.ndarray:
    low, high = constants.ranges_degC.get(name, (constants.reference_degC,) * 2)
    return np.linspace(low, high, _TEMPERATURES)

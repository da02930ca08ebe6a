"""Constants to use on board from the posterior of a fit: matrix, bias and gain polynomials, g-sensitivity.

Every constant is a function of the parameters and is computed for every draw: their means are the constants, their
covariance is that of all constants jointly, of gyros and accelerometers alike.
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.metadata import version

import numpy as np

from imubayes.foundations.covariates import REFERENCE_TEMPERATURE
from imubayes.foundations.errors import input_error
from imubayes.foundations.quantity_names import name_of
from imubayes.foundations.records import finite
from imubayes.inference.identifiability import WEAK_SHARE, from_data
from imubayes.results.fit_file import provenance
from imubayes.results.result import Result
from imubayes_qualification.onboard import record as onboard
from imubayes_qualification.onboard import unexpressed_effects as unexpressed
from imubayes_qualification.onboard.correct_recording import ReadingNoise, reading_noise
from imubayes_qualification.onboard.response import (
    NEGLIGIBLE,
    TEMPERATURES,
    LinearResponse,
    SensorPosterior,
    ThermalGrid,
    complete_kinds,
    linear_response,
    prior_values,
    sensor_posterior,
    sufficient_grid,
    temperature_ranges,
)

_AXES = "xyz"
_UNITS = {"gyro": "rad/s", "accelerometer": "m/s^2"}
_SAMPLE_FORCE, _SAMPLE_RATE = np.array([1.5, -2.5, 9.0]), np.array([0.2, -0.3, 0.5])


@dataclass(frozen=True)
class _Block:
    """Draws of one array of constants: their names, unit and values (S, n)."""

    names: tuple[str, ...]
    unit: str
    draws: np.ndarray


@dataclass(frozen=True)
class _Triad:
    """The arrays of constants of one kind of channels."""

    matrix: _Block
    bias: _Block
    gain: _Block
    g_sensitivity: _Block | None
    bias_terms: np.ndarray
    gain_terms: np.ndarray

    @property
    def blocks(self) -> list[_Block]:
        return [self.matrix, self.bias, self.gain, *([self.g_sensitivity] if self.g_sensitivity else [])]


def onboard_constants(result: Result) -> onboard.OnboardConstants:
    """Return the constants to use on board of a fitted unit.

    Raises
    ------
    InputError
        if the fit did not converge, or neither gyros nor accelerometers span three axes.
    """
    posterior = sensor_posterior(result)
    channels = posterior.campaign.channels
    kinds = complete_kinds(channels, [channel.name for channel in channels])
    if not kinds:
        raise input_error(
            "neither the gyros nor the accelerometers of the unit span three axes",
            str(result.folder or "this fit"), "three or more channels of a kind in different directions",
            "scale factor, misalignment and bias of each channel are in summary.json; `imubayes apply RESULT "
            "READINGS.csv --out FILE.csv`, on a table with a column per channel, gives the input along each axis",
        )  # fmt: skip
    needs = _needs(result)
    ranges = {name: span for name, span in temperature_ranges(posterior.campaign).items() if name in needs}
    grid = sufficient_grid(posterior, ranges, needs, kinds)
    triads = _triads(posterior, np.stack([posterior.at(draw) for draw in posterior.draws]), grid, kinds)
    before = prior_values(result, posterior)
    prior = None if before is None else _triads(posterior, before, grid, kinds, triads)
    noise = reading_noise(result, [channel for channel in channels if channel.kind in kinds])
    spans = unexpressed.input_ranges(posterior.campaign)
    made = {kind: _record(kind, triads[kind], posterior, grid, noise, spans[kind]) for kind in sorted(kinds)}
    records = _checked(made, posterior, ranges)
    constants = tuple(_constants(triads, prior))
    summary, origin = result.summary, provenance(result.fit, seed=0)
    return onboard.OnboardConstants(
        serial=posterior.campaign.serial,
        campaign=summary.campaign,
        model=summary.model,
        version=version("imubayes"),
        data_sha256=origin.data_sha256,
        model_sha256=origin.model_sha256,
        gravity_m_s2=posterior.campaign.site.gravity,
        reference_degC=REFERENCE_TEMPERATURE,
        needs=needs,
        ranges_degC=ranges,
        interval=summary.interval,
        posterior="sampled" if summary.sampled else "laplace",
        intervals_valid=summary.intervals_valid,
        triads=tuple(records.values()),
        constants=constants,
        covariance=_covariance(triads),
        not_determined=tuple(constant.name for constant in constants if not constant.measured),
        weak_directions=summary.weak_directions,
        exact=posterior.exact,
        unexpressed=unexpressed.unexpressed_effects(result, posterior, spans),
        slow_noise=noise.slow,
        conventions=onboard.CONVENTIONS,
        worked_sample=_sample(records, posterior, ranges),
    )


def _needs(result: Result) -> tuple[str, ...]:
    """Return the temperatures that constants can depend on."""
    effects = [effect for effect in result.fit.model.assembly.effects if unexpressed.acts_linearly(effect)]
    felt = {need for effect in effects for need in effect.effect_class.needs}
    return tuple(name for name in TEMPERATURES if name in felt)


def _covariance(triads: dict[str, _Triad]) -> tuple[tuple[float, ...], ...]:
    joined = np.concatenate([block.draws for kind in sorted(triads) for block in triads[kind].blocks], axis=1)
    return tuple(map(tuple, np.atleast_2d(np.cov(joined, rowvar=False)).tolist()))


def _triads(
    posterior: SensorPosterior,
    values: np.ndarray,
    grid: ThermalGrid,
    kinds: tuple[str, ...],
    like: dict[str, _Triad] | None = None,
) -> dict[str, _Triad]:
    """Return the constants of each kind for values (S, V); with the terms that another set has, if given."""
    found = linear_response(posterior, values, grid, kinds)
    return {kind: _triad(posterior, kind, found[kind], grid, None if like is None else like[kind]) for kind in kinds}


def _triad(
    posterior: SensorPosterior, kind: str, response: LinearResponse, grid: ThermalGrid, like: _Triad | None
) -> _Triad:
    names = [channel.name for channel in posterior.campaign.of_kind(kind)]
    reference = response.gain[:, :, 0]
    relative = response.gain / reference[:, :, None]
    mixing = np.linalg.pinv(reference[:, :, None] * response.axes)
    bias_terms = _kept(response.zero, grid) if like is None else like.bias_terms
    gain_terms = _kept(relative, grid) & (np.arange(len(grid.powers)) > 0) if like is None else like.gain_terms
    bias_terms = bias_terms | (np.arange(len(grid.powers)) == 0)
    powers = np.array([f",{i},{j}" if i or j else "" for i, j in grid.powers])
    count = len(response.zero)
    return _Triad(
        _Block(tuple(name_of("M", axis, name) for axis in _AXES for name in names), "1", mixing.reshape(count, -1)),
        _Block(
            tuple(name_of("bias", name + power) for name in names for power in powers[bias_terms]),
            _UNITS[kind], response.zero[:, :, bias_terms].reshape(count, -1),
        ),
        _Block(
            tuple(name_of("gain", name + power) for name in names for power in powers[gain_terms]),
            "1", relative[:, :, gain_terms].reshape(count, -1),
        ),
        _sensitivity(kind, mixing @ response.by_force, like),
        bias_terms, gain_terms,
    )  # fmt: skip


def _sensitivity(kind: str, found: np.ndarray, like: _Triad | None) -> _Block | None:
    """Return A, None if the model has no g-sensitivity."""
    absent = not np.abs(found).any() if like is None else like.g_sensitivity is None
    if kind != "gyro" or absent:
        return None
    names = tuple(name_of("A", row, column) for row in _AXES for column in _AXES)
    return _Block(names, "rad/s per m/s^2", found.reshape(len(found), -1))


def _kept(coefficients: np.ndarray, grid: ThermalGrid) -> np.ndarray:
    return np.abs(coefficients).max(axis=(0, 1)) * grid.reach > NEGLIGIBLE


def _record(
    kind: str, triad: _Triad, posterior: SensorPosterior, grid: ThermalGrid, noise: ReadingNoise, span: float
) -> onboard.TriadConstants:
    """Return the record of the constants of one kind; `error_left` is found once all kinds are known."""
    channels = posterior.campaign.of_kind(kind)
    scales = np.array([channel.scale_si for channel in channels])
    one, none = np.ones(1), np.zeros(1)
    white = [np.sqrt(noise.variances(c, one, none + c.offset)[0]) for c in channels]
    offsets = [noise.run_sd[channel.name] for channel in channels]
    sensitivity = triad.g_sensitivity
    return onboard.TriadConstants(
        kind="gyro" if kind == "gyro" else "accelerometer",
        unit=_UNITS[kind],
        channels=tuple(channel.name for channel in channels),
        output_units=tuple(channel.output_unit for channel in channels),
        nominal_scale=tuple(scales.tolist()),
        nominal_offset=tuple(float(channel.offset) for channel in channels),
        matrix=_rows(triad.matrix, 3),
        bias=_polynomial(triad.bias, triad.bias_terms, grid, len(channels)),
        gain=_polynomial(triad.gain, triad.gain_terms, grid, len(channels)),
        g_sensitivity=None if sensitivity is None else _rows(sensitivity, 3),
        input_range=span,
        error_left=0.0,
        sample_noise=tuple((np.array(white) / np.abs(scales)).tolist()),
        run_offset=tuple((np.array(offsets) / np.abs(scales)).tolist()),
    )


def _rows(block: _Block, rows: int) -> tuple[tuple[float, ...], ...]:
    return tuple(map(tuple, block.draws.mean(axis=0).reshape(rows, -1).tolist()))


def _polynomial(block: _Block, kept: np.ndarray, grid: ThermalGrid, channels: int) -> onboard.ThermalPolynomial:
    terms = tuple(onboard.ThermalPowers(sensor=int(i), converter=int(j)) for i, j in grid.powers[kept])
    return onboard.ThermalPolynomial(terms=terms, coefficients=_rows(block, channels))


def _constants(triads: dict[str, _Triad], prior: dict[str, _Triad] | None) -> Iterator[onboard.Constant]:
    """Yield every constant with its marginal posterior."""
    for kind in sorted(triads):
        before = prior[kind].blocks if prior is not None else [None] * len(triads[kind].blocks)
        for block, earlier in zip(triads[kind].blocks, before, strict=True):
            for place, name in enumerate(block.names):
                draws = block.draws[:, place]
                low, high = np.quantile(draws, [0.025, 0.975])
                share = None if earlier is None else from_data(np.var(draws), np.var(earlier.draws[:, place]))
                fixed = np.var(draws) == 0
                yield onboard.Constant(
                    name=name, unit=block.unit, value=float(draws.mean()), sd=float(draws.std(ddof=1)),
                    q025=float(low), q975=float(high),
                    from_data=None if share is None or fixed else finite(float(share)),
                    measured=not fixed and (share is None or float(share) >= WEAK_SHARE),
                )  # fmt: skip


def _with_error_left(record: onboard.TriadConstants, found: np.ndarray, true: np.ndarray) -> onboard.TriadConstants:
    return record.model_copy(update={"error_left": float(np.linalg.norm(found - true, axis=1).max())})


def body_inputs(
    triads: Mapping[str, onboard.TriadConstants],
    outputs: Mapping[str, np.ndarray],
    temperatures: np.ndarray,
    reference: float,
) -> dict[str, np.ndarray]:
    """Return what the constants make of outputs, kind → (R, 3), rad/s and m/s².

    Parameters
    ----------
    outputs : channel → (R,), output units.
    temperatures : of sensor and converter, shape (R, 2), °C.
    """
    found: dict[str, list[np.ndarray]] = {kind: [] for kind in triads}
    for row, (warm, converter) in enumerate(temperatures):
        force = None
        for kind in sorted(triads):
            r = onboard.nominal(triads[kind], {name: float(values[row]) for name, values in outputs.items()})
            vector = onboard.body_vector(
                triads[kind], onboard.unscaled(triads[kind], r, warm, converter, reference), force
            )
            force = vector if kind == "accelerometer" else force
            found[kind].append(vector)
    return {kind: np.array(rows) for kind, rows in found.items()}


def _checked(
    records: dict[str, onboard.TriadConstants], posterior: SensorPosterior, ranges: dict[str, tuple[float, float]]
) -> dict[str, onboard.TriadConstants]:
    """Return the records with their largest error against the model, within the ranges of inputs and temperatures."""
    spans = {kind: record.input_range for kind, record in records.items()}
    probes = unexpressed.probe_inputs(spans)
    temperatures = unexpressed.probe_temperatures(len(probes), ranges)
    modelled = unexpressed.modelled_outputs(posterior, posterior.values[None], probes, temperatures)
    outputs = {
        channel.name: modelled[kind][0, :, place]
        for kind in modelled
        for place, channel in enumerate(posterior.campaign.of_kind(kind))
    }
    found = body_inputs(records, outputs, temperatures, REFERENCE_TEMPERATURE)
    true = {"gyro": probes[:, :3], "accelerometer": probes[:, 3:]}
    return {kind: _with_error_left(record, found[kind], true[kind]) for kind, record in records.items()}


def _sample(
    records: dict[str, onboard.TriadConstants], posterior: SensorPosterior, ranges: dict[str, tuple[float, float]]
) -> onboard.WorkedSample:
    """Return a sample taken through the constants, ten degrees from T_ref if the model depends on temperature."""
    temperatures = [
        float(np.clip(REFERENCE_TEMPERATURE + 10, *ranges[name])) if name in ranges else REFERENCE_TEMPERATURE
        for name in TEMPERATURES
    ]
    stimulus, at = np.concatenate([_SAMPLE_RATE, _SAMPLE_FORCE])[None], np.array([temperatures])
    modelled = unexpressed.modelled_outputs(posterior, posterior.values[None], stimulus, at)
    outputs: dict[str, float] = {}
    for kind, record in records.items():
        outputs |= {n: float(f"{y:.10g}") for n, y in zip(record.channels, modelled[kind][0, 0], strict=True)}
    warm, converter = temperatures
    steps = [
        (r := onboard.nominal(record, outputs),
         r - onboard.polynomial(record.bias, warm, converter, REFERENCE_TEMPERATURE),
         onboard.unscaled(record, r, warm, converter, REFERENCE_TEMPERATURE))
        for record in records.values()
    ]  # fmt: skip
    joined = [tuple(np.concatenate(part).tolist()) for part in zip(*steps, strict=True)]
    read = {name: np.array([value]) for name, value in outputs.items()}
    vectors = body_inputs(records, read, at, REFERENCE_TEMPERATURE)

    def triple(kind: str) -> tuple[float, float, float] | None:
        return (*vectors[kind][0].tolist(),) if kind in vectors else None  # pyright: ignore[reportReturnType]

    return onboard.WorkedSample(
        temperature_degC=temperatures[0],
        converter_temperature_degC=temperatures[1],
        channels=tuple(name for record in records.values() for name in record.channels),
        outputs=tuple(outputs[name] for record in records.values() for name in record.channels),
        nominal=joined[0],
        unbiased=joined[1],
        unscaled=joined[2],
        rate_rad_s=triple("gyro"),
        force_m_s2=triple("accelerometer"),
    )

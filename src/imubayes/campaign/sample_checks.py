"""Counts and deviations of raw samples: standard errors in the place of deviations, and runs unlike their sisters.

They change what is known of the noise by a factor, which a fit takes for scatter that something missing makes.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from imubayes.campaign.stream_checks import Finding
from imubayes.foundations.campaign_data import Channel, Run
from imubayes.foundations.covariates import recorded

_SAME = math.log(1.5)
"""Logarithm of the ratio of two deviations up to which they are one: noise is stated to tens of per cent."""
_FEWEST, _MORE_SAMPLES = 9.0, math.log(8.0)
"""Samples of a row from which its standard error can be distinguished from its deviation.  Logarithm of how many times
as many samples a second as in sister runs are doubted.  Convention: a factor of two is another setting of the
logger."""
_SAME_UNIT = math.log(50.0)
"""Logarithm of the ratio of the deviations of two runs from which they are in different units.  Convention: vibration
makes them some tens of times as large."""
_DECADE = 0.1  # of a logarithm to base 10, within which a factor is a power of ten
_SISTERS, _ALIKE = 2, math.log(1.3)


def check_samples(runs: Sequence[Run], where: Sequence[str], channels: Sequence[Channel]) -> list[Finding]:
    """Return what counts and deviations of raw samples say against each other, against the noise and between runs.

    Parameters
    ----------
    where : place of each run, for messages.
    """
    return [*_standard_errors(runs, where, channels), *_deviations(runs, where, channels), *_counts(runs, where)]


def without_counts(run: str, deviations: Sequence[str], where: str) -> list[Finding]:
    """Return that a table has deviations of raw samples without the number of these: each row counts as one sample.

    Parameters
    ----------
    run, where : name of the run, and its table.
    deviations : columns of deviations.
    """
    if not deviations:
        return []
    return [
        Finding(
            "samples_missing", "warning", run,
            f"column '{deviations[0]}' holds standard deviations of raw samples, but no column 'samples' states their "
            "number: each row counts as one sample of a raw log",
            f"{where}, column 'samples'", "the number of raw samples of each row beside '…_sd'",
            "add the column 'samples', or leave out '…_sd'",
        )
    ]  # fmt: skip


def _standard_errors(runs: Sequence[Run], where: Sequence[str], channels: Sequence[Channel]) -> Iterator[Finding]:
    """Yield one finding for all channels whose recorded deviation is the stated noise over √samples."""
    told: dict[str, list[float]] = {}
    places = list[str]()
    for run, place in zip(runs, where, strict=True):
        # Those of the poses of a log are computed.
        for k, channel in enumerate(channels if run.tumble is None else ()):
            sd, good = run.sample_sd[:, k], np.isfinite(run.sample_sd[:, k]) & (run.samples >= _FEWEST)
            if not channel.noise or not good.any() or not np.median(sd[good]) > 0:
                continue
            root, ratio = math.sqrt(float(np.median(run.samples[good]))), float(np.median(sd[good])) / channel.noise
            if abs(math.log(ratio * root)) < _SAME < abs(math.log(ratio)):
                told.setdefault(channel.name, []).append(root)
                places.append(place)
    if told:
        root = float(np.median(np.concatenate([*told.values()])))
        yield Finding(
            "standard_errors", "warning", "",
            f"the deviations of {', '.join(told)} are the stated noise divided by √samples, {root:.3g}: they are "
            "standard errors of the means",
            f"{places[0]}, column '{next(iter(told))}_sd'" + (" and others" if len(places) > 1 else ""),
            "the standard deviation of the raw samples of the row",
            "multiply the columns '…_sd' by √samples, or correct 'noise' of the channels",
        )  # fmt: skip


def _deviations(runs: Sequence[Run], where: Sequence[str], channels: Sequence[Channel]) -> Iterator[Finding]:
    """Yield the runs whose deviations at rest are in another unit than those of the others, which agree.

    Where outputs are as many times as large, these are in another unit, and the set-up is judged by them.
    """
    sizes, levels = _sizes_at_rest(runs, channels)
    for k, (run, place) in enumerate(zip(runs, where, strict=True)):
        ratios = [_unlike(sizes[:, n], levels[:, n], k) for n in range(len(channels))]
        apart = {channel.name: ratio for channel, ratio in zip(channels, ratios, strict=True) if ratio}
        if apart:
            yield _of_deviations(run, apart, place)


def _sizes_at_rest(runs: Sequence[Run], channels: Sequence[Channel]) -> tuple[np.ndarray, np.ndarray]:
    """Return the logarithms of deviations, and of the largest outputs about their offset, each (runs, channels)."""
    sizes, levels = (np.full((len(runs), len(channels)), np.nan) for _ in range(2))
    for k, run in enumerate(runs):
        still = _at_rest(run)
        for n, channel in enumerate(channels):
            known = still & np.isfinite(run.sample_sd[:, n]) & (run.sample_sd[:, n] > 0)
            if known.any():
                sizes[k, n] = math.log(float(np.median(run.sample_sd[known, n])))
                levels[k, n] = float(np.max(np.abs(run.observed[known, n] - channel.offset)))
    with np.errstate(divide="ignore"):
        return sizes, np.log(levels)


def _unlike(sizes: np.ndarray, levels: np.ndarray, run: int) -> float:
    """Return the logarithm of how many times as large the deviations of a run are; 0 if they are in the same unit."""
    others = np.delete(sizes, run)
    others = others[np.isfinite(others)]
    if len(others) < _SISTERS or np.ptp(others) > _SAME_UNIT / 2:
        return 0.0
    apart = float(sizes[run] - np.median(others))
    moved = abs(levels[run] - np.nanmedian(np.delete(levels, run))) > _SAME_UNIT
    return apart if abs(apart) > _SAME_UNIT and not moved else 0.0


def _of_deviations(run: Run, apart: dict[str, float], place: str) -> Finding:
    """Return that deviations are in another unit, with the logarithms of how many times as large they are."""
    exponent = float(np.median([*apart.values()])) / math.log(10)
    factor = 10 ** (round(exponent) if abs(exponent - round(exponent)) < _DECADE else exponent)
    size, mend = (factor, "divide") if factor > 1 else (1 / factor, "multiply")
    names = ", ".join(f"'{name}_sd'" for name in apart)
    return Finding(
        "deviations_unlike", "warning", run.name,
        f"the deviations of {', '.join(apart)} are {size:.4g} times as {'large' if factor > 1 else 'small'} as in the "
        "other runs, as in another unit",
        f"{place}, column '{next(iter(apart))}_sd'",
        "the standard deviation of the raw samples of the row, in output units",
        f"{mend} the columns {names} of run '{run.name}' by {size:.4g} if they are in another unit",
    )  # fmt: skip


def _at_rest(run: Run) -> np.ndarray:
    """Return whether nothing turns in a row, shape (R,)."""
    rates = [run.covariates[each.name] for each in recorded() if each.si == "rad/s" and each.name in run.covariates]
    return np.all([each == 0 for each in rates], axis=0) if rates else np.ones(run.rows, dtype=bool)


def _counts(runs: Sequence[Run], where: Sequence[str]) -> Iterator[Finding]:
    """Yield the runs with many times as many samples a second as the others of their procedure."""
    rates = [_samples_a_second(run) for run in runs]
    for k, (run, place) in enumerate(zip(runs, where, strict=True)):
        others = [
            math.log(rate) for n, (rate, each) in enumerate(zip(rates, runs, strict=True))
            if rate and n != k and each.procedure == run.procedure
        ]  # fmt: skip
        own = rates[k]
        if not own or len(others) < _SISTERS or np.ptp(others) > _ALIKE:
            continue
        apart = math.log(own) - float(np.median(others))
        if abs(apart) > _MORE_SAMPLES:
            factor, more = math.exp(abs(apart)), "many" if apart > 0 else "few"
            yield Finding(
                "samples_unlike", "warning", run.name,
                f"'samples' is {factor:.3g} times too {more}, or the logger ran {factor:.3g} times as "
                f"{'fast' if apart > 0 else 'slowly'} as in the other runs: {own:.4g} samples a second",
                f"{place}, column 'samples'", "the number of raw samples of each row",
                f"correct 'samples' of run '{run.name}' unless its logger was set otherwise",
            )  # fmt: skip


def _samples_a_second(run: Run) -> float:
    """Return the samples over the time from row to row; 0 if it is not known."""
    time = run.covariates.get("time")
    if time is None or run.rows < 3 or run.tumble is not None:
        return 0.0
    step = float(np.median(np.diff(time)))
    return float(np.median(run.samples)) / step if step > 0 else 0.0

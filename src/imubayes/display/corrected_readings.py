"""What was made of a corrected recording, in sentences."""

from collections.abc import Iterable, Mapping, Sequence

from imubayes.display.fit_cautions import exact_text
from imubayes.foundations.covariates import COVARIATES
from imubayes.model.model_file import UncertainEquipment
from imubayes.qualification.onboard.inputs_along_axes import CalibratedInputs
from imubayes.qualification.onboard.record import UnexpressedEffect
from imubayes.qualification.onboard.recording_files import CorrectedRecording

_WORDS = {"gyro": "rate from the gyros", "accelerometer": "specific force from the accelerometers"}
_UNITS = {"gyro": "rad/s", "accelerometer": "m/s²"}
_INPUTS = {"gyro": "rate", "accelerometer": "specific force"}
_CAUSES = {
    "memory": "it depends on earlier rows", "limit": "it acts at a limit of the input",
    "covariate": "it depends on what the recording does not tell", "nonlinear": "it is not linear",
}  # fmt: skip


def left_in_lines(left_in: Iterable[UnexpressedEffect], uncertainty: str) -> list[str]:
    """Return each effect that is left in, with the size that it may have; `uncertainty` is the one that has it."""
    lines = []
    for effect in left_in:
        said = f"note: {effect.effect} of {', '.join(effect.channels)} is left in ({_CAUSES[effect.cause]})"
        if effect.size is not None and effect.sd is not None:
            where = "under the conditions of the runs that were fitted"
            said += f": up to {effect.size:.2g} ± {effect.sd:.1g} {_UNITS[effect.kind]} {where}; {uncertainty} has it"
        lines.append(said)
    return lines


def incomplete_lines(rows: int) -> list[str]:
    """Return that rows have empty cells, as a line; none where all are complete."""
    said = "lack an output, a temperature or a number of samples; their cells are empty"
    return [f"note: {rows} rows {said}"] * bool(rows)


def taken_as_exact_lines(exact: Sequence[UncertainEquipment], uncertainty: str) -> list[str]:
    """Return what the model takes as exact and an uncertainty contains nevertheless, as a line; none for nothing."""
    return [f"note: {uncertainty} contains {exact_text(exact)}, taken as exact by the model"] * bool(exact)


def beyond_lines(beyond: Mapping[str, int], ranges: Mapping[str, tuple[float, float]]) -> list[str]:
    """Return how many rows are beyond what was calibrated, for each quantity."""
    lines = []
    for name, rows in beyond.items():
        if rows and name in _INPUTS:
            largest = f"{ranges[name][1]:.4g} {_UNITS[name]}"
            lines.append(
                f"note: {rows} rows exceed the largest {_INPUTS[name]} of the runs that were fitted, {largest}"
            )
        elif rows:
            low, high = ranges[name]
            lines.append(
                f"note: {rows} rows are outside the calibrated range of {COVARIATES[name].column}, "
                f"{low:.4g} … {high:.4g} °C"
            )
    return lines


def correction_lines(found: CorrectedRecording) -> list[str]:
    """Return what the columns are, and what to know about them, one sentence each."""
    solved = " and ".join(_WORDS[kind] for kind in sorted(found.kinds, reverse=True))
    tally = found.tally
    lines = [
        f"{tally.rows} rows: {solved}, in body axes.",
        "The systematic uncertainty is the same for all rows; the random one averages over rows.",
    ]
    for kind, words in _INPUTS.items():
        if kind not in found.kinds and (names := [channel.name for channel in found.lacking if channel.kind == kind]):
            lines.append(f"note: there is no {words}: the recording lacks {', '.join(names)}")
    lines += incomplete_lines(tally.incomplete)
    if tally.unsolved:
        lines.append(f"note: {tally.unsolved} rows are outside the range of the model; their cells are empty")
    lines += beyond_lines(tally.beyond, found.ranges)
    if found.slow_noise:
        lines.append(f"note: {', '.join(found.slow_noise)} is in neither uncertainty")
    uncertainty = "the systematic uncertainty"
    return [*lines, *left_in_lines(found.uncorrected, uncertainty), *taken_as_exact_lines(found.exact, uncertainty)]


def inputs_lines(found: CalibratedInputs, nothing_across: bool) -> list[str]:
    """Return what to know about inputs along the axes of channels, one sentence each."""
    lines = [*incomplete_lines(found.incomplete), *beyond_lines(found.beyond, found.ranges)]
    lines += left_in_lines(found.left_in, "the uncertainty")
    lines += taken_as_exact_lines(found.exact, "the uncertainty")
    if found.left_in and not nothing_across:
        lines.append("note: each channel was treated alone; if there was no input across its axis, say --along-axes")
    return lines

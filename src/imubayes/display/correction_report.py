"""What was made of a corrected recording, in sentences."""

from imubayes.covariates import COVARIATES
from imubayes.qualification.recording_files import CorrectedRecording

_WORDS = {"gyro": "rate from the gyros", "accelerometer": "specific force from the accelerometers"}
_UNITS = {"gyro": "rad/s", "accelerometer": "m/s²"}
_CAUSES = {
    "memory": "it depends on earlier rows", "limit": "it acts at a limit of the input",
    "covariate": "it depends on what a row does not hold", "nonlinear": "it is not linear",
}  # fmt: skip


def correction_lines(found: CorrectedRecording) -> list[str]:
    """Return what the columns are, and what to know about them, one sentence each."""
    solved = " and ".join(_WORDS[kind] for kind in sorted(found.kinds, reverse=True))
    tally = found.tally
    lines = [
        f"{tally.rows} rows: {solved}, in body axes.",
        "The systematic uncertainty is the same for all rows; the random one averages over rows.",
    ]
    if tally.incomplete:
        lines.append(f"note: {tally.incomplete} rows lack an output or a temperature; their cells are empty")
    if tally.unsolved:
        lines.append(f"note: {tally.unsolved} rows are outside the range of the model; their cells are empty")
    for name, rows in tally.beyond.items():
        if rows:
            low, high = found.ranges[name]
            lines.append(
                f"note: {rows} rows are outside the calibrated range of {COVARIATES[name].column}, "
                f"{low:.4g} … {high:.4g} °C"
            )
    if found.slow_noise:
        lines.append(f"note: {', '.join(found.slow_noise)} is in neither uncertainty")
    for effect in found.uncorrected:
        said = f"note: {effect.effect} of {', '.join(effect.channels)} is left in ({_CAUSES[effect.cause]})"
        if effect.size is not None and effect.sd is not None:
            said += f": up to {effect.size:.2g} ± {effect.sd:.1g} {_UNITS[effect.kind]} in the campaign of the fit"
        lines.append(said)
    return lines

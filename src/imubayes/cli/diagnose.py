"""`imubayes diagnose`: what is missing."""

from pathlib import Path
from typing import TYPE_CHECKING

from imubayes.cli.options import Flag, Json, Trust, print_json

if TYPE_CHECKING:
    from imubayes.criticism.diagnosis_record import Diagnosis


def diagnose(
    result: Path,
    *,
    effect: str = "",
    as_json: Json = False,
    python: Flag = False,
    verbose: Flag = False,
    trust: Trust = False,
) -> int:
    """Say which effect the model lacks, from one pass and without a refit.

    Example: imubayes diagnose results/first

    Parameters
    ----------
    result
        Result folder of a fit.
    effect
        Ask about this effect alone: there, absent, or not to be seen by these runs.
    as_json
        Print one JSON object on standard output.
    python
        Print an effect class for the pattern that no effect of the catalogue explains: save it in a file, and add that
        with `imubayes add FILE.py`.
    verbose
        Print every table: all effects, noise, outliers, formulas and undetectable effects.
    trust
        Trust the effect files that come along: they are code, and run, now and later, only where they are trusted.
    """
    from imubayes.cli.session import progress, start_jax, trusting

    with progress() as tell:
        start_jax("diagnose")
        trusting(result, trust)
        from imubayes.api import diagnose as find_missing
        from imubayes.display.diagnosis_report import diagnosis_json, diagnosis_report, effect_source
        from imubayes.display.report_layout import print_report

        found = find_missing(result, effect, progress=tell)
        tell("drawing")
        pictures = _pictures(result, found)
    if python:
        print(effect_source(found))
    elif as_json:
        print_json(diagnosis_json(found))
    else:
        print_report(diagnosis_report(found, pictures, verbose))
    return 1 if found.verdict == "not_converged" else 0


def _pictures(result: Path, found: "Diagnosis") -> list[Path]:
    """Draw what the diagnosis rests on; Matplotlib is imported where there is something to draw."""
    pictures = []
    if found.evidence is not None:
        from imubayes.display.figures.evidence_pictures import save_evidence

        pictures.append(save_evidence(result, found.evidence))
    if found.disagreeing_noise and found.scatter is not None:
        from imubayes.display.figures.evidence_pictures import save_recorded_noise

        pictures.append(save_recorded_noise(result, found.scatter))
    return pictures

"""`imubayes diagnose`: what is missing."""

from pathlib import Path

from imubayes.cli.options import Flag, Json, print_json


def diagnose(
    result: Path,
    *,
    effect: str = "",
    as_json: Json = False,
    python: Flag = False,
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
        Print an effect class for the pattern that no effect of the catalogue explains: save it in a file beside the
        model and name the file in the model's 'files'.
    """
    from imubayes.cli.session import progress, start_jax

    start_jax()
    from imubayes.api import diagnose as find_missing
    from imubayes.display.diagnosis_report import found_class, write_diagnosis
    from imubayes.display.figures.save import save_telling
    from imubayes.display.terminal import print_diagnosis

    with progress() as tell:
        tell("looking for what is missing")
        found = find_missing(result, effect)
    picture = None
    if not effect:
        telling = found.telling[0] if found.telling else None
        picture = save_telling(result, telling, found.json) if telling else None
        named = (telling.channel, telling.covariate.name if telling.covariate else "") if telling else ()
        write_diagnosis(result, found.json, *named)
    if python:
        print(found_class(found.json))
    elif as_json:
        print_json(found.json)
    else:
        print_diagnosis(found.json, picture, effect)
    return 1 if found.verdict == "not_converged" else 0

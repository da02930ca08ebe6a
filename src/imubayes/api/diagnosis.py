"""Find what the model lacks."""

from collections.abc import Callable
from pathlib import Path

from imubayes.criticism.diagnose import judge
from imubayes.criticism.diagnosis_record import Diagnosis
from imubayes.display.notebook_progress import progress_of
from imubayes.inference.fitted_model import Fit
from imubayes.results.loop_files import write_diagnosis
from imubayes.results.result import Result, read_result


def diagnose(
    result: Result | Fit | str | Path, effect: str = "", *, progress: Callable[[str], None] | None = None
) -> Diagnosis:
    """Return which physical effect is missing in a fit, or that none is, from one pass and without a refit.

    What was found is kept in the result folder, where there is one: `add` starts from it.

    Parameters
    ----------
    result : a result, its folder, or a fitted model.
    effect : ask about this effect alone; such an answer is not kept.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for a folder that holds no result, or one whose campaign is gone or has changed.
    """
    with progress_of(progress) as tell:
        tell("reading the fit")
        if isinstance(result, Fit):
            return judge(result, effect=effect, progress=tell)
        read = result if isinstance(result, Result) else read_result(result)
        found = judge(read.fit, str(read.folder or "RESULT"), effect, tell)
    if read.folder is not None and not effect:
        write_diagnosis(read.folder, found, read.identity)
    return found

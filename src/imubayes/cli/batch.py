"""`imubayes batch`: every campaign of an archive fitted with one model."""

from pathlib import Path
from typing import Literal

import cyclopts

from imubayes.cli.options import Flag, Json, print_json

batch = cyclopts.App(name="batch", help="Fit every campaign of an archive with one model, and compare the units.")


@batch.default
def fit_all(
    archive: Path,
    *,
    model: Path,
    out: Path,
    sample: Literal["all", "none"] = "none",
    diagnose: Flag = False,
    seed: int = 0,
    retry: Flag = False,
    as_json: Json = False,
) -> int:
    """Fit every campaign of an archive, or of a folder of campaigns, that has no result yet.

    An interrupted batch goes on when it is run again; what is done is kept.  A campaign that cannot be fitted is listed
    with its reason and stops nothing.

    Example: imubayes batch archive --model models/trihedral-imu.toml --out results/archive

    Parameters
    ----------
    archive
        Archive, or folder with campaign folders.
    model
        Model file.
    out
        Results folder.
    sample
        Units whose posterior is sampled; the others have the Laplace approximation.
    diagnose
        Diagnose each fit; the verdict is in the table.
    seed
        Seed of the sampler.
    retry
        Try campaigns without estimates again, not only those whose files have changed.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.cli.session import progress, start_jax

    start_jax()
    from imubayes.batch.batch_settings import BatchSettings
    from imubayes.batch.fit_unit import in_process
    from imubayes.batch.posterior_table import read_units
    from imubayes.batch.run_batch import run_batch
    from imubayes.display.batch_report import batch_json, batch_report, progress_text
    from imubayes.display.report_layout import print_report

    settings = BatchSettings(sample, diagnose, seed)
    with progress() as tell:
        tell("listing the campaigns")
        state = run_batch(
            archive, model, out, in_process, settings, retry=retry, progress=lambda state: tell(progress_text(state))
        )
    units = read_units(out, state.key)
    if as_json:
        print_json(batch_json(state, units, state.key))
    else:
        print_report(batch_report(state, units, out))
    return 1 if (units["status"] != "fitted").any() else 0

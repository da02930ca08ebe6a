"""Effect files that come along with a result."""

from pathlib import Path

from imubayes.model.model_file import read_model
from imubayes.model.trusted_effects import trust_files
from imubayes.results.record_names import MODEL


def trust(place: str | Path) -> tuple[Path, ...]:
    """Remember the effect files of a result folder or a model file, or one such file, as trusted; return them.

    Effect files are code.  They run where the user names their model; those that come along with a result run only
    where they are trusted, as they are: a file that was changed is another one.

    Raises
    ------
    InputError
        where they cannot be read.
    """
    place = Path(place)
    model = place / MODEL if place.is_dir() else place
    files = (place,) if place.suffix == ".py" else tuple(map(Path, read_model(model).files))
    trust_files(files)
    return files

"""What a fit comes from, as a record."""

from imubayes.json_record import Record


class SoftwareVersion(Record):
    """A package and its version."""

    package: str
    version: str


class FitProvenance(Record):
    """What a fit comes from.

    Attributes
    ----------
    serial : serial number of the unit; empty where the campaign states none.
    first_run, last_run : earliest and latest start of a run, ISO 8601 as in the campaign; None where no run states one.
    fitted : when the fit was made, ISO 8601 in UTC.
    data_sha256, model_sha256 : identify the data and the model, as in `fit.json`.
    seed : of the sampler.
    software : versions that made the fit.
    """

    serial: str
    first_run: str | None
    last_run: str | None
    fitted: str
    data_sha256: str
    model_sha256: str
    seed: int
    software: tuple[SoftwareVersion, ...]

"""An estimate far from its prior, as a record."""

from typing import Literal

from imubayes.json_record import Record


class PriorConflict(Record):
    """A parameter whose prior disagrees with the data.

    Attributes
    ----------
    name, unit, effect, parameter : of the parameter.
    prior_mean, prior_sd : median and standard deviation of the prior, in the unit; None where it has none.
    value, sd : posterior mode and standard deviation, in the unit.
    data_value, data_sd : what the data alone ask for, in the unit.
    distance : between prior and data, in standard deviations of their difference.
    decided_by : which of the two contributes more to the estimate.
    stated_in : where the prior is to be changed: the model file, or the equipment's uncertainty in the campaign file.
    wider : a prior that has room for what the data ask for, as written in a model file; empty for other families.
    """

    name: str
    unit: str
    effect: str
    parameter: str
    prior_mean: float
    prior_sd: float | None
    value: float
    sd: float
    data_value: float
    data_sd: float
    distance: float
    decided_by: Literal["prior", "data"]
    stated_in: Literal["model", "campaign"]
    wider: str

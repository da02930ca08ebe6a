"""How the noise departs from its model, as a record."""

from typing import Literal

from imubayes.json_record import Record

NoiseKind = Literal[
    "autocorrelation", "low_frequency", "scatter_between_runs", "grows_with_input", "heavy_tails", "quantisation"
]


class NoiseViolation(Record):
    """A way in which the noise is not as the model says.

    Attributes
    ----------
    kind : what is wrong.
    channels : names.
    p : p-value under the noise of the model; None for quantisation, which is no matter of chance.
    step : quantisation step over the noise standard deviation; None for all else.
    """

    kind: NoiseKind
    channels: tuple[str, ...]
    p: float | None = None
    step: float | None = None

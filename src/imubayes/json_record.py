"""Base of the typed records that are kept as JSON."""

import math

from pydantic import BaseModel, ConfigDict


class Record(BaseModel):
    """Base of everything that a result folder keeps as JSON, and of what `--json` prints."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)


def finite(value: float) -> float | None:
    """Return a number for JSON; None for a non-finite value."""
    return float(value) if math.isfinite(value) else None

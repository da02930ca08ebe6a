"""Base of the typed records that are kept as JSON."""

import math

from pydantic import BaseModel, ConfigDict


class Record(BaseModel):
    """Base of everything that a result folder keeps as JSON, and of what `--json` prints."""

    model_config = ConfigDict(extra="ignore", frozen=True, allow_inf_nan=False)

    def json_text(self) -> str:
        """Return the record as the text of a JSON file."""
        return self.model_dump_json(indent=1) + "\n"


def finite(value: float) -> float | None:
    """Return a number for JSON; None for a non-finite value."""
    return float(value) if math.isfinite(value) else None

"""Names of quantities: a family and, in brackets, what the quantity is of, as `gyro_bias.bias[gx]`.

The family of a parameter is `effect.parameter`, that of a derived quantity a word, as in `mounting_angle[gx,pyramid]`.
Names are written and read here alone.  Those of channels, mountings, tables and runs have neither brackets nor commas.
"""

from dataclasses import dataclass
from functools import cached_property, lru_cache

INPUT_AXIS, SCALE_FACTOR, MOUNTING_ANGLE, AXIS_ANGLE, DELTA_K = (
    "input_axis", "scale_factor", "mounting_angle", "axis_angle", "delta_k",
)  # fmt: skip
"""Families of derived quantities."""


@dataclass(frozen=True)
class QuantityName:
    """The name of a quantity.

    Attributes
    ----------
    family : what it is.
    labels : what it is of: channels, mountings, tables, runs, components; none of a quantity that stands alone.
    """

    family: str
    labels: tuple[str, ...] = ()

    @staticmethod
    def of(text: str) -> "QuantityName":
        """Return the parts of a name; a text without brackets is a family alone."""
        return _parts(text)

    def __str__(self) -> str:
        return f"{self.family}[{self.label}]" if self.labels else self.family

    @cached_property
    def label(self) -> str:
        """The labels as they stand in the brackets."""
        return ",".join(self.labels)

    @property
    def effect(self) -> str:
        """The effect of a parameter; the family of a derived quantity."""
        return self.family.partition(".")[0]

    @property
    def parameter(self) -> str:
        """The parameter within its effect; empty of a derived quantity."""
        return self.family.partition(".")[2]

    @property
    def parts(self) -> tuple[str, str]:
        """The effect, and the name within it, as ``gyro_bias`` and ``bias[gx]``; a derived quantity has no second."""
        return (self.effect, str(QuantityName(self.parameter, self.labels))) if self.parameter else (str(self), "")

    @property
    def first(self) -> str:
        """The first label, which is the channel if there is one; empty if there is none."""
        return self.labels[0] if self.labels else ""


@lru_cache(maxsize=100_000)
def _parts(text: str) -> QuantityName:
    family, bracket, label = text.partition("[")
    return QuantityName(family, tuple(label.removesuffix("]").split(",")) if bracket else ())


def family_of(text: str) -> str:
    """Return the family of a quantity by its name."""
    return _parts(text).family


def name_of(family: str, *labels: str) -> str:
    """Return the name of a quantity."""
    return str(QuantityName(family, labels))

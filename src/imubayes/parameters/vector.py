"""The flat parameter vector: names and places on the host, and the transform from z to values on the device.

A `Layout` is the list of scalar parameters.  `Priors` holds their priors stacked by family, so that a whole vector is
transformed from z to SI values in a few array operations, and a stack of units in one vmap.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from imubayes.array_shapes import Array, Float, Int
from imubayes.gather import take
from imubayes.parameters.priors import Prior
from imubayes.units import with_output_unit


@dataclass(frozen=True)
class Parameter:
    """One scalar parameter: `effect.parameter[label]` with unit, the unit's SI value, and prior in SI.

    `output` is what the word `output` in its unit stands for; empty where that is not one unit.  `typical` are the
    smallest and the largest magnitude met in practice, in the unit.
    """

    effect: str
    field: str
    label: tuple[str, ...]
    unit: str
    factor: float
    prior: Prior
    nuisance: bool = False
    output: str = ""
    typical: tuple[float, float] = (0.0, np.inf)

    @property
    def shown_unit(self) -> str:
        """The unit as it is shown; `unit` is that of model files and priors."""
        return with_output_unit(self.unit, self.output)

    @cached_property
    def name(self) -> str:
        """The full name, as in model files, on the command line and in results."""
        return f"{self.effect}.{self.field}[{','.join(self.label)}]"

    @property
    def prior_sd(self) -> float:
        """Standard deviation of the prior in the datasheet unit."""
        return self.prior.sd() / self.factor

    def z_at(self, value: float) -> float | None:
        """Return z of a value in the parameter's unit; None where its prior excludes that value."""
        try:
            z = float(self.prior.z(value * self.factor))
        except (ValueError, ZeroDivisionError, OverflowError):
            return None
        return z if np.isfinite(z) else None


@dataclass(frozen=True)
class Layout:
    """The scalar parameters in the order of the flat vector."""

    parameters: tuple[Parameter, ...]

    def __len__(self) -> int:
        return len(self.parameters)

    @cached_property
    def names(self) -> tuple[str, ...]:
        """All names in order."""
        return tuple(parameter.name for parameter in self.parameters)

    def index(self, name: str) -> int:
        """Return the place of a parameter; raises ValueError for an unknown name."""
        return self.names.index(name)

    def factors(self) -> np.ndarray:
        """Return the SI value of each parameter's unit, shape (P,)."""
        return np.array([parameter.factor for parameter in self.parameters], dtype=float)

    def carried(self, source: "Layout", point: np.ndarray, default: np.ndarray | float = 0.0) -> np.ndarray:
        """Return a point of another layout in this one, matched by name.

        Parameters
        ----------
        source : the other layout.
        point : z in that layout, shape (its length,).
        default : z of parameters that the other layout lacks, shape (P,) or a scalar; 0 is the prior median.
        """
        values = dict(zip(source.names, point.tolist(), strict=True))
        defaults = np.broadcast_to(default, len(self)).tolist()
        return np.array([values.get(name, z) for name, z in zip(self.names, defaults, strict=True)], dtype=float)

    def z_of(self, values: Sequence[float] | np.ndarray) -> np.ndarray:
        """Return z of values given in datasheet units, shape (P,)."""
        pairs = zip(self.parameters, values, strict=True)
        return np.array([float(p.prior.z(value * p.factor)) for p, value in pairs])


class Priors(eqx.Module):
    """The priors of a whole vector, stacked by family.

    `sorted_by_family` lists the places of the vector family by family; `order` is its inverse.
    """

    families: tuple[Prior, ...]
    sorted_by_family: Int[Array, " P"] | np.ndarray
    order: Int[Array, " P"] | np.ndarray
    counts: tuple[int, ...] = eqx.field(static=True)

    @staticmethod
    def stack(priors: Sequence[Prior]) -> "Priors":
        """Sort priors by family and stack their numbers."""
        kinds = list(dict.fromkeys(type(prior) for prior in priors))
        places = [[i for i, prior in enumerate(priors) if type(prior) is kind] for kind in kinds]
        stacked = tuple(
            jax.tree.map(lambda *leaves: np.asarray(leaves, dtype=float), *[priors[i] for i in indices])
            for indices in places
        )
        flat = np.array([i for indices in places for i in indices], dtype=int)
        return Priors(stacked, flat, np.argsort(flat, kind="stable"), tuple(map(len, places)))

    def values(self, z: Float[Array, " P"]) -> Float[Array, " P"]:
        """Return SI values of a vector of z."""
        if not self.families:
            return z
        sorted_z, parts, start = take(z, self.sorted_by_family), [], 0
        for family, count in zip(self.families, self.counts, strict=True):
            chosen = sorted_z[start : start + count]
            parts.append(jax.vmap(lambda prior, z_of: prior.value(z_of))(family, chosen))
            start += count
        return take(jnp.concatenate(parts), self.order)

    def slopes(self, z: Float[Array, " P"]) -> Float[Array, " P"]:
        """Return the derivative of each value by its own z."""
        return jax.jvp(self.values, (z,), (jnp.ones_like(z),))[1]

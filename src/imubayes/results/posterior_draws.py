"""Draws of the posterior by the names of the summary, out of the named arrays of `posterior.nc`.

The file holds one variable per family, `gyro_scale_factor.scale` over (chain, draw, labels) with named coordinates;
the summary speaks of its members, `gyro_scale_factor.scale[gx]`.  Only the families asked for are read.
"""

from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np

_CHAINS = ("chain", "draw")


def family(name: str) -> str:
    """Return the variable that holds a member: `a.b` of `a.b[c,d]`."""
    return name.partition("[")[0]


def members(name: str, values: np.ndarray, labels: Iterable[Iterable[Any]]) -> dict[str, np.ndarray]:
    """Return the members of a family, each a flat array of draws, NaN where one was not computed.

    Parameters
    ----------
    name : of the family.
    values : shape (chain, draw, …).
    labels : of each further dimension, in order.
    """
    axes = [[_text(label) for label in axis] for axis in labels]
    flat = values.reshape(values.shape[0] * values.shape[1], -1)
    found = {}
    for place, parts in enumerate(product(*axes)):
        # A grid over two labels may have holes: a channel that was never in a mounting.
        if np.isfinite(flat[:, place]).any():
            label = ",".join(parts)
            found[f"{name}[{label}]" if label else name] = flat[:, place]
    return found


def complete(draws: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return those draws in which every member is known; derived quantities are kept for some draws only."""
    if not draws:
        return {}
    known = np.isfinite(np.stack(list(draws.values()))).all(axis=0)
    return {name: column[known] for name, column in draws.items()}


def thinned(draws: Mapping[str, np.ndarray], most: int) -> dict[str, np.ndarray]:
    """Return at most so many draws, evenly spaced."""
    count = len(next(iter(draws.values()), ()))
    chosen = slice(None) if count <= most else np.linspace(0, count - 1, most).astype(int)
    return {name: column[chosen] for name, column in draws.items()}


def read_draws(file: Path, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Return the draws of the named members that the file holds.

    Raises
    ------
    OSError, KeyError, ValueError
        if the file is not a readable posterior.
    """
    wanted = list(dict.fromkeys(names))
    found: dict[str, np.ndarray] = {}
    with h5netcdf.File(file, "r", phony_dims="access", decode_vlen_strings=True) as tree:
        if "posterior" not in tree.groups:
            raise KeyError("there is no group 'posterior'")
        group = tree.groups["posterior"]
        for name in dict.fromkeys(family(one) for one in wanted):
            if name in group.variables:
                variable = group.variables[name]
                dimensions = [d for d in variable.dimensions if d not in _CHAINS]
                order = [variable.dimensions.index(d) for d in (*_CHAINS, *dimensions)]
                labels = [_labels(group, tree, d, variable) for d in dimensions]
                found |= members(name, np.transpose(np.asarray(variable[...]), order), labels)
    return {name: found[name] for name in wanted if name in found}


def draws_of(posterior: Any, names: Iterable[str]) -> dict[str, np.ndarray]:
    """Return the draws of the named members.

    Parameters
    ----------
    posterior : DataTree with a group `posterior`, that group or its Dataset, a path to such a file, or draws by name.
    names : as in the summary; what is not there is left out.
    """
    wanted = list(dict.fromkeys(names))
    if isinstance(posterior, str | Path):
        return read_draws(Path(posterior), wanted)
    if isinstance(posterior, dict):
        return {name: posterior[name].reshape(-1) for name in wanted if name in posterior}
    group = posterior["posterior"] if "posterior" in getattr(posterior, "children", {}) else posterior
    found: dict[str, np.ndarray] = {}
    for name in dict.fromkeys(family(one) for one in wanted):
        if name in group.data_vars:
            variable = group[name]
            dimensions = [d for d in variable.dims if d not in _CHAINS]
            labels = [group[d].values if d in group.coords else range(variable.sizes[d]) for d in dimensions]
            found |= members(name, variable.transpose(*_CHAINS, *dimensions).values, labels)
    return {name: found[name] for name in wanted if name in found}


def _labels(group: Any, tree: Any, dimension: str, variable: Any) -> Iterable[Any]:
    for place in (group, tree):
        if dimension in place.variables:
            return place.variables[dimension][...]
    return range(variable.shape[variable.dimensions.index(dimension)])


def _text(label: Any) -> str:
    return label.decode() if isinstance(label, bytes) else str(label)

"""Draws of the posterior by the names of the summary: ``gyro_bias.bias[gx]`` of the variable ``gyro_bias.bias``."""

from collections.abc import Iterable, Mapping
from itertools import product
from pathlib import Path
from typing import TYPE_CHECKING

import lazy_loader
import numpy as np

if TYPE_CHECKING:
    import xarray
else:
    xarray = lazy_loader.load("xarray")  # takes long to import, and few commands need it

_SAMPLE = ("chain", "draw")


Draws = dict[str, np.ndarray]


def draws_of(posterior: "xarray.DataTree | xarray.Dataset | Draws | Path | str", names: Iterable[str]) -> Draws:
    """Return the draws of the named members, each (chain · draw,); what is not there is left out.

    Parameters
    ----------
    posterior : tree with a group `posterior`, that group or its dataset, the path of such a file, or draws by name.
    names : as in the summary.

    Raises
    ------
    OSError, KeyError, ValueError
        if a file is not a readable posterior.
    """
    if isinstance(posterior, str | Path):
        with xarray.open_dataset(posterior, group="posterior", engine="h5netcdf") as group:
            return draws_of(group, names)
    if isinstance(posterior, dict):
        return {name: posterior[name].reshape(-1) for name in names if name in posterior}
    group = posterior["posterior"] if "posterior" in getattr(posterior, "children", ()) else posterior
    data = group.to_dataset() if isinstance(group, xarray.DataTree) else group
    wanted = list(dict.fromkeys(names))
    found: dict[str, np.ndarray] = {}
    for variable in dict.fromkeys(name.partition("[")[0] for name in wanted):
        if variable in data.data_vars:
            found |= _members(variable, data[variable])
    return {name: found[name] for name in wanted if name in found}


def _members(name: str, variable: "xarray.DataArray") -> dict[str, np.ndarray]:
    """Return the members of a variable by name; combinations of labels that do not exist are left out."""
    dimensions = [dimension for dimension in variable.dims if dimension not in _SAMPLE]
    values = variable.transpose(*_SAMPLE, *dimensions).to_numpy()
    flat = values.reshape(values.shape[0] * values.shape[1], -1)
    labels = [map(str, variable[dimension].to_numpy()) for dimension in dimensions]
    named = {
        f"{name}[{','.join(label) or 'all'}]": column for label, column in zip(product(*labels), flat.T, strict=True)
    }
    return {member: column for member, column in named.items() if np.isfinite(column).any()}


def complete(draws: Mapping[str, np.ndarray]) -> dict[str, np.ndarray]:
    """Return those draws in which every member is known; derived quantities are computed for some draws only."""
    if not draws:
        return {}
    known = np.isfinite(np.stack(list(draws.values()))).all(axis=0)
    return {name: column[known] for name, column in draws.items()}


def thinned(draws: Mapping[str, np.ndarray], most: int) -> dict[str, np.ndarray]:
    """Return at most `most` draws, evenly spaced."""
    count = len(next(iter(draws.values()), ()))
    chosen = slice(None) if count <= most else np.linspace(0, count - 1, most).astype(int)
    return {name: column[chosen] for name, column in draws.items()}

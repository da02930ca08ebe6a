"""The file with the posterior draws, `posterior.nc`: the groups of ArviZ's schema as netCDF 4.

Written by h5netcdf alone.  xarray, which reads the file, would write the same, but with pandas and Dask it takes longer
to import than the file takes to write.
"""

from pathlib import Path

import h5netcdf
import h5py

from imubayes.inference.posterior_groups import Group, Groups
from imubayes.inference.posterior_variables import Labelled


def write_posterior(groups: Groups, file: Path) -> None:
    """Write groups; a reader that follows the CF conventions finds each coordinate."""
    with h5netcdf.File(file, "w") as root:
        root.attrs.update(groups.attributes)
        for name, group in groups.named.items():
            _write(root.create_group(name), group)


def _write(place: h5netcdf.Group, group: Group) -> None:
    whole = {**group.coordinates, **group.variables}
    place.attrs.update(group.attributes)
    place.dimensions = {
        dimension: size
        for each in whole.values()
        for dimension, size in zip(each.dimensions, each.values.shape, strict=True)
    }
    for name, each in whole.items():
        # A coordinate that has not the name of its dimension is named by each variable that it belongs to.
        further = [
            label
            for label, coordinate in group.coordinates.items()
            if name not in group.coordinates
            and label not in each.dimensions
            and set(coordinate.dimensions) <= set(each.dimensions)
        ]
        about = dict(each.attributes) | ({"coordinates": " ".join(further)} if further else {})
        _create(place, name, each).attrs.update(about)


def _create(place: h5netcdf.Group, name: str, each: Labelled) -> h5netcdf.Variable:
    if each.values.dtype.kind != "U":
        return place.create_variable(name, each.dimensions, data=each.values)
    variable = place.create_variable(name, each.dimensions, dtype=h5py.string_dtype())
    variable[...] = each.values.astype(object)
    return variable

"""The posterior as an ArviZ tree."""

from typing import TYPE_CHECKING

import lazy_loader

from imubayes.inference.posterior_groups import Group, Groups
from imubayes.inference.posterior_variables import Labelled

if TYPE_CHECKING:
    import xarray
else:
    xarray = lazy_loader.load("xarray")  # takes long to import, and few commands need it


def posterior_tree(groups: Groups) -> "xarray.DataTree":
    """Return groups as a tree, with what is said of the whole at its root."""
    tree = xarray.DataTree.from_dict({name: _dataset(group) for name, group in groups.named.items()})
    tree.attrs = dict(groups.attributes)
    return tree


def _dataset(group: Group) -> "xarray.Dataset":
    variables = {name: _variable(each) for name, each in group.variables.items()}
    coordinates = {name: _variable(each) for name, each in group.coordinates.items()}
    return xarray.Dataset(variables, coordinates, dict(group.attributes))


def _variable(each: Labelled) -> "xarray.Variable":
    return xarray.Variable(each.dimensions, each.values, dict(each.attributes))

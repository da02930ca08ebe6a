"""The writer of the result folder, and of its file with the posterior draws, `posterior.nc`.

A result is written to a scratch folder and put in place as a whole, its manifest last (see
`imubayes.results.folder_files`).

The posterior file holds the groups of ArviZ's schema as netCDF 4, which is HDF5 with a scale for each dimension: h5py
writes it.  xarray and h5netcdf, which read the file, would write the same, but the one takes longer to import, and the
other to look up its dimensions, than the file takes to write.
"""

import shutil
from collections.abc import Iterator, Mapping
from dataclasses import replace
from itertools import count
from pathlib import Path
from typing import TYPE_CHECKING, Any

import h5py
import numpy as np
import polars as pl
import tomlkit
from tomlkit.items import AoT

from imubayes.foundations.files import refuse_existing, write_text
from imubayes.loop.model_history import Node
from imubayes.model.model_file import ModelSpec
from imubayes.results import folder_files
from imubayes.results.fit_file import fit_record
from imubayes.results.posterior_groups import SAMPLE, Group, Groups, Labelled, Labels, posterior_groups
from imubayes.results.result import Result

if TYPE_CHECKING:  # it reads diagnoses and refits, which a fit does not
    from imubayes.results.change_records import ModelChange

_NO_VARIABLE = "This is a netCDF dimension but not a netCDF variable."
# Arrays of fewer bytes are not compressed; a block of draws has about so many values, or all draws of a number.
_COMPRESSED, _BLOCK = 4096, 1600


def write_posterior(groups: Groups, file: Path) -> None:
    """Write groups; a reader that follows the CF conventions finds each coordinate."""
    # In memory: HDF5 crashes the process if the disk is full.
    with h5py.File(file.name, "w", driver="core", backing_store=False, track_order=True) as root:
        about = f"version=2,hdf5={h5py.version.hdf5_version},h5py={h5py.version.version}"
        root.attrs["_NCProperties"] = np.bytes_(about)
        _describe(root, groups.attributes)
        numbers = count()
        for name, group in groups.named.items():
            _write(root.create_group(name, track_order=True), group, numbers)
        root.flush()
        image = root.id.get_file_image()
    file.write_bytes(image)


def _describe(place: h5py.Group | h5py.Dataset, attributes: Mapping[str, Any]) -> None:
    """Write attributes; netCDF has no single numbers among them."""
    for name, value in attributes.items():
        place.attrs[name] = value if isinstance(value, str) else np.atleast_1d(value)


def _write(place: h5py.Group, group: Group, numbers: Iterator[int]) -> None:
    """Write a group: its dimensions, which are numbered through the file, as scales that its variables refer to."""
    _describe(place, group.attributes)
    whole = {name: _stored(each) for name, each in {**group.coordinates, **group.variables}.items()}
    sizes = {
        dimension: size
        for each in whole.values()
        for dimension, size in zip(each.dimensions, each.values.shape, strict=True)
    }
    number = {dimension: np.int32(next(numbers)) for dimension in sizes}
    made = {name: _create(place, name, each) for name, each in whole.items()}
    for dimension, size in sizes.items():
        if dimension in whole:
            made[dimension].make_scale(dimension)
        else:
            made[dimension] = place.create_dataset(dimension, (size,), ">f4", track_order=True)
            made[dimension].make_scale(f"{_NO_VARIABLE}{size:10}")
        made[dimension].attrs["_Netcdf4Dimid"] = number[dimension]
    for name, each in whole.items():
        # A scale cannot refer to the scale of its second dimension: the numbers say what its dimensions are.
        for axis, dimension in enumerate(each.dimensions if name not in sizes else ()):
            made[name].dims[axis].attach_scale(made[dimension])
        made[name].attrs["_Netcdf4Coordinates"] = np.array([number[each] for each in each.dimensions], np.int32)
        _describe(made[name], dict(each.attributes) | _further(name, each, group))


def _further(name: str, each: Labelled, group: Group) -> dict[str, str]:
    """Return the attribute that names the coordinates of a variable that have not the name of a dimension of it."""
    found = [
        label
        for label, coordinate in group.coordinates.items()
        if name not in group.coordinates
        and label not in each.dimensions
        and set(coordinate.dimensions) <= set(each.dimensions)
    ]
    return {"coordinates": " ".join(found)} if found else {}


def _create(place: h5py.Group, name: str, each: Labelled) -> h5py.Dataset:
    return place.create_dataset(name, data=each.values, track_order=True, **_packing(each.dimensions, each.values))


def _packing(dimensions: Labels, values: np.ndarray) -> dict[str, Any]:
    """Return how values that take some room are compressed: byte planes together, all draws of a number in a block."""
    if values.nbytes < _COMPRESSED:
        return {}
    packing = {"compression": "gzip", "compression_opts": 1, "shuffle": True}
    if dimensions[:2] != SAMPLE:
        return packing
    block = [size if name in SAMPLE else 1 for name, size in zip(dimensions, values.shape, strict=True)]
    if len(block) > len(SAMPLE):
        block[-1] = min(max(1, _BLOCK // (block[0] * block[1])), values.shape[-1])
    return {**packing, "chunks": tuple(block)}


def _stored(each: Labelled) -> Labelled:
    """Return an array as it is stored.

    Labels become characters, (labels, length), which readers join; strings of variable length cannot be packed.
    """
    if each.values.dtype.kind != "U":
        return each
    letters = np.char.encode(each.values, "utf-8")
    width = max(letters.dtype.itemsize, 1)
    characters = np.ascontiguousarray(letters.astype(f"S{width}")).view("S1").reshape(*each.values.shape, width)
    return Labelled((*each.dimensions, f"string{width}"), characters, {"_Encoding": "utf-8", **each.attributes})


def write_result(
    result: Result,
    node: Node,
    *,
    change: "ModelChange | None" = None,
    added_variable: pl.DataFrame | None = None,
    selection: int = 0,
) -> Result:
    """Write a fit to its folder, and return it with what identifies it there.

    Everything of an earlier result is replaced; other files of the folder stay.

    Parameters
    ----------
    node : of the model in its history.
    change, added_variable : how it was made from another model; None for the first.
    selection : number of the selection in its history (see `Manifest`).
    """
    fit, folder = result.fit, result.folder
    assert folder is not None
    with folder_files.replacing_result(folder, selection) as scratch:
        (scratch / folder_files.SUMMARY).write_text(result.summary.json_text(), encoding="utf-8")
        (scratch / folder_files.FIT).write_text(fit_record(fit, folder, node.seed).json_text(), encoding="utf-8")
        (scratch / folder_files.HISTORY).write_text(node.file_text(), encoding="utf-8")
        result.residuals.table.write_parquet(scratch / folder_files.RESIDUALS)
        (scratch / folder_files.MODEL).write_text(model_text(fit.model.spec), encoding="utf-8")
        for file in fit.model.spec.files:
            shutil.copyfile(file, scratch / Path(file).name)
        if fit.posterior is not None:
            write_posterior(posterior_groups(fit), scratch / folder_files.POSTERIOR)
        if change is not None:
            (scratch / folder_files.CHANGE).write_text(change.json_text(), encoding="utf-8")
        if added_variable is not None:
            added_variable.write_parquet(scratch / folder_files.ADDED_VARIABLE)
    return replace(result, identity=folder_files.checked(folder).identity)


def write_model(spec: ModelSpec, file: Path) -> None:
    """Write a model to a model file, and the files that it names beside it.

    Raises
    ------
    InputError
        if another file of such a name is there; nothing is written then.
    """
    named = {file.with_name(Path(source).name): Path(source) for source in spec.files}
    if spec.noise_priors is not None:
        source = Path(spec.noise_priors.where)
        noise = file.with_name(f"{file.stem}-noise-priors{source.suffix}")
        named[noise] = source
        spec = replace(spec, noise_priors=replace(spec.noise_priors, where=noise.name))
    for target, source in named.items():
        refuse_existing(target, but=source.read_bytes().__eq__)
    for target, source in named.items():
        write_text(target, source.read_text(encoding="utf-8"))
    write_text(file, model_text(spec))


def _set_aside(spec: ModelSpec) -> dict[str, Any]:
    """Return the entries of the readings that a model leaves out; nothing if there are none."""
    entries = [each.model_dump(mode="json", exclude_defaults=True) for each in spec.set_aside]
    return {"set_aside": entries} if entries else {}


def model_text(spec: ModelSpec) -> str:
    """Return a model as the text of a model file."""
    document = tomlkit.document()
    document["format"] = 1
    document["name"] = spec.name
    if spec.files:
        document["files"] = [Path(file).name for file in spec.files]
    if spec.priors_from:
        document["priors_from"] = spec.priors_from
    if spec.delta_k_threshold is not None:
        document["delta_k_threshold_percent"] = 100 * spec.delta_k_threshold
    if spec.noise_priors is not None:
        document["noise_priors"] = spec.noise_priors.where
    document["effect"] = _effects(spec)
    document.update(_set_aside(spec))
    if spec.correlations:
        blocks = tomlkit.aot()
        for block in spec.correlations:
            entry = tomlkit.table()
            entry["parameters"] = list(block.parameters)
            entry["matrix"] = [list(row) for row in block.matrix]
            if block.optional:
                entry["optional"] = True
            blocks.append(entry)
        document["prior_correlation"] = blocks
    return tomlkit.dumps(document)


def _effects(spec: ModelSpec) -> AoT:
    effects = tomlkit.aot()
    for effect in spec.effects:
        entry = tomlkit.table()
        entry["name"] = effect.name
        if effect.channels is not None:
            entry["channels"] = list(effect.channels)
        if effect.per is not None:
            entry["per"] = effect.per
        if effect.optional:
            entry["optional"] = True
        if effect.prior:
            prior = tomlkit.inline_table()
            prior.update(effect.prior)
            entry["prior"] = prior
        for key, value in effect.options.items():
            entry[key] = value
        effects.append(entry)
    return effects

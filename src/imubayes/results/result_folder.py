"""The writer of the result folder, and of its file with the posterior draws, `posterior.nc`.

A result is written to a scratch folder and put in place as a whole, its manifest last (see
`imubayes.results.folder_files`).

The posterior file holds the groups of ArviZ's schema as netCDF 4, written by h5netcdf alone.  xarray, which reads the
file, would write the same, but with pandas and Dask it takes longer to import than the file takes to write.
"""

import shutil
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import h5netcdf
import numpy as np
import polars as pl
import tomlkit

from imubayes.foundations.files import refuse_existing, write_text
from imubayes.inference.posterior_groups import SAMPLE, Group, Groups, Labelled, Labels, posterior_groups
from imubayes.loop.model_history import Node
from imubayes.model.model_file import ModelSpec
from imubayes.results import folder_files
from imubayes.results.change_records import ModelChange
from imubayes.results.fit_file import fit_record
from imubayes.results.result import Result

# Arrays of fewer bytes are not compressed; a block of draws has about so many values, or all draws of a number.
_COMPRESSED, _BLOCK = 4096, 1600


def write_posterior(groups: Groups, file: Path) -> None:
    """Write groups; a reader that follows the CF conventions finds each coordinate."""
    # HDF5 crashes the process where the disk is full.
    made = BytesIO()
    with h5netcdf.File(made, "w") as root:
        root.attrs.update(groups.attributes)
        for name, group in groups.named.items():
            _write(root.create_group(name), group)
    file.write_bytes(made.getvalue())


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
    if each.values.dtype.kind == "U":
        return _create_text(place, name, each)
    return place.create_variable(name, each.dimensions, data=each.values, **_packing(each.dimensions, each.values))


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


def _create_text(place: h5netcdf.Group, name: str, each: Labelled) -> h5netcdf.Variable:
    """Write labels as characters, (labels, length), which readers join; strings of variable length cannot be packed."""
    letters = np.char.encode(each.values, "utf-8")
    width = max(letters.dtype.itemsize, 1)
    characters = np.ascontiguousarray(letters.astype(f"S{width}")).view("S1").reshape(*each.values.shape, width)
    length = f"string{width}"
    if length not in place.dimensions:
        place.dimensions[length] = width
    dimensions = (*each.dimensions, length)
    variable = place.create_variable(name, dimensions, data=characters, **_packing(dimensions, characters))
    variable.attrs["_Encoding"] = "utf-8"
    return variable


def write_result(
    result: Result,
    node: Node,
    *,
    change: ModelChange | None = None,
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
        where another file of such a name is there; nothing is written then.
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
    """Return the entries of the readings that a model leaves out; nothing where there are none."""
    entries = [each.model_dump(mode="json", exclude_defaults=True) for each in spec.set_aside]
    return {"set_aside": entries} if entries else {}


def model_text(spec: ModelSpec) -> str:
    """Return a model as the text of a model file."""
    document = tomlkit.document()
    document["format"] = 1
    document["name"] = spec.name
    if spec.files:
        document["files"] = [Path(file).name for file in spec.files]
    if spec.delta_k_threshold is not None:
        document["delta_k_threshold_percent"] = 100 * spec.delta_k_threshold
    if spec.noise_priors is not None:
        document["noise_priors"] = spec.noise_priors.where
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
    document["effect"] = effects
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

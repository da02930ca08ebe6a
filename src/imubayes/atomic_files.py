"""Files and folders that appear as a whole or not at all: written beside their place, then renamed."""

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from imubayes.errors import input_error


@contextmanager
def replacing(file: Path, durable: bool = False) -> Iterator[Path]:
    """Give a scratch file beside `file` that replaces it when the block ends; after an error nothing has changed.

    Parameters
    ----------
    durable : whether to force the content to the disk, so that a power failure leaves the old or the new file.
    """
    file.parent.mkdir(parents=True, exist_ok=True)
    scratch = file.with_name(f".{file.name}.{os.getpid()}.part")
    scratch.unlink(missing_ok=True)
    try:
        yield scratch
        if durable:
            _synchronise(scratch)
        os.replace(scratch, file)
        if durable:
            _synchronise(file.parent)
    finally:
        scratch.unlink(missing_ok=True)


def _synchronise(path: Path) -> None:
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(file: Path, text: str) -> None:
    """Write a text file; folders above it are made."""
    with replacing(file) as scratch:
        scratch.write_text(text, encoding="utf-8")


def write_json(file: Path, value: Any) -> None:
    """Write a JSON file; raises ValueError for a non-finite number."""
    write_text(file, json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n")


@contextmanager
def new_folder(folder: Path, durable: bool = False) -> Iterator[Path]:
    """Give a scratch folder beside `folder` that takes its place when the block ends; after an error nothing is left.

    `folder` must not exist, or be empty.

    Parameters
    ----------
    durable : whether to force the content to the disk, so that a power failure leaves the whole folder or none.
    """
    folder.parent.mkdir(parents=True, exist_ok=True)
    scratch = Path(tempfile.mkdtemp(prefix=f".{folder.name}-", dir=folder.parent))
    try:
        yield scratch
        mask = os.umask(0)
        os.umask(mask)
        scratch.chmod(0o777 & ~mask)
        if durable:
            for place in (*scratch.iterdir(), scratch):
                _synchronise(place)
        os.rename(scratch, folder)
        if durable:
            _synchronise(folder.parent)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


@contextmanager
def replacing_files(folder: Path, last: str) -> Iterator[Path]:
    """Give a scratch folder whose files replace those of `folder` when the block ends; its other files stay.

    Parameters
    ----------
    last : name of the file that is put in place last: where it is new, the others are.
    """
    folder.mkdir(parents=True, exist_ok=True)
    scratch = folder / f".writing-{os.getpid()}"
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    try:
        yield scratch
        for file in sorted(scratch.iterdir(), key=lambda file: file.name == last):
            os.replace(file, folder / file.name)
    finally:
        shutil.rmtree(scratch, ignore_errors=True)


def refuse_existing(file: Path, but: Callable[[bytes], bool] = lambda content: False) -> None:
    """Raise InputError where a file or folder exists, except a file whose content may be replaced."""
    if not file.exists() or (file.is_file() and but(file.read_bytes())):
        return
    raise input_error(
        f"'{file.name}' is there already",
        str(file),
        "a file that does not exist yet",
        "choose another name, or remove it first",
    )

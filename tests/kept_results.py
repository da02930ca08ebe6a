"""Result folders whose files a test has written or changed itself, with a manifest that says so."""

import hashlib
from pathlib import Path

from imubayes.results.folder_files import BY_OTHER_COMMANDS, CHECKPOINT, MANIFEST, KeptFile, Manifest


def listed(folder: Path) -> Path:
    """Return a folder after writing its manifest as if the fit, and the commands after it, had left the files so."""
    names = sorted(file.name for file in folder.iterdir() if file.is_file() and not file.name.startswith("."))
    kept = {name: _kept(folder / name) for name in names if name not in (MANIFEST, CHECKPOINT)}
    added = tuple(each for name, each in kept.items() if name in BY_OTHER_COMMANDS)
    fit = tuple(each for name, each in kept.items() if name not in BY_OTHER_COMMANDS)
    (folder / MANIFEST).write_text(Manifest(fit=fit, added=added).json_text())
    return folder


def _kept(file: Path) -> KeptFile:
    content = file.read_bytes()
    return KeptFile(name=file.name, size=len(content), sha256=hashlib.sha256(content).hexdigest())

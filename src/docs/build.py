"""Build the site: stage the sources, make the pages that come from the package, run Sphinx.

Pages are executed beside links to the data and models of the repository; what they write stays in the cache.  The build
makes no request to any other machine.
"""

import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

from gallery import gallery_pages
from reference_pages import ROOT, reference_pages

HERE = Path(__file__).parent
CACHE = ROOT / ".cache" / "docs"
SOURCE, WORK, OUT = CACHE / "source", CACHE / "work", ROOT / "results" / "docs"


def stage() -> None:
    """Put written and generated pages in one folder, and what executed pages read in another."""
    shutil.rmtree(CACHE, ignore_errors=True)
    shutil.copytree(HERE, SOURCE, ignore=shutil.ignore_patterns("*.py", "*.toml", "__pycache__", "_templates"))
    WORK.mkdir()
    for name in ("data", "models"):
        (WORK / name).symlink_to(ROOT / name)
        (SOURCE / "repository").mkdir(exist_ok=True)
        (SOURCE / "repository" / name).symlink_to(ROOT / name)
    (SOURCE / "repository" / ".readme").symlink_to(ROOT / ".readme")
    for file, text in {**reference_pages(), **gallery_pages(SOURCE)}.items():
        (SOURCE / file).parent.mkdir(parents=True, exist_ok=True)
        (SOURCE / file).write_text(text, encoding="utf-8")


def main() -> int:
    """Build; return the status of Sphinx."""
    clock = time.perf_counter()
    stage()
    print(f"pages staged in {time.perf_counter() - clock:.0f} s", flush=True)
    paths = os.pathsep.join([str(HERE), str(ROOT / "src"), os.environ.get("PYTHONPATH", "")])
    settings = {"PYTHONPATH": paths, "IMUBAYES_DOCS": str(WORK), "OPENBLAS_NUM_THREADS": "1"}
    options = ["-W", "--keep-going", "--fresh-env", "-q", "-j", "2", "-b", "html", "-c", str(HERE)]
    built = subprocess.run(
        [sys.executable, "-m", "sphinx", *options, str(SOURCE), str(OUT)], env={**os.environ, **settings}, check=False
    )
    if built.returncode == 0:
        print(f"{len(list(OUT.rglob('*.html')))} pages in {OUT}, {time.perf_counter() - clock:.0f} s")
    return built.returncode


if __name__ == "__main__":
    raise SystemExit(main())

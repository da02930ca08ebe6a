"""Write to copies of a result folder, each time in a process that ends, as if killed, after one operation more.

Arguments: a result, what is written (another result, or a file of another command; if it does not exist, the result
is read), and a folder for the copies; the copy `n` was left by a process that made n changes to the disk.
"""

import os
import shutil
import sys
from pathlib import Path

from imubayes.results.folder_files import BUDGETS, MANIFEST, add_to, checked, replacing_result

before, after, copies = map(Path, sys.argv[1:])
KILLED = 9


def killed_after(count: int) -> None:
    """End this process in place of the operation after so many of them."""
    left = [count]

    def mortal(real):
        def operation(*arguments, **options):
            if left[0] == 0:
                os._exit(KILLED)
            left[0] -= 1
            return real(*arguments, **options)

        return operation

    os.replace, os.rename, os.fsync, os.mkdir = map(mortal, (os.replace, os.rename, os.fsync, os.mkdir))
    os.unlink, os.rmdir = map(mortal, (os.unlink, os.rmdir))
    Path.unlink, Path.mkdir, shutil.rmtree = map(mortal, (Path.unlink, Path.mkdir, shutil.rmtree))


def write(folder: Path) -> None:
    if not after.exists():
        checked(folder)
        return
    if after.is_file():
        add_to(folder, BUDGETS, after.read_text())
        return
    with replacing_result(folder, 0) as scratch:
        for file in after.iterdir():
            if file.name != MANIFEST:
                shutil.copyfile(file, scratch / file.name)


for count in range(1000):
    folder = Path(shutil.copytree(before, copies / str(count)))
    child = os.fork()
    if child == 0:
        killed_after(count)
        write(folder)
        os._exit(0)
    if os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) != KILLED:
        print(count)
        break

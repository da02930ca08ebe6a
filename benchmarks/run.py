"""Run the benchmarks: all, or those named on the command line (those of `ORDER`).

Each prints its tables and writes them to benchmarks/results/.  Let nothing else run meanwhile.
"""

import argparse
import importlib

ORDER = ("startup", "fit", "batch", "batch_scale", "population", "reduction", "sampling", "allan", "growth", "explore")


def main() -> None:
    parser = argparse.ArgumentParser(description="Measure imubayes; tables go to benchmarks/results/.")
    parser.add_argument("names", nargs="*", metavar="NAME", help=f"which: {', '.join(ORDER)} (default: all)")
    parser.add_argument("--quick", action="store_true", help="short runs, to see that they work")
    given = parser.parse_args()
    unknown = [name for name in given.names if name not in ORDER]
    if unknown:
        parser.error(f"there is no benchmark '{unknown[0]}'; there are {', '.join(ORDER)}")
    for name in given.names or ORDER:
        report = importlib.import_module(name).measure(given.quick)
        report.write()
        print(f"→ benchmarks/results/{name}.md\n", flush=True)


if __name__ == "__main__":
    main()

"""The blind study: is the missing effect found in campaigns whose making shares no line of code with its finding?

    python tests/study/blind.py --quick 12          a handful, to see that it runs
    python tests/study/blind.py                     the whole study, resumed where it stopped
    python tests/study/blind.py --alone 4 2         every procedure by itself: so many hidden effects, so many without
    python tests/study/blind.py --look hidden 17    one campaign again, with its diagnosis in full

Campaigns are drawn by `data/generators/hidden.py`: plan, unit, noise, effect, channel, size and sign.  Each is fitted
with the model that lacks the effect, and diagnosed.  One line of JSON per campaign is kept in `.cache/blind/`, and
judged afterwards, so that rules of judgement may change without a refit.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
import tomllib
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
from judging import Document, Line, by_procedure, first_group, judged, names_it, report  # pyright: ignore[reportMissingImports]

ROOT = Path(__file__).parents[2]
LINES = ROOT / ".cache" / "blind" / "campaigns.jsonl"
REPORT = ROOT / "benchmarks" / "results" / "blind_study.md"
COUNTS = {
    "hidden": 300, "null-white": 100, "null-ar1": 100, "null-runs": 100, "outside": 60, "offsets": 24, "two": 40,
    "large": 60,
}  # fmt: skip
FIRST_SEEDS = dict.fromkeys(COUNTS, 1001) | {"outside": 5001, "two": 2001, "null-ar1": 3001, "large": 9101}
"""Campaigns of smaller seeds were looked at while thresholds, ranking and rules were set."""
PROCEDURES = (
    "rate_table", "dividing_head", "thermal_ramp", "polar_tumble", "geographic_tumble", "rotation_modulation",
    "reference_gyro", "servo_table", "free_tumble", "static_record", "multi_axis_table", "centrifuge",
)  # fmt: skip
ONE_RUN = ("servo_table", "free_tumble", "static_record")
"""Procedures of one run, which has no scatter between runs."""
ALONE_COUNTS = {"hidden": 40, "null-white": 20, "null-runs": 20}
FIRST_ALONE = 20001
"""Of campaigns with one procedure alone: how many of each kind for every procedure, and their first seed."""
ADDED = 10
"""Every so manieth campaign with one hidden effect is gone on with: the effect is added and the refit judged."""


# one campaign


def draw(place: Path, seed: int, kind: str, procedure: str) -> Any:
    """Draw one campaign into a folder, of one procedure alone where it is named."""
    import hidden  # pyright: ignore[reportMissingImports]
    import hidden_servo  # pyright: ignore[reportMissingImports]

    if procedure == "servo_table":
        return hidden_servo.random_campaign(place, seed, kind)
    return hidden.random_campaign(place, seed, kind, {"dividing_head": "head"}.get(procedure, procedure) or None)


def draw_and_judge(kind: str, seed: int, folder: Path | None = None, procedure: str = "") -> Line:
    """Draw, fit and diagnose one campaign, of one procedure alone where it is named."""
    with tempfile.TemporaryDirectory() as temporary:
        place = folder or Path(temporary) / "campaign"
        clock = [time.perf_counter()]
        drawn = draw(place, seed, kind, procedure)
        clock.append(time.perf_counter())
        fitted = mode_of(place, drawn.model)
        clock.append(time.perf_counter())
        document = diagnosed(fitted)
        clock.append(time.perf_counter())
        planted = [
            {"effect": one.effect, "channels": list(one.channels), "s": one.s, "s_alone": one.s_alone,
             "seen": one.seen, "within": one.within, "shown": one.shown, "parameters": one.parameters}
            for one in drawn.planted
        ]  # fmt: skip
        line: Line = {
            "kind": kind,
            "seed": seed,
            "procedure": procedure,
            "template": drawn.template,
            "readings": drawn.readings,
            "planted": planted,
            "passed_over": list(drawn.passed_over),
            "converged": fitted.converged,
            "document": document,
        }
        if kind == "null-ar1":
            line["white"] = diagnosed_as_white(fitted)
        if kind == "offsets":
            line["asked"] = diagnosed(fitted, planted[0]["effect"])
        truth = tomllib.loads((place / "truth.toml").read_text(encoding="utf-8"))["parameters"]
        if kind == "two":
            line |= second_step(fitted, document, planted)
        if kind == "hidden" and seed % ADDED == 0:
            line["addition"] = first_step(place, drawn.model, document, planted, truth)
        clock.append(time.perf_counter())
    line["seconds"] = dict(zip(("draw", "fit", "diagnose", "more"), np.round(np.diff(clock), 3).tolist(), strict=True))
    return line


def mode_of(campaign: Path, model: Path) -> Any:
    """Return the fit alone, without what else is reported of one: that is compiled anew for many plans."""
    from imubayes.campaign import load_campaign
    from imubayes.model.bind import bind
    from imubayes.model.model_file import read_model

    declared = bind(read_model(model), load_campaign(campaign))
    return mode_from(declared, *(np.zeros(size) for size in declared.problem.size))


def mode_from(declared: Any, z: np.ndarray, h: np.ndarray) -> Any:
    """Return the fit of a declared model, started from a point."""
    import jax.numpy as jnp

    from imubayes.inference.fitted_model import Fit
    from imubayes.inference.posterior_mode import find_mode, message

    mode = find_mode(declared.problem, jnp.asarray(z), jnp.asarray(h))
    return Fit(declared, np.asarray(mode.z), np.asarray(mode.h), bool(mode.converged), message(mode))


def diagnosed(fitted: Any, effect: str = "") -> Document:
    """Return what the diagnosis says, of all or of one effect, without the tail of the ranking."""
    from imubayes.criticism.diagnose import judge
    from imubayes.display.diagnosis_report import diagnosis_json

    document = diagnosis_json(judge(fitted, effect=effect))
    document["ranking"] = document.get("ranking", [])[: None if effect else 12]
    return document


def diagnosed_as_white(fitted: Any) -> Document | None:
    """Planted fault: return the diagnosis without a look at the noise; None where that cannot be asked."""
    try:
        with mock.patch("imubayes.criticism.stepwise_search.screen_noise", return_value=[]):
            return diagnosed(fitted)
    except AttributeError:
        return None


def found_first(document: Document, planted: list[dict[str, Any]]) -> dict[str, Any] | None:
    """Return the candidate of the first group that was planted, None where there is none; no channels for tables."""
    group = first_group(document)
    named = [] if group is None else [one for one in planted if names_it(one, group)]
    if not named or group is None:
        return None
    candidate = next(one for one in group["candidates"] if one["effect"] == named[0]["effect"])
    return candidate | {"channels": candidate["channels"] if named[0]["channels"] else None}


def first_step(
    place: Path, model: Path, document: Document, planted: list[dict[str, Any]], truth: dict[str, float]
) -> Line | None:
    """Add what the diagnosis found, and return what that brought beside the truth; None where it found nothing.

    `noise` is the fitted scatter of single readings over the true one, the geometric mean of the channels.
    """
    import imubayes.api

    found = found_first(document, planted)
    if found is None:
        return None
    result = imubayes.api.fit(place, model, sample=False)
    addition = imubayes.api.add(result, [found["effect"]], channels=found["channels"])
    fitted = {line.name: line.mean for line in addition.result.summary.parameters if line.mean is not None}
    sigma = [name for name in fitted if name.startswith("white_noise.") and addition.taken]
    return {
        "effect": found["effect"],
        "taken": addition.taken,
        "predicted": addition.predicted.delta_chi2,
        "found": addition.observed.delta_chi2,
        "coefficients": [
            {"name": each.name, "value": each.value, "sd": each.sd, "truth": truth[each.name]}
            for each in addition.observed.coefficients
            if each.name in truth and addition.taken
        ],
        "held_out": addition.held_out.verdict if addition.held_out is not None else "",
        "noise": float(np.exp(np.mean([np.log(fitted[name] / truth[name]) for name in sigma]))) if sigma else None,
    }


def second_step(fitted: Any, document: Document, planted: list[dict[str, Any]]) -> Line:
    """Fit what the first step found along, and look again; `second` is None where the first step found neither."""
    found = found_first(document, planted)
    if found is None:
        return {"added": None, "second": None}
    return {"added": found["effect"], "second": diagnosed(extended_mode(fitted, found))}


def extended_mode(fitted: Any, found: dict[str, Any]) -> Any:
    """Return the fit with one effect more, as `imubayes add` begins it."""
    from imubayes.loop.warm_start import extend

    shape = {f"{found['effect']}.{field}": value for field, value in found["shape"].items()}
    hints = {one["name"]: one["value"] for one in found["coefficients"]}
    extension = extend(fitted, [found["effect"]], found["channels"], shape, hints)
    return mode_from(extension.model, extension.z, extension.h)


def start_worker() -> None:
    """Make a worker ready: one thread, double precision, everything compiled kept on disk.

    Which run to make next is left out: it plays no part in what is judged, and is compiled anew for every plan.
    """
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    sys.path.insert(0, str(ROOT / "data" / "generators"))
    import jax

    import imubayes.criticism.diagnose
    import imubayes.results.summarise

    imubayes.results.summarise.next_runs = lambda *_: ()
    imubayes.criticism.diagnose.discriminating_run = lambda *_: None
    jax.config.update("jax_enable_x64", True)
    jax.config.update("jax_compilation_cache_dir", str(ROOT / ".cache" / "jax-study"))
    jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
    jax.config.update("jax_persistent_cache_min_entry_size_bytes", -1)


def attempt(kind: str, seed: int, procedure: str = "") -> Line:
    """Draw and judge one campaign; what breaks is a line too."""
    try:
        return draw_and_judge(kind, seed, procedure=procedure)
    except Exception as error:
        text = f"{type(error).__name__}: {error}"[:500]
        return {"kind": kind, "seed": seed, "procedure": procedure, "error": text}


# the study


Task = tuple[str, int, str]
"""Kind, seed, and the procedure of a campaign that holds one alone."""


def done(path: Path) -> dict[Task, Line]:
    """Return the lines of campaigns that are done; a line cut short is done again."""
    lines = {}
    for text in path.read_text().splitlines() if path.exists() else []:
        try:
            line = json.loads(text)
        except json.JSONDecodeError:
            continue
        if "error" not in line:
            lines[line["kind"], line["seed"], line.get("procedure", "")] = line
    return lines


def study(
    counts: dict[str, int], path: Path = LINES, workers: int = 2, alone: dict[str, int] | None = None
) -> list[Line]:
    """Run what is not done yet, and return all lines, in order.

    `alone` are the counts for every procedure by itself.
    """
    wanted: list[Task] = [(kind, FIRST_SEEDS[kind] + k, "") for kind, count in counts.items() for k in range(count)]
    wanted += [
        (kind, FIRST_ALONE + k, procedure)
        for procedure in PROCEDURES
        for kind, count in (alone or {}).items()
        if not (kind == "null-runs" and procedure in ONE_RUN)
        for k in range(count)
    ]
    known = done(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    left = [task for task in wanted if task not in known]
    if left:
        # Each worker has one processor to itself.
        os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
        # After JAX has started a process must not fork.
        context = multiprocessing.get_context("spawn")
        with (
            ProcessPoolExecutor(workers, mp_context=context, initializer=start_worker) as pool,
            path.open("a") as file,
        ):
            for number, future in enumerate(as_completed([pool.submit(attempt, *task) for task in left]), 1):
                line = future.result()
                known[line["kind"], line["seed"], line.get("procedure", "")] = line
                file.write(json.dumps(line) + "\n")
                file.flush()
                if sys.stderr.isatty():
                    print(f"\r{number}/{len(left)}", end="", file=sys.stderr)
    return [known[task] for task in wanted]


def quick(count: int) -> dict[str, int]:
    """Return the counts of a small study of about `count` campaigns with every kind in it."""
    total = sum(COUNTS.values())
    return {kind: max(1, round(count * number / total)) for kind, number in COUNTS.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--quick", type=int, metavar="N", help="a study of about N campaigns, printed only")
    parser.add_argument("--look", nargs=2, metavar=("KIND", "SEED"), help="one campaign, with its diagnosis in full")
    parser.add_argument("--procedure", default="", choices=("", *PROCEDURES), help="with --look: the procedure alone")
    parser.add_argument(
        "--alone", nargs=2, type=int, metavar=("HIDDEN", "NULL"), help="every procedure by itself, only"
    )
    parser.add_argument("--keep", type=Path, help="with --look: the folder to keep the campaign in")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--lines", type=Path, default=LINES, help="the file with one line per campaign")
    chosen = parser.parse_args()
    if chosen.look:
        start_worker()
        line = draw_and_judge(chosen.look[0], int(chosen.look[1]), chosen.keep, chosen.procedure)
        print(json.dumps(line, indent=1))
        print(judged(line))
        return
    if chosen.alone:
        alone: dict[str, int] = dict(zip(("hidden", "null-white"), chosen.alone, strict=True))
        print("\n".join(by_procedure(study({}, chosen.lines, chosen.workers, alone))))
        return
    counts = quick(chosen.quick) if chosen.quick else COUNTS
    lines = study(counts, chosen.lines, chosen.workers, None if chosen.quick else ALONE_COUNTS)
    text = report(lines)
    if chosen.quick:
        print(text)
        return
    REPORT.parent.mkdir(parents=True, exist_ok=True)
    REPORT.write_text(text)
    print(f"{REPORT.relative_to(ROOT)}: {len(lines)} campaigns")


if __name__ == "__main__":
    main()

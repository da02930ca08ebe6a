"""The end of the loop: hidden effects are diagnosed and added until nothing is suggested, and estimates compared.

    python tests/study/followed_loops.py --first 350001 --count 4     every procedure, a line per campaign, resumed

Campaigns are those of the blind study.  If the data do not distinguish several effects, all of them are added, as
`imubayes diagnose` suggests; beside it the loop is followed with the leader of each group alone, which is the planted
fault: a refit confirms it, and what another member shifts is far off.
"""

import argparse
import json
import multiprocessing
import os
import sys
import tempfile
import time
import tomllib
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np

sys.path.insert(0, str(Path(__file__).parent))
import blind

ROOT = Path(__file__).parents[2]
LINES = ROOT / ".cache" / "followed_loops.jsonl"
MOST_STEPS = 6

Line = dict[str, Any]


def follow(seed: int, procedure: str) -> Line:
    """Return how the loops on one campaign ended."""
    with tempfile.TemporaryDirectory() as temporary:
        place = Path(temporary) / "campaign"
        drawn = blind.draw(place, seed, "hidden", procedure)
        truth = tomllib.loads((place / "truth.toml").read_text(encoding="utf-8"))["parameters"]
        start = blind.mode_of(place, drawn.model)
        line: Line = {"seed": seed, "procedure": procedure, "planted": drawn.planted[0].effect}
        line["suggested"] = loop(start, truth, alone=False)
        if line["suggested"]["equivalent"]:
            line["alone"] = loop(start, truth, alone=True)
    return line


def loop(fitted: Any, truth: dict[str, float], alone: bool) -> Line:
    """Return the verdicts, what was added, and the scores where the loop ends."""
    from imubayes.criticism.diagnose import judge

    verdicts: list[str] = []
    added: list[tuple[str, ...]] = []
    equivalent = False
    for _ in range(MOST_STEPS):
        found = judge(fitted)
        verdicts.append(found.verdict)
        choice = found.suggested if alone or found.all_that_fit is None else found.all_that_fit
        if choice is None:
            break
        equivalent |= any(len(group.effects) > 1 for group in found.groups)
        fitted = with_effects(fitted, choice.effects, choice.channels, found)
        added.append(choice.effects)
    scores = scores_of(fitted, truth)
    worst = max(scores, key=lambda name: abs(scores[name]))
    return {
        "verdicts": verdicts,
        "added": added,
        "equivalent": equivalent,
        "rms": float(np.sqrt(np.mean(np.square([*scores.values()])))),
        "worst": worst,
        "largest": abs(scores[worst]),
    }


def with_effects(fitted: Any, effects: Sequence[str], channels: Sequence[str] | None, found: Any) -> Any:
    """Return the mode with effects added, from where `imubayes add` begins it."""
    from imubayes.loop.model_changes import start_of_refit

    extension = start_of_refit(fitted, effects, channels, found)
    return blind.mode_from(extension.model, extension.z, extension.h)


def scores_of(fitted: Any, truth: dict[str, float]) -> dict[str, float]:
    """Return (mode − truth)/sd, both in z, of every parameter whose truth is known, by the Laplace approximation."""
    from imubayes.inference.nested_laplace import posterior_precision
    from imubayes.inference.posterior_mode import find_mode

    problem = fitted.model.problem
    sd = np.sqrt(
        np.diag(np.linalg.inv(np.asarray(posterior_precision(problem, find_mode(problem, fitted.z, fitted.h)))))
    )
    scores = {}
    for place, parameter in enumerate(fitted.model.layout.parameters):
        true = parameter.z_at(truth[parameter.name]) if parameter.name in truth else None
        if true is not None:
            scores[parameter.name] = float((fitted.z[place] - true) / sd[place])
    return scores


def attempt(seed: int, procedure: str, until: float) -> Line | None:
    """Follow the loops on one campaign, None if the time is up; what breaks is a line too."""
    if time.time() > until:
        return None
    try:
        return follow(seed, procedure)
    except Exception as error:
        return {"seed": seed, "procedure": procedure, "error": f"{type(error).__name__}: {error}"[:500]}


def table(lines: Sequence[Line]) -> list[str]:
    """Return the outcome in Markdown."""
    rows = [
        "| loop | campaigns | planted effect in the model | ends adequate | adequate without the planted effect |",
        "| --- | --- | --- | --- | --- |",
    ]
    done = [line for line in lines if "error" not in line]
    several = [line for line in done if "alone" in line]
    for name, kind, own in (
        ("all that fit", "suggested", done),
        ("all that fit, where there are equivalents", "suggested", several),
        ("the simplest explanation, in the same campaigns", "alone", several),
    ):
        adequate = [line[kind]["verdicts"][-1] == "adequate" for line in own]
        has = [any(line["planted"] in effects for effects in line[kind]["added"]) for line in own]
        wrong = sum(fine and not planted for fine, planted in zip(adequate, has, strict=True))
        rows.append(f"| {name} | {len(own)} | {sum(has)} | {sum(adequate)} | {wrong} |")
    return rows


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--first", type=int, default=350001, help="first seed")
    parser.add_argument("--count", type=int, default=4, help="seeds of every procedure")
    parser.add_argument("--procedures", nargs="+", default=blind.PROCEDURES, choices=blind.PROCEDURES)
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument(
        "--seconds", type=float, default=float("inf"), help="no campaign is begun after so many seconds"
    )
    parser.add_argument("--lines", type=Path, default=LINES, help="the file with one line per campaign")
    chosen = parser.parse_args()
    until = time.time() + chosen.seconds
    known = [json.loads(text) for text in chosen.lines.read_text().splitlines()] if chosen.lines.exists() else []
    done = {(line["seed"], line["procedure"]) for line in known if "error" not in line}
    wanted = [(chosen.first + k, procedure) for k in range(chosen.count) for procedure in chosen.procedures]
    chosen.lines.parent.mkdir(parents=True, exist_ok=True)
    # Each worker has one processor to itself; after JAX has started a process must not fork.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    context = multiprocessing.get_context("spawn")
    with (
        ProcessPoolExecutor(chosen.workers, mp_context=context, initializer=blind.start_worker) as pool,
        chosen.lines.open("a") as file,
    ):
        futures = [pool.submit(attempt, *task, until) for task in wanted if task not in done]
        for future in as_completed(futures):
            line = future.result()
            if line is not None:
                known.append(line)
                file.write(json.dumps(line) + "\n")
                file.flush()
    print("\n".join(table(known)))


if __name__ == "__main__":
    main()

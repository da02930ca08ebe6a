"""The study of the evidence: a tiny share of it (`make study`), and the rules by which it judges (everyday tests)."""

import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
import pytest

sys.path.insert(0, str(Path(__file__).parent))
import evidence_study as study
from binomial_share import interval
from evidence_cases import settings

WARM = "gyro_warm_up"
LAG = {"effect": "gyro_thermal_lag", "channels": ["gx"], "s": 50.0, "seen": 50.0, "size": 1.0}
FORM = {"name": "step of the bias", "covariates": [], "run": "02-rate"}


def slot(*candidates: tuple[str, float], channels: tuple[str, ...] = ("gx",)) -> dict[str, Any]:
    listed = [{"effect": effect, "channels": list(channels), "probability": p} for effect, p in candidates]
    return {"candidates": listed, "channels": list(channels), "gain": 9.0}


def line(part: str, label: str = "1", planted: tuple = (), slots: tuple = (), **kinds: float) -> study.Line:
    every = dict.fromkeys(("nothing", "noise", "effects", "input", "outside"), 0.0) | kinds
    cause = {"words": ("temperature",), "run": "02-rate", "equal": [WARM]} if part == "d" else {}
    return {"part": part, "label": label, "planted": list(planted), "slots": list(slots), "kinds": every,
            "cause": cause, "form": FORM if part == "d" else None, "status": "done"}  # fmt: skip


@pytest.mark.parametrize(
    ("said", "one"),
    [
        ("right", line("a", planted=(LAG,), slots=(slot(("gyro_thermal_lag", 0.97)),), effects=0.99)),
        ("right", line("a", planted=(LAG,), slots=(slot((WARM, 0.6), ("gyro_thermal_lag", 0.2)),), effects=1)),
        ("silent", line("a", planted=(LAG,), slots=(slot((WARM, 0.8), ("gyro_thermal_lag", 0.04)),), effects=1)),
        ("silent", line("a", planted=(LAG,), nothing=0.8, effects=0.2)),
        ("wrong", line("a", planted=(LAG,), slots=(slot((WARM, 0.95)),), effects=0.99)),
        ("wrong", line("a", planted=(LAG,), slots=(slot(("gyro_thermal_lag", 1.0), channels=("gy",)),), effects=1.0)),
        ("silent", line("b", planted=(LAG, LAG | {"effect": "gyro_dead_zone"}), effects=1.0,
                        slots=(slot(("gyro_thermal_lag", 1.0)),))),
        ("right", line("c", "null 1", nothing=0.9, noise=0.1)),
        ("alarm", line("c", "null 1", nothing=0.4, noise=0.6)),
        ("right", line("c", "AR(1)", nothing=0.1, noise=0.9)),
        ("form", line("c", "AR(1)", outside=0.9)),
        ("wrong", line("c", "AR(1)", effects=0.8, slots=(slot((WARM, 0.7)),))),
        ("right", line("d", outside=0.9)),
        ("other", line("d", outside=0.9) | {"form": FORM | {"run": "01-rate"}}),
        ("right", line("d", input=0.9) | {"form": FORM | {"run": "", "covariates": ["temperature_degC"]}}),
        ("silent", line("d", nothing=0.9)),
        ("open", line("d", effects=0.8, slots=(slot(("gyro_dead_zone", 1.0)),))),
        ("wrong", line("d", effects=1.0, slots=(slot(("gyro_dead_zone", 1.0)),))),
        ("equal", line("d", effects=1.0, slots=(slot((WARM, 1.0)),))),
        ("equal", line("d", effects=1.0, slots=(slot(("gyro_dead_zone", 1.0)),)) | {"joint": 0.995}),
    ],
)  # fmt: skip
def test_judgement(said: str, one: study.Line) -> None:
    assert study.verdict(one) == said


def test_interval() -> None:
    """As in the tables of Clopper and Pearson."""
    assert np.allclose(interval(8, 10), (0.4439, 0.9748), atol=1e-4)
    assert interval(0, 10)[0] == 0.0
    assert interval(10, 10)[1] == 1.0


def test_tables_hold_every_part() -> None:
    right = line("a", planted=(LAG,), slots=(slot(("gyro_thermal_lag", 0.97)),), effects=0.99)
    every = [right, line("b", "2", (LAG,), effects=1.0), line("c", "null 1", nothing=0.9), line("d", outside=0.9)]
    setting = {"procedure": "head", "scatter": True, "cut": False, "seconds": 1.0, "megabytes": 2.0, "hypotheses": 3}
    text = study.tables([*(each | setting for each in every), {"status": "not converged"}])
    for told in ("| 1.0 | 1 of 1", "| null | 1 of 1", "| 0.9 … 0.98 | 1 of 1", "'not converged': 1"):
        assert told in text.replace("whole, scatter", "null")


@pytest.mark.slow
def test_a_share_of_the_study(tmp_path: Path) -> None:
    """Effects that show are named, none is named that is not there, and a complete model is called so."""
    study.start_worker()
    some = [each for each in settings() if each.procedure == "head" and each.scatter and not each.cut]
    lines = study.study(tmp_path / "lines.jsonl", 20.0, "abcd", some[:1])
    assert {each["status"] for each in lines} == {"done"}
    assert study.study(tmp_path / "lines.jsonl", 0.0, "abcd", some[:1]) == lines
    seen = [each for each in lines if each["part"] in "ab" and min(one["s"] for one in each["planted"]) >= study.SEEN]
    said = Counter((each["part"], study.verdict(each)) for each in lines)
    assert sum(study.verdict(each) == "right" for each in seen) >= 0.7 * len(seen) > 0
    assert not [key for key in said if key[1] == "wrong"]
    assert said["c", "alarm"] <= 1
    # The planted fault: what every campaign is said to lack is something else.
    other = [each | {"planted": [LAG | {"effect": WARM}]} for each in seen]
    assert not [each for each in other if study.verdict(each) == "right"]

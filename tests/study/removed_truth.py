"""Every effect in every procedure: is it found, and what is said when the catalogue lacks it?

    python tests/study/removed_truth.py geographic-tumble polar-tumble     the named campaigns
    python tests/study/removed_truth.py                                    all, a line per plant, resumed

Each effect that the model of a shipped campaign lacks is planted in fresh readings of it at ten times its smallest
detectable size, in the coefficient of one owner that shows it best, by its whole response and not by the derivative.
The diagnosis must name it; with the effect taken out of the catalogue it must not name another one alone.
"""

import argparse
import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from unittest import mock

import numpy as np

ROOT = Path(__file__).parents[2]
LINES = ROOT / ".cache" / "removed_truth.jsonl"
MODELS = {
    "geographic-tumble": "geographic-tumble", "polar-tumble": "polar-tumble", "servo-table": "servo-table",
    "accel-channel": "accel-channel", "rotation-modulation": "rotation-modulation", "reference-gyro": "reference-gyro",
    "trihedral-imu": "trihedral-imu", "hidden-none": "hidden-effects", "hidden-thermal": "hidden-effects-thermal",
    "multi-axis-table": "multi-axis-table", "centrifuge": "centrifuge", "desk-imu": "desk-imu",
    "redundant-imu": "redundant-imu",
}  # fmt: skip
TIMES_DETECTABLE, LARGEST = 10.0, 30.0
"""Planted size over the smallest detectable one, and over the largest typical one: larger plants are passed over."""
SIZING_STEPS = 12

Line = dict[str, Any]


def plants(fitted: Any, seed: int) -> Iterator[tuple[str, str, np.ndarray, float]]:
    """Yield effect, owner, shift of the readings (E,) and size over the largest typical one."""
    from imubayes.criticism.detectability import AbsorbedResponses, deviations_needed
    from imubayes.criticism.evidence.effect_variants import effect_variants
    from imubayes.criticism.evidence.hypothesis_evidence import EvidenceOf
    from imubayes.criticism.evidence.linear_problem import linear_problem
    from imubayes.responses.candidate_effects import candidate_responses

    responses, change = candidate_responses(fitted), whole_response(fitted)
    problem = linear_problem(fitted, responses)
    absorbed = AbsorbedResponses(EvidenceOf(problem), fitted)
    random, done = np.random.default_rng(seed), set()
    for variant in random.permuted(np.array(effect_variants(problem), dtype=object)).tolist():
        if variant.effect in done:
            continue
        done.add(variant.effect)
        owner = str(random.choice(variant.owners))
        places = [k for k in variant.places if problem.coefficients[k].owner == owner]
        lengths = np.sqrt(absorbed.left[places])
        k = places[int(np.argmax(lengths))]
        target = TIMES_DETECTABLE * deviations_needed(variant)
        response = problem.candidates[variant.response]
        names = [each.parameter.name for each in response.coefficients]
        one, sign = np.zeros(len(names)), problem.coefficients[k].sign or random.choice([-1, 1])
        one[names.index(problem.coefficients[k].parameter.name)] = sign * problem.sizes[k]
        if lengths.max() <= 0 or target / lengths.max() > LARGEST:
            continue  # absorbed in full, or larger than anybody has met
        shift, size = sized(partial(change, response), problem.root, one, target / float(lengths.max()), response)
        if size < LARGEST and shift is not None:
            yield variant.effect, owner, shift, size


def sized(
    change: Callable[[np.ndarray], np.ndarray], root: np.ndarray, one: np.ndarray, scale: float, response: Any
) -> tuple[np.ndarray | None, float]:
    """Return the whole shift, (E,), as long in units of noise as the linear one, and its size; None if none is.

    A dead zone of almost no width has a derivative, and hardly any response.
    """
    target = scale * float(np.linalg.norm(root * (response.columns @ one)))
    for _ in range(SIZING_STEPS):
        shift = change(scale * one)
        seen = float(np.linalg.norm(root * shift))
        if abs(seen / target - 1) < 0.2:
            return shift, scale
        scale *= float(np.clip(target / max(seen, 1e-300), 0.1, 10.0))
    return None, scale


def whole_response(fitted: Any) -> Callable[[Any, np.ndarray], np.ndarray]:
    """Return what gives the change of the predicted entries, (E,), by a candidate with some values of its coefficients.

    In a table that the gyro drives, what a derivative at the null says of an effect of this size is far off.
    """
    import equinox as eqx
    import jax.numpy as jnp

    from imubayes.model.problem import predict_from
    from imubayes.responses import candidate_effects

    extended = candidate_effects._extend(fitted, candidate_effects._candidates(fitted)[0], candidate_effects._AT_NULLS)
    own = np.asarray(fitted.model.problem.priors.values(jnp.asarray(fitted.z)))
    places = {parameter.name: (place, parameter) for place, parameter in enumerate(extended.parameters)}
    predict = eqx.filter_jit(predict_from)

    def change(response: Any, values: np.ndarray) -> np.ndarray:
        at = candidate_effects._at_nulls(extended, own, 0)
        for name, value in response.scan.shape.items():
            for place, parameter in places.values():
                if parameter.effect == response.scan.effect and parameter.field == name:
                    at[place] = value * parameter.factor
        without = at.copy()
        for coefficient, value in zip(response.coefficients, values.tolist(), strict=True):
            place, parameter = places[coefficient.parameter.name]
            at[place] += value * parameter.factor
        first, second = (predict(extended.problem, jnp.concatenate([jnp.asarray(v), extended.problem.nulls]))
                         for v in (without, at))  # fmt: skip
        return np.asarray(second) - np.asarray(first)

    return change


def judged(fitted: Any, without: str = "") -> Line:
    """Return what the diagnosis says, with an effect taken out of the catalogue."""
    from imubayes.criticism import diagnose
    from imubayes.display.loop.diagnosis_sentences import evidence_text

    whole = diagnose.candidate_responses

    def lacking(at: Any) -> Any:
        found = whole(at)
        return replace(found, candidates=tuple(r for r in found.candidates if r.scan.effect != without))

    with (
        mock.patch.object(diagnose, "candidate_responses", lacking),
        mock.patch.object(diagnose, "discriminating_run", return_value=None),
    ):
        found = diagnose.judge(fitted)
    return {
        "verdict": found.verdict,
        "groups": [list(group.effects) for group in found.groups],
        "probabilities": [group.probability for group in found.groups],
        "said": evidence_text(found.explanations) if found.explanations is not None else "",
    }


def kept(path: Path | None) -> list[Line]:
    """Return the lines that an earlier run wrote."""
    return [json.loads(each) for each in path.read_text().splitlines()] if path is not None and path.exists() else []


def study(campaign: str, seed: int, path: Path | None) -> Iterator[Line]:
    """Yield a line for every effect planted in a campaign."""
    from null_data import fitted_to, redrawn  # pyright: ignore[reportMissingImports]

    fitted = fitted_to(campaign, MODELS[campaign])
    known = {line["effect"]: line for line in kept(path) if (line["campaign"], line["seed"]) == (campaign, seed)}
    for number, (effect, owner, shift, size) in enumerate(plants(fitted, seed)):
        if effect in known:
            yield known[effect]
            continue
        line: Line = {"campaign": campaign, "seed": seed, "effect": effect, "owner": owner, "size": size}
        fresh = redrawn(fitted, 1000 * seed + number, change=shift)
        line |= {"converged": fresh.converged, "whole": judged(fresh), "without": judged(fresh, effect)}
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            with path.open("a") as file:
                file.write(json.dumps(line) + "\n")
        yield line


def right(line: Line) -> bool:
    """Return whether the effect planted is in a group, as a whole or the strongest."""
    return any(line["effect"] in group for group in line["whole"]["groups"])


def wrong_name(line: Line) -> bool:
    """Return whether, without the effect planted, another one is named alone."""
    return line["without"]["verdict"] == "missing_effect"


def table(lines: list[Line]) -> str:
    """Return how many plants were judged right, campaign by campaign."""
    rows = [
        "| campaign | plants | in a group | adequate | without it: another named alone | adequate |",
        "| --- |" + " --- |" * 5,
    ]
    for campaign in dict.fromkeys(line["campaign"] for line in lines):
        own = [line for line in lines if line["campaign"] == campaign and "whole" in line]
        silent = [sum(line[key]["verdict"] == "adequate" for line in own) for key in ("whole", "without")]
        counts = len(own), sum(map(right, own)), silent[0], sum(map(wrong_name, own)), silent[1]
        rows.append(f"| {campaign} | " + " | ".join(map(str, counts)) + " |")
    return "\n".join(rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("campaigns", nargs="*", default=list(MODELS))
    parser.add_argument("--first-seed", type=int, default=1)
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--lines", type=Path, default=LINES)
    chosen = parser.parse_args()
    import jax

    jax.config.update("jax_enable_x64", True)
    sys.path.insert(0, str(ROOT / "tests" / "criticism"))
    lines = []
    for campaign in chosen.campaigns:
        for seed in range(chosen.first_seed, chosen.first_seed + chosen.seeds):
            for line in study(campaign, seed, chosen.lines):
                lines.append(line)
                if "whole" in line and (not right(line) or wrong_name(line)):
                    print(
                        line["campaign"],
                        line["effect"],
                        line["owner"],
                        f"{line['size']:.3g}",
                        line["whole"],
                        line["without"],
                        flush=True,
                    )
    print(table(lines))


if __name__ == "__main__":
    main()

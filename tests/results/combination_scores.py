"""Determined combinations of campaigns with known truth: scores of their estimates, and how their members compare."""

import tomllib
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from imubayes.campaign import load_campaign
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.results.result import Result, result_of
from imubayes.results.summary import CombinationSummary

ROOT = Path(__file__).parents[2]


@dataclass(frozen=True)
class Scored:
    """A combination with (mean − truth)/sd, and its sd over what its leading member contributes.

    Of k cos θ both members lead: the sd is over the smaller of their contributions.
    """

    combination: CombinationSummary
    score: float
    inside: bool
    share: float


def fitted(folder: Path, model: str, runs: tuple[str, ...] = ()) -> Result:
    """Return the fit of a campaign, or of some of its runs, with draws of the nested Laplace approximation."""
    spec = read_model(ROOT / "models" / f"{model}.toml")
    spec = replace(spec, effects=tuple(replace(each, optional=True) for each in spec.effects))
    campaign = load_campaign(folder)
    return result_of(joint_fit(bind(spec, campaign.only(*runs) if runs else campaign), None))


def scored(result: Result, folder: Path) -> list[Scored]:
    """Return the combinations of a fit beside the truth of the campaign."""
    document = tomllib.loads((folder / "truth.toml").read_text())
    truth = document["parameters"] | document["derived"] | document["nuisance"]
    sd = {each.name: each.sd for each in (*result.summary.parameters, *result.summary.derived)}
    mean = {each.name: each.mean for each in result.summary.derived}
    found = []
    for each in result.summary.combinations:
        if each.weights is None:
            scale, angle = each.quantities
            true = truth[scale] * np.cos(np.radians(truth[angle]))
            tilt = np.radians(mean[angle])
            leading = min(sd[scale] * np.cos(tilt), mean[scale] * np.sin(tilt) * np.radians(sd[angle]))
        else:
            true = each.constant + sum(w * truth[name] for w, name in zip(each.weights, each.quantities, strict=True))
            leading = max(abs(w) * sd[name] for w, name in zip(each.weights, each.quantities, strict=True))
        inside = each.q025 <= true <= each.q975
        found.append(Scored(each, (each.mean - true) / each.sd, inside, each.sd / leading))
    return found

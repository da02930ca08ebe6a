"""Going on from a result: add what is missing, look back at the models tried, plant effects to see them found.

A step is taken only when its refit converged and is no worse, and nothing is ever overwritten: each model has its own
result folder, and `history.json` in each says where it came from.
"""

import shutil
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from imubayes.atomic_files import refuse_existing
from imubayes.campaign import load_campaign
from imubayes.criticism.cross_validation import found_delta_chi2, held_out, objection
from imubayes.criticism.injection_recovery import Size, Trials, plant_effects
from imubayes.criticism.model_history import Node, Tree, node_id
from imubayes.criticism.warm_start import Extension, extend
from imubayes.display import addition_report as shown
from imubayes.display.diagnosis_report import read_diagnosis, screened_candidate
from imubayes.display.html import sheet_html
from imubayes.errors import InputError, Issue
from imubayes.inference.checkpoint import steps_in
from imubayes.inference.ensemble_sampling import Settings
from imubayes.inference.fit import Fit
from imubayes.inference.joint_fit import joint_fit, model_hash
from imubayes.model.bind import bind
from imubayes.model.model_file import read_model
from imubayes.model.model_spec import ModelSpec
from imubayes.procedures import PROCEDURES
from imubayes.results.fit_file import campaign_hash
from imubayes.results.folder_state import CHECKPOINT, FIT, claim
from imubayes.results.history_file import first_node, join, read_node, read_tree, write_node
from imubayes.results.result import Result, read_result, result_of
from imubayes.run import Campaign

Progress = Callable[[str], None]


@dataclass(frozen=True)
class Addition:
    """An addition with the facts before and after.

    Attributes
    ----------
    result : of the refit.
    json : as `imubayes add --json` prints it.
    """

    result: Result
    json: dict[str, Any]

    @property
    def taken(self) -> bool:
        """Whether the refit converged and is no worse than the model before."""
        return bool(self.json["taken"])

    def __repr__(self) -> str:
        return "\n".join(shown.addition_text(self.json))

    def _repr_html_(self) -> str:
        text = "".join(f"<p>{line}</p>" for line in shown.addition_text(self.json))
        return text + sheet_html(shown.coefficient_sheet(self.json)) + sheet_html(shown.error_sheet(self.json))


def add(
    result: Result | str | Path,
    effects: Sequence[str],
    out: str | Path | None = None,
    channels: Sequence[str] | None = None,
    sample: bool = False,
    seed: int = 0,
    progress: Progress | None = None,
) -> Addition:
    """Add effects to the model of a result, fit again from where it stood, and show what that brought.

    Parameters
    ----------
    result : a result, or its folder.
    effects : names of effects or noise members.
    out : result folder to write; None for none.  It becomes the selected model where the refit is taken.
    channels : for the new effects; those the diagnosis named, or all that they can act on, where None.
    sample : whether to sample the posterior of a refit that is taken.
    seed : of the sampler.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for an effect that does not fit, a result that cannot be gone on from, an `out` that is taken.
    """
    tell = progress or (lambda text: None)
    known = result if isinstance(result, Result) else read_result(result)
    parent, before, summary = known.folder, known.fit, known.summary
    folder = _free(Path(out), parent) if out is not None else None
    diagnosis = read_diagnosis(parent) if parent is not None else {}
    screened = {name: screened_candidate(diagnosis, name) for name in effects}
    extension = _extension(before, effects, channels, screened)
    tell("fitting")
    start = (extension.z, extension.h)
    fit = joint_fit(extension.model, None, start=start, progress=tell)
    drop = found_delta_chi2(before, extension, fit) if fit.converged else float("nan")
    against = objection(fit, drop)
    unseen = held_out(before, fit, tell) if not against else None
    if sample and not against:
        fit = _sampled(fit, folder, seed, tell)
        against = objection(fit, drop)
    made = result_of(fit, folder, seed)
    facts = _facts(summary, made.summary, extension, effects, screened, drop, unseen, against)
    facts["from"] = str(parent) if parent is not None else None
    facts["to"] = str(folder) if folder is not None else None
    facts["next"] = (
        f"imubayes diagnose {folder or 'RESULT'}" if not against else f"imubayes diagnose {parent or 'RESULT'}"
    )
    if folder is not None:
        shown.write_addition(folder, facts, shown.added_variable(extension))
        if parent is not None:
            _remember(parent, folder, before, summary, fit, facts, diagnosis, seed)
    return Addition(made, facts)


def _free(out: Path, parent: Path | None) -> Path:
    """Return the folder to write; refuse one that already holds a result: no step overwrites another."""
    if (out / FIT).exists() or (parent is not None and out.resolve() == parent.resolve()):
        raise InputError(
            Issue(
                "the folder holds a result already",
                str(out),
                "a folder that does not exist yet: each model tried keeps its own",
                "choose another --out, or remove the folder",
            )
        )
    claim(out, resume=True)
    return out


def _extension(
    before: Fit, effects: Sequence[str], channels: Sequence[str] | None, screened: Mapping[str, Mapping[str, Any]]
) -> Extension:
    if not all(map(bool, (abs(before.z) < float("inf")).tolist())):
        raise InputError(
            Issue(
                f"there is no fit to go on from: {before.message}",
                before.model.spec.where,
                "a fit that converged",
                "mend what kept the fit from converging, fit again, then add",
            )
        )
    shape, hints = {}, {}
    for name, line in screened.items():
        shape |= {key if "." in key else f"{name}.{key}": value for key, value in (line.get("shape") or {}).items()}
        hints |= {one["name"]: one["value"] for one in line.get("coefficients") or []}
    return extend(before, effects, channels, shape, hints)


def _sampled(fit: Fit, folder: Path | None, seed: int, tell: Progress) -> Fit:
    """Return the fit with its posterior sampled, from where it ended."""
    if folder is not None:
        folder.mkdir(parents=True, exist_ok=True)
    checkpoint = folder / CHECKPOINT if folder is not None else None
    start = (fit.z, fit.h)
    # Where an earlier call was interrupted its sampling goes on.
    resume = checkpoint is not None and bool(steps_in(checkpoint))
    return joint_fit(fit.model, Settings(seed=seed), checkpoint, resume, tell, start)


def _facts(before, after, extension, effects, screened, drop, unseen, against) -> dict[str, Any]:
    layout, hyper = extension.model.layout, extension.model.hyper_layout
    count = len(effects)
    fresh = [name for name, new in zip(layout.names, extension.new.tolist(), strict=True) if new]
    known = {parameter.name for parameter in before.parameters}
    fresh += [name for name in hyper.names if name not in known]
    runs, channels = shown.errors_before_after(before, after) if not against else ([], [])
    added = [
        {"effect": one.name, "channels": list(one.channels) if one.channels is not None else None}
        for one in extension.model.spec.effects[-count:]
    ]
    return {
        "format": 1,
        "added": added,
        "widened": dict(extension.widened),
        "taken": not against,
        "message": against,
        "predicted": shown.expected_line(extension, next(iter(screened.values())) if count == 1 else None),
        "found": shown.found_line(after, fresh, drop),
        "held_out": shown.held_out_line(unseen),
        "runs": runs,
        "channels": channels,
        "chi2": {"before": before.chi2, "after": after.chi2 if not against else None},
        "dof": {"before": before.dof, "after": after.dof if not against else None},
        "log_evidence": {"before": before.log_evidence, "after": after.log_evidence},
    }


def _remember(parent: Path, folder: Path, before, summary, fit, facts, diagnosis, seed) -> None:
    """Write the node of a new model below that of the old, which is begun where it has none."""
    try:
        above = read_node(parent)
    except InputError:
        above = first_node(before.model, summary, seed)
        write_node(parent, above)
    data, made, taken = campaign_hash(fit.model), model_hash(fit.model), bool(facts["taken"])
    node = Node(
        id=node_id(data, made, seed, above.id),
        model=fit.model.spec.name,
        parent=str(parent),
        children=(),
        added=tuple(facts["added"]),
        verdict=str(diagnosis.get("verdict", "")),
        chi2=facts["chi2"]["after"],
        dof=facts["dof"]["after"],
        rms={one["channel"]: (one["after"], one["unit"]) for one in facts["channels"]},
        delta_chi2={"expected": facts["predicted"]["delta_chi2"], "found": facts["found"]["delta_chi2"]},
        held_out={key: value for key, value in facts["held_out"].items() if key not in ("each", "rates")},
        data_hash=data,
        model_hash=made,
        seed=seed,
        taken=taken,
        message=str(facts["message"]),
        selected=taken,
        floor=above.floor,
    )
    join(parent, folder, node)


def history(*folders: str | Path) -> Tree:
    """Return the tree of models tried that result folders stand in."""
    return read_tree(folders)


def plant(
    campaign: Campaign | str | Path | None = None,
    model: ModelSpec | str | Path | None = None,
    *,
    result: Result | str | Path | None = None,
    effects: Sequence[str] | None = None,
    size: Size | None = None,
    draws: int = 20,
    seed: int = 0,
    progress: Progress | None = None,
) -> Trials:
    """Plant each effect that the model lacks into data simulated from the fit, and report which are found.

    Parameters
    ----------
    campaign, model : what is fitted first; not needed with a result.
    result : a fit to take instead.
    effects : which to plant; all of the catalogue that the model lacks where None.
    size : how large they are planted; by default so that chi² would fall by 50.
    draws : simulations without any effect, for the rate of false alarms.
    seed : of the simulations.
    progress : called with a short text as the work goes on.

    Raises
    ------
    InputError
        for anything that cannot be used, and for free tumbles, which cannot be simulated.
    """
    tell = progress or (lambda text: None)
    if result is not None:
        fitted = (result if isinstance(result, Result) else read_result(result)).fit
    elif campaign is None or model is None:
        raise InputError(
            Issue("nothing to plant into", "plant", "a campaign with a model, or a result", "give one of the two")
        )
    else:
        tell("fitting")
        loaded = campaign if isinstance(campaign, Campaign) else load_campaign(campaign, tuple(PROCEDURES))
        spec = model if isinstance(model, ModelSpec) else read_model(model)
        fitted = joint_fit(bind(spec, loaded), None, progress=tell)
    return plant_effects(fitted, effects, size or Size(), draws, seed, tell)


def export(folder: str | Path, file: str | Path) -> str:
    """Write the selected model of the tree that a result stands in to a model file; return its place.

    The user's own effect files go beside it.
    """
    tree = read_tree([folder])
    place = str(Path(folder).resolve())
    chosen = next(one for one in (*tree.selected, place) if one in tree.together_with(place))
    file = Path(file)
    file.parent.mkdir(parents=True, exist_ok=True)
    own = {Path(source): file.parent / Path(source).name for source in read_model(Path(chosen) / "model.toml").files}
    for source, target in own.items():
        refuse_existing(target, but=source.read_bytes().__eq__)
    for source, target in own.items():
        shutil.copyfile(source, target)
    shutil.copyfile(Path(chosen) / "model.toml", file)
    return chosen


__all__ = ["Addition", "add", "export", "history", "plant"]

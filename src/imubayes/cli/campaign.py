"""Commands on campaigns before a fit: `imubayes check`, `effects`, `schema` and `simulate`.

`check` says what is there, and what is wrong.  `effects` shows the catalogue.  `schema` prints the JSON Schema of the
files, for editors and readers of results.  `simulate` makes a synthetic campaign from a plan, with a truth file.
"""

import json
import sys
from importlib.metadata import EntryPoint
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from imubayes.cli.session import (
    Flag,
    Json,
    Trust,
    progress,
    show,
    start_jax,
    trusting,
)
from imubayes.foundations.errors import InputError, closest_first, input_error
from imubayes.foundations.extensions import extensions

if TYPE_CHECKING:
    from imubayes.campaign import Inspection
    from imubayes.display.check_report import CheckedModel


def check(
    campaign: Path, *, model: Path | None = None, fix: Path | None = None, as_json: Json = False, verbose: Flag = False
) -> None:
    """Read a campaign and list its contents and faults.

    The outputs are compared with the stated set-up: zero, sense, azimuth and elevation of tables, mountings, units,
    channels, files, latitude, thermometers.  At the zero of a table, table x is horizontal, 90 deg clockwise from
    azimuth_deg, and y = z x x. Angles are right-handed about z (picture in data/README.md).

    Example: imubayes check data/trihedral-imu --model models/trihedral-imu.toml

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    model
        Model file to check against the campaign, or the name of a shipped model. check then also fits the model, and
        lists runs whose record disagrees with it.
    fix
        Folder to write: a copy with the corrections that need no further fact (spelling of keys, words and columns,
        order of rows in time), which is checked in place of the campaign.
    as_json
        Print one JSON object on standard output.
    verbose
        List every run and every note. Without it, those of one kind are combined into one line.
    """
    from imubayes.display.check_report import check_record, check_report

    if fix is not None:
        from imubayes.campaign.mends import mend_campaign

        for mend in mend_campaign(campaign, fix) or ("nothing can be corrected without a further fact",):
            print(f"corrected: {mend}" if "→" in mend or "order" in mend else mend, file=sys.stderr)
        campaign = fix
    if model is None:
        from imubayes.campaign import inspect_campaign

        with progress("reading the campaign"):
            inspection, size = inspect_campaign(campaign), None
    else:
        inspection, size = _with_model(campaign, model)
    following = f"check {campaign} --model MODEL"
    if model is not None:
        following = f"fit {campaign} --model {model} --out results/{campaign.resolve().name}"
    show(
        lambda: check_record(inspection, size),
        lambda: check_report(inspection, size, f"imubayes {following}", verbose),
        as_json,
    )


def _with_model(campaign: Path, model: Path) -> "tuple[Inspection, CheckedModel | None]":
    """Return the inspection of a campaign and the size of the model bound to it; None if it cannot be used."""
    from imubayes.campaign import inspect_campaign
    from imubayes.display.check_report import CheckedModel

    with progress("reading the campaign") as tell:
        inspection = inspect_campaign(campaign)
        recorded = inspection.campaign
        if recorded is None and any(finding.record is not None for finding in inspection.findings):
            recorded = inspect_campaign(campaign, judge_setup=False).campaign
        if recorded is None:
            return inspection, None
        tell("binding the model")
        start_jax()
        from imubayes.adequacy.weighed_findings import weighed
        from imubayes.inference.run_fit import mode_fit
        from imubayes.model.bind import bind
        from imubayes.model.model_file import read_model

        try:
            declared = bind(read_model(model), recorded)
        except InputError:
            if inspection.campaign is None:
                return inspection, None  # what is wrong in the campaign comes first
            raise
        inspection = weighed(inspection, mode_fit(declared, tell))
        if inspection.campaign is None:
            return inspection, None
        untold: tuple[str, ...] = ()
        if len(declared.layout) > len(declared.entries):
            from imubayes.inference.linear_information import untold_effects

            tell("determining the effects that the runs show")
            untold = untold_effects(declared)
    return inspection, CheckedModel(
        name=declared.spec.name,
        parameters=len(declared.layout),
        noise_parameters=len(declared.hyper_layout),
        measured_values=len(declared.entries),
        untold=untold,
        left_out=declared.left_out,
    )


def effects(name: str | None = None, *, campaign: Annotated[Path | None, Parameter(name="--for")] = None) -> None:
    """List the catalogue of effects, explain one, or list those that a campaign could show.

    Example: imubayes effects gyro_g_sensitivity

    Parameters
    ----------
    name
        The effect to explain.
    campaign
        Folder with campaign.toml: list the effects that its runs could show, and the inputs missing for the others.
    """
    with progress():
        start_jax()
        from imubayes.display.effect_catalogue import print_catalogue, print_effect, print_observable

    if campaign is not None:
        from imubayes.campaign import load_campaign

        print_observable(load_campaign(campaign))
    if name is not None:
        print_effect(name)
    elif campaign is None:
        print_catalogue()


_SCHEMAS = "imubayes.schemas"
_OF_KERNEL = {
    "campaign": "imubayes.campaign.file_schemas:CampaignFile",
    "model": "imubayes.campaign.file_schemas:ModelFile",
    "plan": "imubayes.simulation.test_plan:PlanFile",
    "diagnosis": "imubayes.criticism.diagnosis_record:Diagnosis",
    "change": "imubayes.results.change_records:ModelChange",
    "history": "imubayes.loop.model_history:Node",
    "fit": "imubayes.results.fit_file:FitRecord",
    "manifest": "imubayes.results.folder_files:Manifest",
    "summary": "imubayes.results.summary:Summary",
}
"""Kind of file → its pydantic record; packages beside the kernel add theirs."""


def kinds_of_files() -> dict[str, EntryPoint]:
    """Return the pydantic record of each kind of file, loaded when it is needed."""
    own = {kind: EntryPoint(kind, record, _SCHEMAS) for kind, record in _OF_KERNEL.items()}
    return {**own, **extensions("schemas")}


def schema(kind: str) -> None:
    """Print the JSON Schema of a file, for completion and validation in an editor.

    Example: imubayes schema campaign > campaign.schema.json

    Parameters
    ----------
    kind
        campaign (campaign.toml), model, plan, specification, certificate; report; constants (of `imubayes export`);
        summary, fit, diagnosis, change, history or manifest (JSON files of a result).
    """
    kinds = kinds_of_files()
    if kind not in kinds:
        allowed = closest_first(kind, kinds)
        raise input_error(f"there is no schema '{kind}'", "argument KIND", allowed, "use one of the allowed kinds")
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    print(json.dumps(dialect | kinds[kind].load().model_json_schema(), indent=1))


def simulate(plan: Path, *, out: Path, seed: int | None = None, trust: Trust = False) -> None:
    """Simulate a test plan: a campaign folder with a truth file.

    Example: imubayes simulate data/plans/trihedral-example.toml --out campaigns/simulated

    Parameters
    ----------
    plan
        Plan file: site, channels, tables, mountings, model and runs.
    out
        Campaign folder to write.
    seed
        Random seed; by default that of the plan.
    trust
        Trust the effect files that come with the input, and remember them. They are code, which runs only if trusted.
    """
    with progress() as tell:
        start_jax()
        from imubayes.simulation.simulate import simulate_plan
        from imubayes.simulation.test_plan import read_plan

        trusting(read_plan(plan).model if trust else None, trust)
        tell("simulating")
        folder = simulate_plan(plan, out, seed)
    print(f"campaign in {folder}, truth in {folder / 'truth.toml'}; next: imubayes check {folder}")

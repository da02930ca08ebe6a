"""Commands on campaigns before a fit: `imubayes check`, `effects`, `noise`, `schema` and `simulate`.

`check` says what is there, and what is wrong.  `effects` shows the catalogue.  `noise` gives Allan deviation and noise
terms of static records.  `schema` prints the JSON Schema of the files, for editors and readers of results.  `simulate`
makes a synthetic campaign from a plan, with a truth file.  `selftest` computes what is known already.
"""

import json
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter

from imubayes.cli.session import (
    Flag,
    Json,
    Names,
    Trust,
    progress,
    show,
    split,
    start_jax,
    trusting,
)
from imubayes.foundations.errors import closest_first, input_error

if TYPE_CHECKING:
    from imubayes.campaign import Inspection
    from imubayes.display.check_report import CheckedModel
    from imubayes.display.layout import Report


def check(
    campaign: Path, *, model: Path | None = None, fix: Path | None = None, as_json: Json = False, verbose: Flag = False
) -> None:
    """Read a campaign and list its contents and faults.

    The outputs are compared with the stated set-up: zero, sense, azimuth and elevation of tables, mountings, units,
    channels, files, latitude, thermometers. The zero of a table: table x is horizontal, 90 deg clockwise from
    azimuth_deg, y = z x x, and angles are right-handed about z (picture in data/README.md).

    Example: imubayes check data/trihedral-imu --model models/trihedral-imu.toml

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    model
        Model file to check against the campaign, or the name of a shipped model.
    fix
        Folder to write: a copy with the mends that need no fact (spelling of keys, words and columns, order of rows in
        time), which is checked in place of the campaign.
    as_json
        Print one JSON object on standard output.
    verbose
        List every run and every note; otherwise those of one kind are one line.
    """
    from imubayes.display.check_report import check_record, check_report

    if fix is not None:
        from imubayes.campaign.mends import mend_campaign

        for mend in mend_campaign(campaign, fix) or ("nothing can be corrected without a further fact",):
            print(f"mended: {mend}" if "→" in mend or "order" in mend else mend, file=sys.stderr)
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
    """Return the inspection of a campaign and the size of the model bound to it; None where it cannot be used."""
    from imubayes.campaign import inspect_campaign
    from imubayes.display.check_report import CheckedModel

    with progress("reading the campaign") as tell:
        inspection = inspect_campaign(campaign)
        if inspection.campaign is None:
            return inspection, None
        tell("binding the model")
        start_jax()
        from imubayes.model.bind import bind
        from imubayes.model.model_file import read_model

        declared = bind(read_model(model), inspection.campaign)
        untold: tuple[str, ...] = ()
        if len(declared.layout) > len(declared.entries):
            from imubayes.inference.proposed_effects import untold_effects

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


def noise(
    campaign: Path,
    *,
    runs: Names = None,
    out: Path | None = None,
    shortest_tau: float = 0.0,
    sample_rate: float | None = None,
    robust: Flag = False,
    as_json: Json = False,
) -> int:
    """Estimate the noise terms of static records by likelihood, and their Allan deviations.

    Example: imubayes noise data/static-record --out results/noise

    Parameters
    ----------
    campaign
        Folder with campaign.toml.
    runs
        Runs of procedure static_record; by default all of them.
    out
        Folder to write: noise.json, the Allan deviation of every run as a figure, imu.yaml for kalibr, and
        noise-priors.toml, the terms as priors for models of other campaigns of the unit (key `noise_priors`).
    shortest_tau
        Shortest averaging time in s that the terms have to describe; above 0 if a filter shapes the noise of
        single samples.
    sample_rate
        Sampling rate in Hz of the raw data of those campaigns, for the priors; by default that of the record.
    robust
        Leave out stretches in which the unit did not rest: steps on the floor, a hand on the bench.
    as_json
        Print one JSON object on standard output.
    """
    from imubayes.campaign import load_campaign
    from imubayes.noise_analysis.noise_record import static_noise

    for name, value in (("--shortest-tau", shortest_tau), ("--sample-rate", sample_rate or 0.0)):
        if not 0 <= value < float("inf"):
            raise input_error(f"a value of {value:g}", name, "a number above 0", "correct it")
    written: list[Path] = []
    with progress("reading the campaign") as tell:
        read = load_campaign(campaign)
        found = static_noise(read, split(runs) or (), shortest_tau, tell, robust)
        if out is not None:
            from imubayes.display.noise_report import write_noise
            from imubayes.noise_analysis.noise_record import of_record

            tell("drawing")
            out.mkdir(parents=True, exist_ok=True)
            written = write_noise(out, found, sample_rate, of_record(found, read))

    def report() -> "Report":
        from imubayes.display.noise_report import noise_report  # it brings Matplotlib

        return noise_report(found)

    show(lambda: found, report, as_json)
    for file in written if not as_json else ():
        print(f"wrote {file}")
    return 0 if all(channel.converged for channel in found.channels) else 1


_RECORDS = {
    "campaign": ("imubayes.campaign.file_schemas", "CampaignFile"),
    "model": ("imubayes.campaign.file_schemas", "ModelFile"),
    "plan": ("imubayes.simulation.test_plan", "PlanFile"),
    "specification": ("imubayes.qualification.specification", "SpecificationFile"),
    "certificate": ("imubayes.qualification.certificate", "CertificateFile"),
    "constants": ("imubayes.qualification.onboard.record", "OnboardConstants"),
    "diagnosis": ("imubayes.criticism.diagnosis_record", "Diagnosis"),
    "change": ("imubayes.results.change_records", "ModelChange"),
    "history": ("imubayes.loop.model_history", "Node"),
    "fit": ("imubayes.results.fit_file", "FitRecord"),
    "report": ("imubayes.qualification.report_record", "QualificationReport"),
    "manifest": ("imubayes.results.folder_files", "Manifest"),
    "summary": ("imubayes.results.summary", "Summary"),
}
"""Kind of file → module and name of its pydantic record."""


def schema(kind: str) -> None:
    """Print the JSON Schema of a file, for completion and validation in an editor.

    Example: imubayes schema campaign > campaign.schema.json

    Parameters
    ----------
    kind
        campaign (campaign.toml), model, plan, specification, certificate; report; constants (of `imubayes export`);
        summary, fit, diagnosis, change, history or manifest (JSON files of a result).
    """
    if kind not in _RECORDS:
        allowed = closest_first(kind, _RECORDS)
        raise input_error(f"there is no schema '{kind}'", "argument KIND", allowed, "use one of the allowed kinds")
    module, record = _RECORDS[kind]
    dialect = {"$schema": "https://json-schema.org/draft/2020-12/schema"}
    print(json.dumps(dialect | getattr(import_module(module), record).model_json_schema(), indent=1))


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
        Trust the effect files that come with the input: they are code, and run, now and later, only if trusted.
    """
    with progress() as tell:
        start_jax()
        from imubayes.simulation.simulate import simulate_plan
        from imubayes.simulation.test_plan import read_plan

        trusting(read_plan(plan).model if trust else None, trust)
        tell("simulating")
        folder = simulate_plan(plan, out, seed)
    print(f"campaign in {folder}, truth in {folder / 'truth.toml'}; next: imubayes check {folder}")


def selftest(as_json: Json = False) -> int:
    """Compute published values, and a campaign whose answer is known by construction: for the records of a laboratory.

    Allan deviations (NIST SP 1065), propagation (JCGM 101), conformity (JCGM 106), sampling (GUM H.3) and a joint fit.
    The exit status is 1 if a value differs.

    Example: imubayes selftest

    Parameters
    ----------
    as_json
        Print one JSON object on standard output.
    """
    with progress() as tell:
        start_jax("known answers")
        from imubayes.api import selftest as known_answers
        from imubayes.display.own_equation import selftest_record, selftest_report

        answers = known_answers(tell)
        record = selftest_record(answers)
    show(lambda: record, lambda: selftest_report(record), as_json)
    return 0 if all(answer.agrees for answer in answers) else 1

"""A commented model file and a commented `campaign.toml`: what to begin with for runs of one's own."""

from collections.abc import Iterator, Mapping
from typing import Any

import tomlkit
from tomlkit.items import AoT

from imubayes import Registry
from imubayes.display.layout import Report
from imubayes.display.numbers_and_labels import listed, percent
from imubayes.foundations.covariates import remedy
from imubayes.foundations.wording import counted
from imubayes.inference.linear_information import STATION, of_equipment
from imubayes.model.model_file import EffectSpec
from imubayes.parameters.declarations import declared_parameters
from imubayes.procedures import PROCEDURES, Procedure
from imubayes_recordings.convert.proposed_effects import FURTHER, IN_MOTION, SENSORS, EffectProposal, ProposedEffect
from imubayes_recordings.display.expected_lines import expected_lines

_OF_CAMPAIGN = {
    "site": {
        "latitude_deg": "for the Earth rate, and for gravity if it is not stated",
        "height_m": "above the ellipsoid",
        "gravity_m_s2": "measured or assumed; every scale factor of an accelerometer refers to it",
    },
    "unit": {"serial": "`compare` and `predict` compare calibrations of the same unit"},
    "channel": {
        "input_axis": "in body axes",
        "scale": "nominal: output = offset + scale · input",
        "per": "unit of the input",
        "offset": "output at zero input",
    },
    "table": {
        "elevation_deg": "90: a rate table, 0: a dividing head",
        "azimuth_deg": "clockwise from North, or 'unknown'",
        "axis_uncertainty_arcsec": "one standard deviation; without this line the axis is exact",
    },
    "mounting": {
        "preset": "'aligned' or 'trihedral', or body_to_table = [[…], […], […]]",
        "uncertainty_arcmin": "one standard deviation about each axis; without this line the seat is exact",
    },
    "run": {"procedure": "`imubayes new FOLDER` without options lists them all", "file": "CSV or Parquet"},
}
# A value that nobody has stated: no key takes it.
OPEN = "?"


def template(
    name: str, procedure: Procedure, site: Mapping[str, float], serial: str, units: Mapping[str, str]
) -> tuple[str, str]:
    """Return a `campaign.toml` to be filled in, of an IMU and one run of a procedure, and the header of its table.

    Facts that `site` and `units` (of each kind of channel) do not state are left open: the campaign is refused, with
    line and key, until it is stated.
    """
    axes = [[float(row == column) for column in range(3)] for row in range(3)]
    document: dict[str, Any] = {"format": 1, "name": name}
    document["site"] = {"latitude_deg": OPEN, "gravity_m_s2": OPEN, **site}
    document["unit"] = {"serial": serial}
    document["channel"] = [
        {"name": f"{kind[0]}{axis}", "kind": kind, "input_axis": axes[place], "output_unit": units.get(kind, OPEN),
         "scale": 1.0 if kind in units else OPEN, "per": units.get(kind, OPEN)}
        for kind in ("accelerometer", "gyro")
        for place, axis in enumerate("xyz")
    ]  # fmt: skip
    run = {"name": "first", "procedure": procedure.name, "file": "runs/first.csv", "temperature_degC": OPEN}
    if procedure.needs_table:
        table = {"azimuth_deg": OPEN, "elevation_deg": OPEN, "axis_uncertainty_arcsec": OPEN}
        document["table"] = [{"name": "table", **table}]
        document["mounting"] = [{"name": "seat", "preset": OPEN, "uncertainty_arcmin": OPEN}]
        run |= {"table": "table", "mounting": "seat"}
    document["run"] = [run]
    channels = (channel["name"] for channel in document["channel"])
    columns = ["time_s", *(group[0] for group in procedure.columns), *channels]
    return commented_campaign(tomlkit.dumps(document)), ",".join(dict.fromkeys(columns)) + "\n"


def start_proposal() -> EffectProposal:
    """Return the effects to start with if there are no runs yet: each is left out if no run shows it."""
    names = (*of_equipment(), *STATION, *SENSORS)
    optional = [ProposedEffect(EffectSpec(name, optional=True)) for name in names]
    noise = [ProposedEffect(EffectSpec("white_noise")), ProposedEffect(EffectSpec("run_scatter", optional=True))]
    return EffectProposal((*optional, *noise), {}, {}, False)


def commented_campaign(text: str) -> str:
    """Return `campaign.toml` with a comment beside each key of its first site, channel, table, mounting and run."""
    document = tomlkit.parse(text)
    for name, comments in _OF_CAMPAIGN.items():
        part: Any = document.get(name)
        first: Any = part[0] if isinstance(part, AoT) and len(part) else part
        for key, comment in comments.items():
            if first is not None and key in first:
                first[key].comment(comment)
    return tomlkit.dumps(document)


def commented_model(name: str, proposal: EffectProposal, runs: int) -> str:
    """Return a model file: what these runs can determine, with what they show of it, and what they cannot."""
    lines = [
        f"# Written by `imubayes new`: the effects that {counted(runs, 'run')} can determine."
        if runs
        else "# Written by `imubayes new`, before there were runs; it omits effects that the runs cannot show.",
        "# `imubayes effects NAME` explains one; `imubayes diagnose` names missing effects after the fit.",
        "# Priors are those of the catalogue for the grade of the unit, unless stated here.",
        "format = 1",
        f"name = {tomlkit.item(name).as_string()}",
    ]
    purposes = (effect for procedure in PROCEDURES.values() for effect in procedure.purposes)
    further = tuple(dict.fromkeys((*FURTHER, *IN_MOTION, *purposes)))
    parts = (
        ("equipment and station, with the uncertainties that campaign.toml states", (*of_equipment(), *STATION)),
        ("the sensors", SENSORS),
        ("further effects that these runs determine beside all others", further),
    )
    rest = {effect for _, effects in parts for effect in effects}
    for title, effects in (*parts, ("noise", None)):
        own = [each for each in proposal.effects if each.spec.name in (effects or {each.spec.name} - rest)]
        if own:
            lines += ["", f"# {title}"]
        if own and effects is SENSORS and proposal.turned_by_hand:
            lines += ["# The accelerometers define the body frame: no table does."]
        for effect in own:
            lines += _entry(effect)
    lines += _left_out(proposal)
    return "\n".join(lines) + "\n"


def _entry(effect: ProposedEffect) -> Iterator[str]:
    spec = effect.spec
    yield ""
    yield "[[effect]]"
    comment = "; ".join(dict.fromkeys(each.meaning for each in _declared(spec.name).values() if each.meaning))
    if effect.shares is not None:
        least, most = (percent(share) for share in effect.shares)
        told = most if least == most else f"{least} to {most}"
        comment += f"; the runs supply {told} of the information on it"
    yield f"name = {tomlkit.item(spec.name).as_string()}" + (f"  # {comment}" if comment else "")
    if spec.channels is not None:
        yield f"channels = {tomlkit.item(list(spec.channels)).as_string()}"
    if spec.optional:
        yield "optional = true"
    if spec.prior:
        priors = ", ".join(f"{key} = {tomlkit.item(text).as_string()}" for key, text in spec.prior.items())
        yield f"prior = {{ {priors} }}"


def _declared(name: str):
    return declared_parameters(Registry().effects[name])


def _left_out(proposal: EffectProposal) -> Iterator[str]:
    if proposal.undetermined:
        yield ""
        yield "# These runs respond to the following effects as well, but do not determine them:"
        for name, share in proposal.undetermined.items():
            most = f"at most {percent(share)}" if share >= 0.01 else "less than 1 %"
            yield f"#   {name}: {most} of the information on each coefficient comes from the runs"
    if proposal.missing:
        yield ""
        yield "# Effects that no run shows, and the input that each needs:"
        for name, missing in proposal.missing.items():
            yield f"#   {name}: {'; '.join(dict.fromkeys(map(remedy, missing)))}"


def proposal_report(proposal: EffectProposal) -> Report:
    """Return the effects of the model, and what is not in it and why."""
    names = list(dict.fromkeys(each.spec.name for each in proposal.effects))
    lines = [f"The model has {counted(len(names), 'effect')}: {listed(names, 20)}."]
    if proposal.expected:
        lines += ["Standard uncertainties that the runs are expected to give, estimated from their noise:"]
        lines += expected_lines(proposal.expected)
    return Report([*lines, *(line.removeprefix("#").strip() for line in _left_out(proposal) if line)])

"""The certificate block: what ISO/IEC 17025 asks of a calibration certificate and no measurement supplies.

It stands as ``[certificate]`` in the specification, or in a file of its own::

    format = 1

    [certificate]
    number = "2026-0117"
    date = 2026-11-20
    method = "WI-12, issue 3: joint evaluation of rate table, dividing head and thermal runs"
    location = "laboratory 2, Example Town"
    accreditation = "D-K-00000-01-00, accredited calibration laboratory"

    [certificate.laboratory]
    name = "Example Laboratory"
    address = "Street 1, 12345 Example Town, DE"

    [[certificate.standard]]
    name = "rate table"
    equipment = ["rate"]         # what it is or traces in the campaign: see below
    certificate = "NMI 2026-0815"
    valid_until = 2027-03-01

    [[certificate.cmc]]          # no U of these quantities is stated smaller (ILAC-P14)
    quantity = "accel_bias.bias"
    expanded = 2
    unit = "ug"

Nothing of it is required of the file.  What ISO/IEC 17025:2017, 7.8.2 and 7.8.4, require of a certificate and the block
lacks is listed as missing on its last page.  What contradicts the campaign, and what other documents ask, is listed
beside it: standards of equipment that no run used or that had expired, dates in the wrong order, capabilities.

Equipment is what the runs used: tables by name; ``reference_gyro`` and ``current_injection``, procedures with a
standard of their own; ``gravity``, of accelerometers; and the instruments of what was read beside the outputs and
enters the results, ``time``, ``vibration``, and for temperatures the thermometers that runs name, or ``temperature``
and ``converter_temperature``.  Outputs that are counted per second have the standard ``time`` as well, and voltages and
currents ``meter``.  A claim is held against what was used: no standard of gravity was, if the campaign has the formula
of normal gravity.
"""

import datetime
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import AfterValidator, BaseModel, BeforeValidator, ConfigDict, Field, model_validator

from imubayes.campaign import file_schemas
from imubayes.campaign.toml_documents import Ledger, read_document
from imubayes.foundations.campaign_data import THERMOMETERS, Campaign, Run
from imubayes.foundations.covariates import instruments
from imubayes.foundations.records import Record
from imubayes.procedures.ambient import instant, starts_of
from imubayes.responses.instrument_errors import METER, TIME_BASE, readout
from imubayes_qualification.certificate.countries import COUNTRIES


def _visible(text: str) -> str:
    if all(unicodedata.category(letter) in ("Cf", "Zs") for letter in text):
        raise ValueError("it is blank")
    return text


# Words that stand for what is still to be written, wherever they are, and those that do so alone.
_TO_BE_WRITTEN = frozenset({"tbd", "tba", "tbc", "tbn", "todo", "fixme", "placeholder", "lorem"})
_NOTHING = frozenset({"na", "none", "null", "nil", "nan", "unknown", "pending", "dummy", "notapplicable",
                      "notavailable", "notstated", "tobedetermined", "tobedefined", "tobeannounced"})  # fmt: skip
_WORDS = re.compile(r"[^\W_]+")


def is_placeholder(text: str) -> bool:
    """Return whether a text stands for a name or number that is still to be written: ``n/a``, ``TBD``, ``NMI-XXXX``."""
    words = _WORDS.findall(text.casefold())
    whole = "".join(words)
    if not whole or whole in _NOTHING or not whole.strip("x") or not whole.strip("0"):
        return True
    return any(word in _TO_BE_WRITTEN or (len(word) > 2 and not word.strip("x")) for word in words)


def _identified(text: str) -> str:
    if is_placeholder(text):
        raise ValueError(f"{text!r} is a placeholder; leave the key out to have it listed as missing")
    return text


def _in_order(span: tuple[float, float]) -> tuple[float, float]:
    if span[0] > span[1]:
        raise ValueError("the lowest comes first")
    return span


def _no_number(value: object) -> object:
    """Refuse the numbers that stand for seconds since 1970."""
    if isinstance(value, int | float):
        raise ValueError(f"{value!r} is not a date, as 2026-11-20")
    return value


def _assigned(country: str) -> str:
    if country not in COUNTRIES:
        raise ValueError(f"{country!r} is not a country of ISO 3166-1, such as GB of the United Kingdom")
    return country


Text = Annotated[file_schemas.Text, Field(min_length=1, max_length=2000), AfterValidator(_visible)]
Identity = Annotated[Text, AfterValidator(_identified)]
Date = Annotated[datetime.date, BeforeValidator(_no_number)]
Celsius = Annotated[float, Field(strict=True, ge=-273.15)]
Percent = Annotated[float, Field(strict=True, ge=0, le=100)]
Pressure = Annotated[float, Field(strict=True, ge=0)]


class _CertificatePart(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


class Party(_CertificatePart):
    """Laboratory or customer."""

    name: Identity | None = Field(default=None, description="of the organisation")
    address: Identity | None = Field(default=None, description="as on a letter, one line")
    country: Annotated[str, Field(pattern=file_schemas.COUNTRY), AfterValidator(_assigned)] | None = Field(
        default=None, description="ISO 3166-1"
    )
    email: Identity | None = Field(default=None, description="for questions")


class CertifiedItem(_CertificatePart):
    """What was calibrated; its serial number is that of the campaign."""

    description: Identity | None = Field(default=None, description="what it is")
    manufacturer: Identity | None = Field(default=None, description="manufacturer of the item")
    model: Identity | None = Field(default=None, description="type designation")
    condition: Text | None = Field(default=None, description="condition on receipt")
    received: Date | None = Field(default=None, description="date of receipt")


class MeasurementStandard(_CertificatePart):
    """A standard that was used, with its traceability."""

    name: Identity = Field(description="kind of standard: rate table, dividing head, gravity, thermometer")
    equipment: tuple[Text, ...] = Field(
        default=(),
        description="equipment that this standard is, or to which it gives traceability: tables and thermometers by "
        "name, reference_gyro, current_injection, gravity, temperature, converter_temperature, time, vibration, meter",
    )
    serial: Identity | None = Field(default=None, description="its serial number")
    certificate: Identity | None = Field(default=None, description="number of its calibration certificate")
    issued_by: Identity | None = Field(default=None, description="issuer of that certificate")
    calibrated: Date | None = Field(default=None, description="date of its calibration")
    valid_until: Date | None = Field(default=None, description="date at which its calibration is due again")

    @model_validator(mode="after")
    def _is_valid_after_its_calibration(self) -> "MeasurementStandard":
        if self.calibrated and self.valid_until and self.calibrated > self.valid_until:
            raise ValueError(f"calibrated on {self.calibrated}, which is after valid_until, {self.valid_until}")
        return self


class Environment(_CertificatePart):
    """Conditions during the calibration that influence it: lowest and highest."""

    temperature_degC: Annotated[tuple[Celsius, Celsius], AfterValidator(_in_order)] | None = Field(
        default=None, description="of the air"
    )
    humidity_percent: Annotated[tuple[Percent, Percent], AfterValidator(_in_order)] | None = Field(
        default=None, description="relative humidity of the air"
    )
    pressure_hPa: Annotated[tuple[Pressure, Pressure], AfterValidator(_in_order)] | None = Field(
        default=None, description="of the air"
    )
    text: Text | None = Field(default=None, description="anything else, such as vibration")


class CapabilityEntry(_CertificatePart):
    """A calibration and measurement capability of the laboratory (CMC)."""

    quantity: Text = Field(
        description="name in the summary of a fit; without the labels in brackets, all of the family"
    )
    expanded: Annotated[float, Field(gt=0, lt=1e15, strict=True)] = Field(
        description="smallest expanded uncertainty that may be stated"
    )
    unit: Text = Field(description="of that")


class Amendment(_CertificatePart):
    """What an amended or reissued certificate changes (ISO/IEC 17025:2017, 7.8.8)."""

    of: Identity = Field(description="number of the certificate that is amended or replaced")
    changes: Text = Field(description="information that is changed")
    reason: Text | None = Field(default=None, description="of the change")
    replaces: bool = Field(
        default=True, description="true for a complete new certificate that replaces it, false for an amendment"
    )


class ExternalResult(_CertificatePart):
    """Results that an external provider obtained."""

    provider: Identity = Field(description="provider that obtained them")
    results: Text = Field(description="description of the results, such as runs of the campaign")


class Signatory(_CertificatePart):
    """A person who authorises the certificate."""

    name: Identity = Field(description="name of the signatory")
    function: Text | None = Field(default=None, description="in the laboratory")


class Certificate(_CertificatePart):
    """The certificate block (ISO/IEC 17025:2017, 7.8.2 and 7.8.4)."""

    number: Identity | None = Field(default=None, description="unique identification of the certificate")
    date: Date | None = Field(default=None, description="of issue")
    title: Identity = Field(default="Calibration certificate", description="of the document")
    laboratory: Party = Field(default=Party(), description="laboratory that made the calibration")
    customer: Party = Field(default=Party(), description="customer of the calibration")
    order: Identity | None = Field(default=None, description="of the customer")
    item: CertifiedItem = Field(default=CertifiedItem(), description="what was calibrated")
    location: Identity | None = Field(default=None, description="place of the calibration")
    method: Identity | None = Field(default=None, description="identification of the method")
    standard: tuple[MeasurementStandard, ...] = Field(default=(), description="standards that were used")
    cmc: tuple[CapabilityEntry, ...] = Field(default=(), description="capabilities: no U is stated smaller")
    environment: Environment = Field(default=Environment(), description="conditions during the calibration")
    adjustment: Text | None = Field(default=None, description="results before and after an adjustment")
    deviations: Text | None = Field(default=None, description="from the method")
    amendment: Amendment | None = Field(
        default=None, description="present if it amends or replaces an issued certificate"
    )
    external: tuple[ExternalResult, ...] = Field(default=(), description="results of external providers")
    customer_data: Text | None = Field(
        default=None, description="information that the customer provided, such as limits"
    )
    sampling: Text | None = Field(default=None, description="plan and method by which the item was sampled")
    remarks: Text | None = Field(default=None, description="of the laboratory")
    accreditation: Identity | None = Field(default=None, description="text of the accreditation mark")
    signatory: tuple[Signatory, ...] = Field(default=(), description="who authorises the certificate")

    @model_validator(mode="after")
    def _has_a_number_of_its_own(self) -> "Certificate":
        if self.amendment is not None and self.amendment.of == self.number:
            raise ValueError(f"a certificate that amends or replaces {self.number!r} has a number of its own")
        return self


class CertificateFile(_CertificatePart):
    """A certificate block in a file of its own."""

    format: Literal[1] = Field(description="of this file")
    certificate: Certificate = Field(description="the block")


MissingItem = Literal[
    "number", "date", "laboratory_name", "laboratory_address", "location", "customer_name", "customer_address",
    "method", "item_description", "serial", "received", "performed", "environment", "standards",
    "standard_certificate", "standard_validity", "expired", "untraced", "unused", "normal_gravity",
    "repeated_standard", "shared_certificate", "own_number", "own_standard", "calibrated_late", "received_late",
    "issued_early",
    "omitted", "validity", "cmc", "signatories",
]  # fmt: skip
"""Omissions of a certificate, and its contradictions to the campaign.

`expired` is a standard whose validity ended before the last run that used it, `untraced` equipment of the runs that no
standard names, `unused` what a standard names and no run used, `normal_gravity` a measured gravity in place of its
formula, `repeated_standard` one that is listed twice, `shared_certificate` a number that several issuers gave,
`own_number` the number of this certificate given to that of a standard, `own_standard` a standard whose certificate
this laboratory issued, `calibrated_late` one that was calibrated after the first run that used it, `omitted` what U is
known to lack, `validity` that of the model or the fit, `cmc` the capabilities of a laboratory that states an
accreditation.
"""


REQUIRED: frozenset[MissingItem] = frozenset({
    "number", "date", "laboratory_name", "laboratory_address", "location", "customer_name", "customer_address",
    "method", "item_description", "serial", "received", "performed", "environment", "standards", "untraced",
    "normal_gravity", "signatories",
})  # fmt: skip
"""Requirements of ISO/IEC 17025:2017 on a certificate, 7.8.2.1 and 7.8.4.1."""


class Missing(Record):
    """One thing that is missing, and of which standard if it is one's."""

    item: MissingItem
    of: str = ""

    @property
    def required(self) -> bool:
        """Whether ISO/IEC 17025 requires it of a certificate; else it is a contradiction, or other documents ask it."""
        return self.item in REQUIRED


class CapabilityFloor(Record):
    """A quantity whose U is the CMC: in its unit, the CMC and U by the budget."""

    name: str
    unit: str
    expanded: float
    own: float


def read_certificate(file: str | Path) -> tuple[Certificate, Ledger]:
    """Return the certificate block of a file of its own, and the ledger that knows the line of every key.

    Raises
    ------
    InputError
        with everything that is wrong with the file.
    """
    document = read_document(Path(file), CertificateFile)
    document.ledger.stop_if_any()
    assert document.entry is not None, "an invalid document has issues"
    return document.entry.certificate, document.ledger


GRAVITY = "gravity"
# Procedures whose stimulus comes from a standard that is no table.
_WITH_STANDARD = ("reference_gyro", "current_injection")
_READOUTS = {TIME_BASE: "time", METER: "meter"}


@dataclass(frozen=True)
class EquipmentUsed:
    """What runs used that a standard may trace, each with the start of the first and of the last run that did.

    Attributes
    ----------
    needed : what enters the results: tables, procedures with a standard, gravity, instruments of covariates and of
        outputs.
    recorded : what is known and enters no result: instruments of covariates that no effect of the model reads, gravity
        of a unit without accelerometers.
    normal_gravity : whether gravity is that of the formula, which no standard gave.
    """

    needed: Mapping[str, "Used"]
    recorded: Mapping[str, "Used"]
    normal_gravity: bool


@dataclass(frozen=True)
class Used:
    """When equipment was used: start of the first and of the last run that did; None if no run states its start."""

    first: str | None = None
    last: str | None = None

    def by(self, start: str | None) -> "Used":
        """Return this with a further run."""
        known = sorted(filter(None, (self.first, self.last, start)), key=instant)
        return Used(known[0], known[-1]) if known else self


def equipment_used(campaign: Campaign, covariates: Collection[str] = ()) -> EquipmentUsed:
    """Return what the runs of a campaign used as standards.

    Parameters
    ----------
    covariates : that the effects of the model read.
    """
    accelerometers = any(channel.kind == "accelerometer" for channel in campaign.channels)
    read, normal = instruments(covariates), campaign.site.has_normal_gravity
    gravity = () if normal else (GRAVITY,)
    needed, recorded = dict[str, Used](), dict[str, Used]()
    for run in campaign.runs:
        own = instruments(run.covariates)
        procedure = run.procedure if run.procedure in _WITH_STANDARD else None
        called = _called(run, own)
        enters = [run.table, procedure, *(called[name] for name in own if name in read)]
        enters += filter(None, (_READOUTS.get(readout(each.output_unit) or "") for each in campaign.channels))
        beside = [called[name] for name in own if called[name] not in enters]
        (enters if accelerometers else beside).extend(gravity)
        for listed, names in ((needed, enters), (recorded, beside)):
            for name in filter(None, names):
                listed[name] = listed.get(name, Used()).by(run.start)
    return EquipmentUsed(needed, recorded, accelerometers and normal)


def _called(run: Run, own: Sequence[str]) -> dict[str, str]:
    """Return what standards for readings of a run are called: a thermometer with a name is traced by it."""
    named = dict(zip(("temperature", "converter_temperature"), THERMOMETERS, strict=True))
    return {name: (getattr(run, named[name]) if name in named else None) or name for name in own}


def missing_items(found: Certificate, campaign: Campaign, covariates: Collection[str] = ()) -> tuple[Missing, ...]:
    """Return what ISO/IEC 17025 requires and a certificate lacks, what in it contradicts the campaign, and a CMC.

    Parameters
    ----------
    covariates : that the effects of the model read.
    """
    item, laboratory, customer = found.item, found.laboratory, found.customer
    starts = starts_of(campaign.runs)
    required: dict[MissingItem, object] = {
        "number": found.number, "date": found.date, "laboratory_name": laboratory.name,
        "laboratory_address": laboratory.address, "location": found.location, "customer_name": customer.name,
        "customer_address": customer.address, "method": found.method,
        "item_description": item.description or item.model, "received": item.received,
        "serial": campaign.serial and not is_placeholder(campaign.serial),
        "performed": starts, "environment": any(found.environment.model_dump().values()), "standards": found.standard,
        "received_late": not (item.received and starts and item.received > _day(starts[0])),
        "issued_early": not (found.date and starts and found.date < _day(starts[-1])),
        "signatories": found.signatory, "cmc": found.cmc or not found.accreditation,
    }  # fmt: skip
    absent = [Missing(item=name) for name, given in required.items() if not given]
    used = equipment_used(campaign, covariates)
    if not found.standard:
        return tuple(absent)
    return (*absent, *_of_standards(found.standard, used, starts), *_of_itself(found))


def _of_itself(found: Certificate) -> Iterator[Missing]:
    """Yield what a certificate would be traceable to itself by: its own number, or its own laboratory."""
    for each in found.standard:
        if found.number and _plain(each.certificate) == _plain(found.number):
            yield Missing(item="own_number", of=each.name)
        if found.laboratory.name and _plain(each.issued_by) == _plain(found.laboratory.name):
            yield Missing(item="own_standard", of=each.name)


def _of_standards(
    standards: Sequence[MeasurementStandard], equipment: EquipmentUsed, starts: Sequence[str]
) -> Iterator[Missing]:
    used, traced = {**equipment.recorded, **equipment.needed}, set[str]()
    if equipment.normal_gravity:
        yield Missing(item="normal_gravity")
    yield from _repeated(standards)
    for standard in standards:
        own = {standard.name, *standard.equipment}
        traced |= own
        claimed = (*standard.equipment, *({standard.name} & {GRAVITY}))
        for name in dict.fromkeys(name for name in claimed if name not in used):
            yield Missing(item="unused", of=f"{standard.name}: {name}")
        yield from _of_dates(standard, [used[name] for name in own if name in used], starts)
    for name in equipment.needed:
        if name not in traced:
            yield Missing(item="untraced", of=name)


def _of_dates(standard: MeasurementStandard, used: Sequence[Used], starts: Sequence[str]) -> Iterator[Missing]:
    """Yield what the certificate of a standard lacks, or was not at the runs that used it; all if none is known."""
    times = [each for each in used if each.first] or [Used(starts[0], starts[-1])] if starts else []
    first = min(filter(None, (each.first for each in times)), key=instant, default=None)
    last = max(filter(None, (each.last for each in times)), key=instant, default=None)
    if standard.certificate is None:
        yield Missing(item="standard_certificate", of=standard.name)
    if standard.calibrated is not None and first is not None and _day(first) < standard.calibrated:
        yield Missing(item="calibrated_late", of=standard.name)
    if standard.valid_until is None:
        yield Missing(item="standard_validity", of=standard.name)
    elif last is not None and _day(last) > standard.valid_until:
        yield Missing(item="expired", of=standard.name)


def _repeated(standards: Sequence[MeasurementStandard]) -> Iterator[Missing]:
    """Yield the standards that are listed more than once, and the certificates that have several issuers."""
    entries = Counter(tuple(map(_plain, (each.name, each.serial, each.certificate))) for each in standards)
    for each in {_plain(each.name): each for each in reversed(standards)}.values():
        if any(times > 1 and name == _plain(each.name) for (name, _, _), times in entries.items()):
            yield Missing(item="repeated_standard", of=each.name)
    issuers: dict[str, dict[str, MeasurementStandard]] = {}
    for each in standards:
        if each.certificate and each.issued_by:
            issuers.setdefault(_plain(each.certificate), {}).setdefault(_plain(each.issued_by), each)
    for by in issuers.values():
        if len(by) > 1:
            first = next(iter(by.values()))
            names = ", ".join((each.issued_by or "").strip() for each in by.values())
            yield Missing(item="shared_certificate", of=f"{(first.certificate or '').strip()}: {names}")


def _plain(text: str | None) -> str:
    """Return a text as it is compared: case and blanks are no difference between two certificates."""
    return " ".join((text or "").split()).casefold()


def _day(start: str) -> datetime.date:
    return datetime.date.fromisoformat(start[:10])

"""The certificate block: what ISO/IEC 17025 asks of a calibration certificate and no measurement tells.

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
    certificate = "NMI 2026-0815"
    valid_until = 2027-03-01

Nothing of it is required of the file; what ISO/IEC 17025:2017, 7.8.2 and 7.8.4, require of a certificate and the block
lacks is listed as missing on its last page.
"""

import datetime
from collections.abc import Iterator
from pathlib import Path
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

from imubayes.campaign.toml_documents import read_document
from imubayes.foundations.records import Record

Text = Annotated[str, Field(min_length=1, max_length=2000)]
Range = tuple[float, float]


class _CertificatePart(BaseModel):
    model_config = ConfigDict(extra="forbid", allow_inf_nan=False, frozen=True)


class Party(_CertificatePart):
    """Laboratory or customer."""

    name: Text | None = Field(default=None, description="of the organisation")
    address: Text | None = Field(default=None, description="as on a letter, one line")
    country: Annotated[str, Field(pattern="^[A-Z]{2}$")] | None = Field(default=None, description="ISO 3166-1")
    email: Text | None = Field(default=None, description="for questions")


class CertifiedItem(_CertificatePart):
    """What was calibrated; its serial number is that of the campaign."""

    description: Text | None = Field(default=None, description="what it is")
    manufacturer: Text | None = Field(default=None, description="who made it")
    model: Text | None = Field(default=None, description="type designation")
    condition: Text | None = Field(default=None, description="in which it was received")
    received: datetime.date | None = Field(default=None, description="date of receipt")


class MeasurementStandard(_CertificatePart):
    """A standard that was used, and what its traceability rests on."""

    name: Text = Field(description="what it is: rate table, dividing head, gravity, thermometer")
    serial: Text | None = Field(default=None, description="its serial number")
    certificate: Text | None = Field(default=None, description="number of its calibration certificate")
    issued_by: Text | None = Field(default=None, description="who issued that")
    valid_until: datetime.date | None = Field(default=None, description="when it is due again")


class Environment(_CertificatePart):
    """Conditions during the calibration that influence it: lowest and highest."""

    temperature_degC: Range | None = Field(default=None, description="of the air")
    humidity_percent: Range | None = Field(default=None, description="relative humidity of the air")
    pressure_hPa: Range | None = Field(default=None, description="of the air")
    text: Text | None = Field(default=None, description="anything else, such as vibration")


class Signatory(_CertificatePart):
    """A person who authorises the certificate."""

    name: Text = Field(description="as it signs")
    function: Text | None = Field(default=None, description="in the laboratory")


class Certificate(_CertificatePart):
    """The certificate block (ISO/IEC 17025:2017, 7.8.2 and 7.8.4)."""

    number: Text | None = Field(default=None, description="unique identification of the certificate")
    date: datetime.date | None = Field(default=None, description="of issue")
    title: Text = Field(default="Calibration certificate", description="of the document")
    laboratory: Party = Field(default=Party(), description="who calibrated")
    customer: Party = Field(default=Party(), description="for whom")
    order: Text | None = Field(default=None, description="of the customer")
    item: CertifiedItem = Field(default=CertifiedItem(), description="what was calibrated")
    location: Text | None = Field(default=None, description="where the calibration was made")
    method: Text | None = Field(default=None, description="identification of the method")
    standard: tuple[MeasurementStandard, ...] = Field(default=(), description="standards that were used")
    environment: Environment = Field(default=Environment(), description="conditions during the calibration")
    adjustment: Text | None = Field(default=None, description="results before and after, where it was adjusted")
    deviations: Text | None = Field(default=None, description="from the method")
    remarks: Text | None = Field(default=None, description="of the laboratory")
    accreditation: Text | None = Field(default=None, description="text of the accreditation mark")
    signatory: tuple[Signatory, ...] = Field(default=(), description="who authorises the certificate")


class CertificateFile(_CertificatePart):
    """A certificate block in a file of its own."""

    format: Literal[1] = Field(description="of this file")
    certificate: Certificate = Field(description="the block")


MissingItem = Literal[
    "number", "date", "laboratory_name", "laboratory_address", "location", "customer_name", "customer_address",
    "method", "item_description", "serial", "received", "performed", "environment", "standards",
    "standard_certificate", "standard_validity", "expired", "signatories",
]  # fmt: skip
"""What ISO/IEC 17025 requires and a certificate lacks; `expired` is a standard whose validity ended before the end."""


class Missing(Record):
    """One thing that is missing, and of which standard where it is one's."""

    item: MissingItem
    of: str = ""


def read_certificate(file: str | Path) -> Certificate:
    """Return the certificate block of a file of its own.

    Raises
    ------
    InputError
        with everything that is wrong with the file.
    """
    document = read_document(Path(file), CertificateFile)
    document.ledger.stop_if_any()
    assert document.entry is not None, "an invalid document has issues"
    return document.entry.certificate


def missing_items(found: Certificate, serial: str, first: str | None, last: str | None) -> tuple[Missing, ...]:
    """Return what ISO/IEC 17025 requires and a certificate lacks.

    Parameters
    ----------
    serial : of the unit; empty where the campaign states none.
    first, last : start of the first and of the last run, ISO 8601; None where none was recorded.
    """
    item, laboratory, customer = found.item, found.laboratory, found.customer
    required: dict[MissingItem, object] = {
        "number": found.number, "date": found.date, "laboratory_name": laboratory.name,
        "laboratory_address": laboratory.address, "location": found.location, "customer_name": customer.name,
        "customer_address": customer.address, "method": found.method,
        "item_description": item.description or item.model, "serial": serial, "received": item.received,
        "performed": first, "environment": any(found.environment.model_dump().values()), "standards": found.standard,
        "signatories": found.signatory,
    }  # fmt: skip
    absent = [Missing(item=name) for name, given in required.items() if not given]
    return (*absent, *(each for standard in found.standard for each in _of_standard(standard, last)))


def _of_standard(standard: MeasurementStandard, last: str | None) -> Iterator[Missing]:
    if standard.certificate is None:
        yield Missing(item="standard_certificate", of=standard.name)
    if standard.valid_until is None:
        yield Missing(item="standard_validity", of=standard.name)
    elif last is not None and datetime.date.fromisoformat(last[:10]) > standard.valid_until:
        yield Missing(item="expired", of=standard.name)

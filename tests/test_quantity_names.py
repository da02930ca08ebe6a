"""Names of quantities are written and read in one place."""

import re

import pytest

from imubayes.foundations.quantity_names import QuantityName, family_of, name_of
from test_layering import SOURCE, SOURCES


@pytest.mark.parametrize(
    ("text", "family", "labels"),
    [
        ("gyro_bias.bias[gx]", "gyro_bias.bias", ("gx",)),
        ("mounting_angle[gx,pyramid 2]", "mounting_angle", ("gx", "pyramid 2")),
        ("gyro_g_sensitivity.k[gx,y]", "gyro_g_sensitivity.k", ("gx", "y")),
        ("table_rate_error.rate_error", "table_rate_error.rate_error", ()),
    ],
)
def test_a_name_is_read_as_it_was_written(text, family, labels):
    name = QuantityName.of(text)
    assert (name.family, name.labels) == (family, labels)
    assert str(name) == text == name_of(family, *labels)
    assert name.label == ",".join(labels)
    assert family_of(text) == family
    assert name.first == (labels[0] if labels else "")
    assert f"{name.effect}.{name.parameter}".rstrip(".") == family
    assert ".".join(filter(None, name.parts)) == text
    assert (name.parts[1] == "") == (name.parameter == "")


TAKEN_APART = re.compile(
    r"""partition\(['"]\[['"]\)|split\(['"]\[['"]|(?:strip|suffix)\(['"]\]['"]\)|(?:startswith|endswith|removeprefix)\(f?['"][a-z_{}.]*\[|(?:family|(?:estimate|first|best|quantity)\.name)\.(?:r?partition|split)\(['"]\.['"]"""
)
PUT_TOGETHER = re.compile(
    r"""f["'](?:\{effect\}\.\{parameter\}|scale_factor|mounting_angle|axis_angle|input_axis|delta_k|white_noise\.sigma)\["""
)
# Fields of a log of an autopilot have brackets of their own.
OTHER_BRACKETS = {"imubayes_recordings/convert/formats/ulog.py"}


def offenders(sources: dict[str, str]) -> list[str]:
    return [
        f"{name}:{number}"
        for name, text in sources.items()
        for number, line in enumerate(text.splitlines(), start=1)
        if TAKEN_APART.search(line) or PUT_TOGETHER.search(line)
    ]


def test_no_other_file_takes_a_name_apart_or_puts_one_together():
    files = {str(file.relative_to(SOURCE)): file for file in SOURCES}
    for owner in ("imubayes/foundations/quantity_names.py", *OTHER_BRACKETS):
        del files[owner]
    assert offenders({name: file.read_text() for name, file in files.items()}) == []


@pytest.mark.parametrize(
    "line",
    [
        'a = name.partition("[")[0]',
        'effect, field = estimate.name.split(".")',
        'name.startswith("scale_factor[")',
        "f'mounting_angle[{a},{b}]'",
    ],
)
def test_the_rule_finds_what_it_forbids(line):
    assert offenders({"x.py": line}) == ["x.py:1"]

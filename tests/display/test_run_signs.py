"""Runs are distinguished by every reader: hues under colour vision deficiency, mountings and temperatures by class."""

import itertools

import numpy as np
import polars as pl
import pytest
import synthetic_results as made

from imubayes.display.figure_style import HUES, RunSigns, run_signs

# Machado, Oliveira and Fernandes (2009), severity 1, linear sRGB.
VISION = {
    "normal": np.eye(3),
    "protanopia": np.array(
        [[0.152286, 1.052583, -0.204868], [0.114503, 0.786281, 0.099216], [-0.003882, -0.048116, 1.051998]]
    ),
    "deuteranopia": np.array(
        [[0.367322, 0.860646, -0.227968], [0.280085, 0.672501, 0.047413], [-0.011820, 0.042940, 0.968881]]
    ),
    "tritanopia": np.array(
        [[1.255528, -0.076749, -0.178779], [-0.078411, 0.930809, 0.147602], [0.004733, 0.691367, 0.303900]]
    ),
}
TO_XYZ = np.array(
    [[0.4124564, 0.3575761, 0.1804375], [0.2126729, 0.7151522, 0.072175], [0.0193339, 0.119192, 0.9503041]]
)


def lab(hue: str, vision: np.ndarray) -> np.ndarray:
    """CIE 1976 L*a*b* of an sRGB colour as a reader of that vision sees it."""
    encoded = np.array([int(hue[place : place + 2], 16) for place in (1, 3, 5)]) / 255
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    ratio = TO_XYZ @ np.clip(vision @ linear, 0, 1) / np.array([0.95047, 1.0, 1.08883])
    f = np.where(ratio > 0.008856, np.cbrt(ratio), 7.787 * ratio + 16 / 116)
    return np.array([116 * f[1] - 16, 500 * (f[0] - f[1]), 200 * (f[1] - f[2])])


def closest(hues: tuple[str, ...], vision: np.ndarray) -> float:
    return min(float(np.linalg.norm(lab(a, vision) - lab(b, vision))) for a, b in itertools.combinations(hues, 2))


@pytest.mark.parametrize("vision", VISION)
def test_hues_are_told_apart(vision):
    assert closest(HUES, VISION[vision]) > 22


def test_the_measure_sees_hues_that_merge():
    assert closest(("#009e73", "#cc79a7"), VISION["deuteranopia"]) < 20 < closest(("#009e73", "#cc79a7"), np.eye(3))


def test_hue_is_the_mounting_and_marker_the_temperature():
    mounting = {"a": "x-up", "b": "x-up", "c": "y-up", "d": "y-up"}
    temperature = {"a": "−40 °C", "b": "25 °C", "c": "25 °C", "d": "ramp"}
    signs = RunSigns("abcd", mounting, temperature)
    a, b, c, d = (signs.sign(run) for run in "abcd")
    assert a.hue == b.hue != c.hue == d.hue
    assert b.marker == c.marker
    assert len({a.marker, b.marker, d.marker}) == 3
    labels = [entry.label for entry in signs.legend()]
    assert labels == ["mounting", "x-up", "y-up", "temperature", "−40 °C", "25 °C", "ramp"]
    assert [entry.label for entry in signs.legend(["a", "b"])] == ["mounting", "x-up", "temperature", "−40 °C", "25 °C"]


@pytest.mark.parametrize("count", [2, 6, 12])
def test_runs_of_one_mounting_have_signs_of_their_own(count):
    runs = [f"run-{place}" for place in range(count)]
    signs = RunSigns(runs, dict.fromkeys(runs, "flat"))
    assert len({signs.sign(run) for run in runs}) == count
    assert [entry.label for entry in signs.legend()] == runs


def test_many_runs_are_told_apart_by_procedure():
    runs = [f"run-{place}" for place in range(30)]
    signs = RunSigns(
        runs, procedure={run: "rate_table" if place % 2 else "dividing_head" for place, run in enumerate(runs)}
    )
    assert [entry.label for entry in signs.legend()] == ["procedure", "dividing head", "rate table"]


def test_temperature_levels_and_ramps_of_a_table():
    frame = pl.DataFrame(
        {
            "run": ["cold"] * 3 + ["ramp"] * 3 + ["room"] * 3 + ["no thermometer"] * 3,
            "temperature_degC": [-40.2, -40.0, -39.7, -40.0, 0.0, 60.0, 24.0, 25.0, 26.0, None, None, None],
        }
    )
    signs = run_signs(frame)
    labels = [entry.label for entry in signs.legend()]
    assert labels[labels.index("temperature") + 1 :] == ["−40 °C", "25 °C", "not recorded", "ramp"]


def test_every_legend_entry_is_of_another_sign():
    signs = run_signs(made.trihedral_residuals(temperatures=(-40, 25, 60)))
    drawn = [entry.sign for entry in signs.legend() if entry.sign is not None]
    assert len(drawn) == len(set(drawn))

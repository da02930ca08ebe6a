"""The blind study (`make study`), and the rules by which it judges (in the everyday tests)."""

import sys
from itertools import pairwise
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))
import blind
import judging

EMPTY = {"verdict": "adequate", "groups": [], "structure": [], "undetectable": [], "ranking": [], "threshold": 0.05}
LAG = {"effect": "gyro_thermal_lag", "channels": ["gx"], "s": 50.0, "s_alone": 50.0, "within": 50.0, "shown": 1.0}
K2 = LAG | {"effect": "accel_quadratic", "channels": ["ay"]}
ENCODER = LAG | {"effect": "encoder_harmonic", "channels": []}


def group(*effects, channels=("gx",)):
    return {"effects": list(effects), "channels": list(channels), "candidates": []}


def explained(*groups, near=""):
    structure = [{"covariate": near}] if near else []
    return EMPTY | {"verdict": "missing_effect", "groups": list(groups), "structure": structure}


def line(kind, document, *planted, **more):
    return {"kind": kind, "seed": 1, "template": "table", "readings": 500, "converged": True, "document": document,
            "planted": list(planted), "seconds": {"draw": 1, "fit": 1, "diagnose": 1}} | more  # fmt: skip


def shape(covariate):
    return EMPTY | {"verdict": "unexplained_structure", "structure": [{"covariate": covariate}]}


def absent_down_to_four(sd):
    name = "gyro_bias_temperature.slope[gx]"
    return EMPTY | {"ranking": [{"coefficients": [{"name": name, "value": 0.0, "sd": sd}]}]}


def proposed(channels):
    return {"suggested": {"effects": ["gyro_thermal_lag", "accel_quadratic", "accel_cubic"], "channels": channels}}


SLOPE = LAG | {"effect": "gyro_bias_temperature", "parameters": {"gyro_bias_temperature.slope[gx]": -1.0}}
WAVE = LAG | {"effect": "outside_temperature_wave"}


@pytest.mark.parametrize(
    ("fine", "one"),
    [
        (True, line("hidden", explained(group("gyro_thermal_lag", "gyro_bias_drift", channels=("gx", "gy"))), LAG)),
        (False, line("hidden", explained(group("gyro_bias_drift"), group("gyro_thermal_lag")), LAG)),
        (False, line("hidden", explained(group("gyro_thermal_lag", channels=("gy",))), LAG)),
        (False, line("hidden", EMPTY, LAG)),
        (True, line("large", explained(group("gyro_thermal_lag")), LAG)),
        (False, line("large", shape("time_s"), LAG)),
        (True, line("hidden", explained(group("encoder_harmonic", channels=("head",))), ENCODER)),
        (False, line("hidden", explained(group("gyro_thermal_lag")), LAG, converged=False)),
        (True, line("null-white", EMPTY)),
        (False, line("null-white", EMPTY | {"verdict": "noise_model"})),
        (True, line("null-ar1", EMPTY | {"verdict": "noise_model"})),
        (False, line("null-ar1", explained(group("gyro_bias_drift")))),
        (False, line("null-runs", shape("time_s"))),
        (True, line("outside", shape("anything"), WAVE)),
        (True, line("outside", shape("temperature_degC") | {"verdict": "adequate"}, WAVE)),
        (False, line("outside", shape("rate") | {"verdict": "adequate"}, WAVE)),
        (False, line("outside", explained(group("gyro_thermal_lag"), near="temperature"), WAVE)),
        (False, line("outside", explained(group("gyro_thermal_lag")), WAVE)),
        (False, line("outside", EMPTY, WAVE)),
        (True, line("offsets", EMPTY | {"undetectable": [{"effect": "gyro_thermal_lag"}]}, LAG)),
        (True, line("offsets", EMPTY, SLOPE, asked=EMPTY | {"verdict": "undetectable"})),
        (True, line("offsets", EMPTY, SLOPE, asked=absent_down_to_four(0.5))),
        (False, line("offsets", EMPTY, SLOPE, asked=absent_down_to_four(0.2))),
        (False, line("offsets", EMPTY, SLOPE, asked=EMPTY)),
        (True, line("two", explained(group("gyro_thermal_lag")), LAG, K2, added="gyro_thermal_lag",
                    second=explained(group("accel_quadratic", channels=("ay",))))),
        (False, line("two", explained(group("gyro_thermal_lag")), LAG, K2, added="gyro_thermal_lag", second=EMPTY)),
        (False, line("two", explained(group("gyro_thermal_lag")), LAG, K2, added="gyro_thermal_lag", second={})),
        (False, line("two", EMPTY, LAG, K2, added=None, second=None)),
        (True, line("two", explained() | proposed(None), LAG, K2, added="gyro_thermal_lag", second=EMPTY)),
        (True, line("two", explained() | proposed(["gx", "ay"]), LAG, K2, added="gyro_thermal_lag", second=EMPTY)),
        (False, line("two", explained() | proposed(["gx"]), LAG, K2, added="gyro_thermal_lag", second=EMPTY)),
    ],
)  # fmt: skip
def test_judgement(fine, one):
    assert (judging.judged(one) == "ok") == fine


def test_a_name_is_right_on_its_own_channels():
    """The first of a group may act on a table, and another member on a channel."""
    members = [{"effect": "encoder_harmonic", "channels": ["head"]}, {"effect": "gyro_thermal_lag", "channels": ["gx"]}]
    both = group("encoder_harmonic", "gyro_thermal_lag", channels=("head",)) | {"candidates": members}
    assert judging.judged(line("hidden", explained(both), LAG)) == "ok"
    assert judging.judged(line("hidden", explained(both), LAG | {"channels": ["gy"]})) != "ok"


def test_a_wrong_name_is_told_from_silence():
    wrong = judging.of_kind(
        [line("outside", explained(group("gyro_thermal_lag")), WAVE), line("outside", EMPTY, WAVE)], "outside"
    )
    assert wrong.ok == (0, 2)
    assert wrong.wrong_names == (1, 2)


def test_a_wrong_name_with_more_said_to_remain_is_not_confirmed():
    named = explained(group("gyro_bias_drift"))
    told = named | {"more_remains": True}
    tally = judging.of_kind([line("large", named, LAG), line("large", told, LAG), line("large", EMPTY, LAG)], "large")
    assert tally.ok == (0, 3)
    assert tally.wrong_single_names == (1, 3)


def test_planted_faults_of_the_diagnosis_are_seen():
    ranking = [{"p": 0.01, "p_global": 0.3, "delta_chi2": 6.6, "dof": 1}]
    quiet = EMPTY | {"ranking": ranking, "looks": 30.0}
    assert not judging.alarms(quiet)
    assert judging.alarms_at_one_look(quiet)
    assert not judging.alarms_if_understated(quiet, 1.0)
    assert judging.alarms_if_understated(quiet)  # 6.6 · 2.25 = 14.9: p = 1.2e-4, 30 looks
    lines = [line("null-ar1", quiet, white=shape("time_s"))]
    assert list(judging.faults(lines).values()) == [(1, 1), (1, 1), (1, 1)]


def test_adequate_beside_a_significant_finding_is_a_contradiction():
    significant, other = {"p_global": 0.04}, {"p_global": 0.06}
    assert judging.contradicted(EMPTY | {"ranking": [other, significant]})
    assert judging.contradicted(EMPTY | {"structure": [{"p": 0.01, "covariate": "time_s"}]})
    assert not judging.contradicted(EMPTY | {"ranking": [other]})
    assert not judging.contradicted(explained(group("gyro_thermal_lag")) | {"ranking": [significant]})


def test_additions_are_judged_beside_the_truth():
    good = {"taken": True, "predicted": 100.0, "found": 90.0, "noise": 1.03, "held_out": "helps",
            "coefficients": [{"value": 1.0, "sd": 0.1, "truth": 1.2}]}  # fmt: skip
    bad = {"taken": False, "predicted": 100.0, "found": 70.0, "noise": 1.13, "held_out": "not",
           "coefficients": [{"value": 1.0, "sd": 0.1, "truth": 1.4}]}  # fmt: skip
    found = judging.added([{"addition": one, "readings": 450} for one in (good, bad, None)])
    assert [(hits, of) for _, hits, of in found.values()] == [(1, 2)] * len(found)


def test_wilson_interval():
    low, high = judging.wilson(285, 300)
    assert (round(low, 4), round(high, 4)) == (0.9192, 0.9695)
    assert judging.wilson(0, 0) == (0.0, 1.0)
    assert all(a[1] < b[1] for a, b in pairwise([judging.wilson(n, 20) for n in range(21)]))


def test_report_and_what_broke():
    lines = [
        line("hidden", explained(group("gyro_thermal_lag")), LAG),
        line("outside", EMPTY, WAVE),
        {"kind": "hidden", "seed": 9, "error": "ValueError: no"},
    ]
    text = judging.report(lines)
    assert "1 of 1" in text
    assert "| hidden | 9 | | | ValueError: no |" in text
    assert "| outside | 1 | table | outside_temperature_wave gx (50; 50) | adequate |" in text


def test_lines_survive_an_interruption(tmp_path):
    path = tmp_path / "lines.jsonl"
    path.write_text('{"kind": "hidden", "seed": 1}\n{"kind": "hidden", "seed": 2, "error": "x"}\n{"kind": "hid')
    assert list(blind.done(path)) == [("hidden", 1, "")]


def test_every_procedure_is_judged_by_itself():
    right, wrong = explained(group("gyro_thermal_lag")), explained(group("gyro_bias_drift"))
    lines = [
        line("hidden", right, LAG),
        line("hidden", wrong, LAG, procedure="polar_tumble"),
        line("hidden", EMPTY, LAG, procedure="polar_tumble"),
        line("null-white", wrong, procedure="polar_tumble"),
        line("hidden", right, LAG, procedure="rate_table"),
        {"kind": "hidden", "seed": 9, "procedure": "rate_table", "error": "ValueError: no"},
    ]
    text = judging.by_procedure(lines)
    assert "| polar_tumble | 0 of 2 | 1 of 2 | 1 of 2 | 1 of 1 |" in text
    assert "| rate_table | 1 of 1 | 0 of 1 | 0 of 1 | 0 of 0 |" in text
    assert judging.of_kind(lines, "hidden").ok == (1, 1)
    assert sum("ValueError" in row for row in text) == 1
    assert "## Every procedure by itself" in judging.report([*lines, line("outside", EMPTY, WAVE)])


@pytest.mark.slow
def test_blind_study():
    lines = blind.study(blind.COUNTS, alone=blind.ALONE_COUNTS)
    blind.REPORT.parent.mkdir(parents=True, exist_ok=True)
    blind.REPORT.write_text(judging.report(lines))
    assert not [one for one in lines if "error" in one]
    assert not [one for one in lines if judging.contradicted(one["document"])]

    def share(found):
        return found[0] / found[1]

    assert share(judging.of_kind(lines, "hidden").ok) >= 0.95
    assert share(judging.of_kind(lines, "large").ok) >= 0.95
    assert share(judging.of_kind(lines, "large").wrong_single_names) <= 0.02
    assert 0.03 <= 1 - share(judging.of_kind(lines, *judging.NULLS).ok) <= 0.07
    for kind in judging.NULLS:
        fine, count = judging.of_kind(lines, kind).ok
        low, high = judging.wilson(count - fine, count)
        assert low <= 0.07, kind
        assert high >= 0.03, kind
    assert share(judging.of_kind(lines, "outside").ok) >= 0.90
    assert share(judging.of_kind(lines, "outside").wrong_names) <= 0.05
    assert share(judging.of_kind(lines, "offsets").ok) == 1
    assert share(judging.of_kind(lines, "two").ok) >= 0.90
    for name, (_, hits, count) in judging.added(lines).items():
        assert hits >= (0.99 if "coefficients" in name else 0.95) * count, name
    alone = [judging.of_kind(lines, "hidden", procedure=procedure) for procedure in blind.PROCEDURES]
    for procedure, hidden in zip(blind.PROCEDURES, alone, strict=True):
        assert hidden.ok[0] >= 0.95 * hidden.ok[1], procedure
        assert hidden.false_adequate[0] == 0, procedure
    assert sum(each.wrong_single_names[0] for each in alone) <= 0.02 * sum(each.ok[1] for each in alone)
    # What these numbers would be with a fault in the diagnosis must be outside the limits, or they check nothing.
    for name, (alarmed, count) in judging.faults(lines).items():
        assert count > 0, name
        assert alarmed / count > 0.07, name

"""The effect of a change on the residuals is shown before its fit is made, and agrees with that fit."""

import time

import numpy as np
import pytest
from explore_client import framed, settled

HIDDEN = "gyro_scale_asymmetry"
LINE = {"over": "rate_i", "points": [[-100, 1], [0, 0], [100, 1]]}
CHANGES = {
    "remove": {"remove": ["table_axis_tilt"]},
    "prior": {"prior_of": "gyro_bias.bias[gz]", "prior": "normal(0, 0.001 deg/h)"},
    "noise": {"remove": ["run_scatter"]},
    "noise_prior": {"prior_of": "run_scatter.tau[gz]", "prior": "lognormal(3 noise, 1.0)"},
    "aside": {"aside": [{"channels": ["gz"], "x": "rate_i", "x_low": 50.0, "x_high": 1e9}], "reason": "too fast"},
    "formula": {"formula_of": "gz"},
    "drawn": {"formula_of": "gz", "drawn": LINE},
    "add": {"add": [HIDDEN]},
}


@pytest.mark.parametrize("name", CHANGES)
def test_every_change_shows_its_residuals_at_once(client, explored, first, name):
    """And cancelled it leaves no file, that of its effect or of its model included."""
    before = sorted(each.name for each in explored.session.root.parent.iterdir())
    facts = client.json("model", {"model": first})
    began = time.monotonic()
    task = client.json("change", {"model": first, **CHANGES[name]})["task"]
    early = client.json("preview", {"model": first, "task": task})
    seconds = time.monotonic() - began
    head, points = framed(client, {"model": first, "channel": "gz", "x": "reading", "task": task})
    client.json("cancel", {"task": task})
    settled(explored)
    assert early["refitted"]
    assert head["refitted"]
    assert seconds < 5  # 0.15 s on an idle machine
    assert client.json("state")["tasks"][-1]["state"] == "cancelled"
    assert sorted(each.name for each in explored.session.root.parent.iterdir()) == before
    whole = next(cell for cell in facts["cells"] if (cell["run"], cell["channel"]) == ("rate-z-up", "gz"))
    assert (head["of"] < 120) == (name == "aside")
    assert np.max(np.abs(points["y"] - points["after"])) > 0.1
    assert early["delta_chi2"] * (-1 if name in ("remove", "prior", "noise") else 1) > 1
    # χ² per reading is over the readings that are left, as they are drawn.
    own = zip(early["cells"], facts["cells"], strict=True)
    assert sum(each["n"] for each, cell in own if cell["channel"] == "gz") == head["of"]
    assert whole["chi2"] > 100
    # Once it is over, nothing of it is shown.
    assert not client.json("preview", {"model": first, "task": task + 1})["refitted"]


@pytest.mark.slow  # a refit each; that of an addition is in test_explore_answers
@pytest.mark.parametrize("name", ["remove", "prior", "noise", "noise_prior", "aside", "formula"])
def test_the_fit_finds_the_residuals_that_were_shown(client, explored, first, name):
    task = client.json("change", {"model": first, **CHANGES[name]})["task"]
    wanted = {"channel": "gz", "x": "reading"}
    early = client.json("preview", {"model": first, "task": task})
    _, shown = framed(client, {"model": first, **wanted, "task": task})
    settled(explored)
    done = next(each for each in client.json("state")["tasks"] if each["number"] == task)
    assert done["state"] == "done", done["issues"]
    after = client.json("model", {"model": done["made"]})
    _, found = framed(client, {"model": done["made"], **wanted})
    np.testing.assert_allclose(shown["after"], found["y"], atol=0.02)  # standard deviations of the readings
    assert np.max(np.abs(shown["y"] - shown["after"])) > 0.1
    cells = {(each["run"], each["channel"]): each["chi2"] for each in after["cells"]}
    before = client.json("model", {"model": first})["cells"]
    told = {(one["run"], one["channel"]): each["chi2"] for one, each in zip(before, early["cells"], strict=True)}
    assert {key: told[key] for key in cells} == pytest.approx(cells, rel=0.01, abs=0.1)
    # The model that was made can be changed in its turn, an effect of its own file included.
    task = client.json("change", {"model": done["made"], **CHANGES["prior"]})["task"]
    assert client.json("preview", {"model": done["made"], "task": task})["refitted"]
    client.json("cancel", {"task": task})
    settled(explored)
    if name == "aside":  # taken back, they are where they were, by the model that has them
        task = client.json("change", {"model": done["made"], "take_back": [0, 1]})["task"]
        early = client.json("preview", {"model": done["made"], "task": task})
        _, shown = framed(client, {"model": done["made"], **wanted, "task": task})
        client.json("cancel", {"task": task})
        settled(explored)
        _, found = framed(client, {"model": first, **wanted})
        np.testing.assert_allclose(shown["after"], found["y"], atol=1e-4)
        counts = {(each["run"], each["channel"]): each["n"] for each in before}
        assert [each["n"] for each in early["cells"]] == [
            counts[each["run"], each["channel"]] for each in after["cells"]
        ]
        assert early["delta_chi2"] == pytest.approx(
            after["chi2"] - client.json("model", {"model": first})["chi2"], abs=1
        )
    client.json("select", {"model": first})


def test_a_drawn_shape_gets_the_formula_that_is_like_it(client, first):
    """The hidden effect is k·|rate|: drawn as two lines it is found, its size by the data alone."""
    found = client.json("formula", {"model": first, "channel": "gz", "drawn": LINE})
    again = client.json("formula", {"model": first, "channel": "gz"})
    assert found["table"]["rows"][0][:3] == again["table"]["rows"][0][:3]
    assert found["table"]["rows"][0][1] == "|Ω_i|"
    assert "runs are predicted better" in found["sentence"]
    upside_down = LINE | {"points": [[x, -50 * y] for x, y in LINE["points"]]}
    assert client.json("formula", {"model": first, "channel": "gz", "drawn": upside_down}) == found
    straight = LINE | {"points": [[-100, -1], [100, 1]]}
    line = client.json("formula", {"model": first, "channel": "gz", "drawn": straight})
    assert line["table"]["rows"][0][1] == "Ω_i"
    assert "0 of 7 runs" in line["sentence"] or "1 of 7 runs" in line["sentence"]  # the data do not show it


def test_a_shape_that_no_formula_is_like_is_a_free_form(client, first):
    points = [[-100, 1], [-50, 0], [-49, 3], [0, 0], [10, -4], [100, 1]]
    found = client.json("formula", {"model": first, "channel": "gz", "drawn": {"over": "rate_i", "points": points}})
    low = {"over": "rate_i", "points": [[x, 1e-5 * y] for x, y in points]}  # its size is of the data alone
    assert client.json("formula", {"model": first, "channel": "gz", "drawn": low}) == found
    assert "no formula is like it" in found["sentence"]
    assert "jnp.interp(sample.rate[0], " in found["source"]
    compile(found["source"], "found_shape.py", "exec")


@pytest.mark.parametrize(
    ("drawn", "what"),
    [
        (LINE | {"over": "reading"}, "no formula has reading in it"),
        (LINE | {"points": [[1, 1]]}, "the drawing has no shape"),
        (LINE | {"points": [[1, 1], [2, 1]]}, "the drawing has no shape"),
    ],
)
def test_what_is_no_drawing_is_refused(client, first, drawn, what):
    status, said = client.ask("formula", {"model": first, "channel": "gz", "drawn": drawn})
    assert status == 400
    assert what in said.decode()


def test_sensor_axes_are_those_of_the_summary(client, explored, first):
    """In body axes by the derived quantities; in a mounting turned as its table has it."""
    result = explored.session.require(first).result
    frames = {each["name"]: each for each in client.json("known", {"model": first})["frames"]}
    assert list(frames) == ["body", "x-up", "y-up", "z-up", "pyramid"]
    known = {each.name: each for each in result.summary.derived}
    for axis in frames["body"]["axes"]:
        told = [known[f"input_axis[{axis['channel']},{each}]"] for each in "xyz"]
        np.testing.assert_allclose(axis["fitted"], [each.mean for each in told], atol=2e-5)
        spread = np.sqrt(sum(each.sd**2 for each in told) / 2)
        assert axis["cone"] == pytest.approx(2.448 * np.degrees(spread) * 3600, rel=0.1)
        nominal = [each == axis["channel"][1] for each in "xyz"]
        away = np.degrees(np.linalg.norm([each.mean - own for each, own in zip(told, nominal, strict=True)]))
        assert axis["tilt"] == pytest.approx(3600 * away, rel=0.02)
    # What the runs determine is the angle to the axis of rotation.
    for channel, mounting in (("gz", "z-up"), ("gx", "x-up")):
        [axis] = [each for each in frames[mounting]["axes"] if each["channel"] == channel]
        angle = known[f"mounting_angle[{channel},{mounting}]"].mean
        assert np.degrees(np.arccos(axis["fitted"][2])) == pytest.approx(angle, abs=2e-3)

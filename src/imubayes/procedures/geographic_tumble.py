"""Geographic tumble: static positions with a gyro's axes along East, West, North, South, Up or Down (P5).

The textbook takes the output at rest over the torquer scale factor, less the Earth rate along the input axis, as drift

    d = D_F + D_I f_I + D_O f_O + D_S f_S + D_II f_I² + D_OO f_O² + D_SS f_S²,

where one of f_I, f_O, f_S is ±1 g and the others 0: cross terms vanish.  With axis J up and down
D_J = (d₊ − d₋)/2 and D_F + D_JJ = (d₊ + d₋)/2 (IEEE Std 517): D_F is determined only together with a square term.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Run
from imubayes.foundations.earth import earth_rate
from imubayes.procedures import textbook
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, Reduction
from imubayes.procedures.fitted_terms import StandardCombination, of_drift
from imubayes.procedures.kinematics import Stimulus, table_stimulus
from imubayes.procedures.textbook import DEGREE_PER_HOUR, Evaluation, TextbookResult, Undetermined

METHOD = "IEEE Std 517 tumble in geographic positions"
_UP = 0.99
_AXES = "ios"


def geographic_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the g-sensitive drift coefficients of every gyro, and its fixed drift plus each g² coefficient."""
    found: list[TextbookResult] = []
    for place, channel in enumerate(campaign.channels):
        if channel.kind != "gyro":
            continue
        force, drift = _drift(campaign, runs, place, channel)
        if len(drift):
            found += _of_channel(Evaluation(channel.name, textbook.names_of(runs), METHOD), force, drift)
    return found


def _drift(campaign: Campaign, runs: Sequence[Run], place: int, channel: Channel) -> tuple[np.ndarray, np.ndarray]:
    """Return gravity along I, O and S in g, (n, 3), and the drift in deg/h, (n,), at every position."""
    forces, drifts = [], []
    for run in runs:
        assert run.attitude is not None
        output = run.observed[:, place]
        finite = np.isfinite(output)
        axes = np.einsum("rij,kj->rki", run.attitude[finite], channel.axes)
        earth = axes[:, 0] @ earth_rate(campaign.site.latitude)
        forces.append(axes[:, :, 2])
        drifts.append(((output[finite] - channel.offset) / channel.scale_si - earth) / DEGREE_PER_HOUR)
    return np.concatenate(forces), np.concatenate(drifts)


def _of_channel(tested: Evaluation, force: np.ndarray, drift: np.ndarray) -> list[TextbookResult]:
    found: list[TextbookResult] = []
    # One column per axis and sign: the residual variance is pooled over all positions.
    columns = [(axis, sign) for axis in range(3) for sign in (1, -1) if np.any(sign * force[:, axis] > _UP)]
    design = np.stack([(sign * force[:, axis] > _UP).astype(float) for axis, sign in columns], axis=1)
    value, covariance, _ = textbook.least_squares(design, drift)
    for axis, letter in enumerate(_AXES):
        pair = [columns.index((axis, sign)) for sign in (1, -1) if (axis, sign) in columns]
        if len(pair) < 2:
            missing = f"{tested.of}: D_{letter.upper()} needs positions with its {letter.upper()} axis up and down"
            found.append(Undetermined(tested.run, missing))
            continue
        half = np.sqrt(covariance[pair[0], pair[0]] + covariance[pair[1], pair[1]]) / 2
        up, down = value[pair]
        found.append(tested.estimate(f"gyro_g_sensitivity.d_{letter}", (up - down) / 2, half, "deg/h/g"))
        found.append(tested.estimate(f"D_F+D_{letter.upper() * 2}", (up + down) / 2, half, "deg/h"))
    left = (
        "D_IO, D_OS and D_SI are not determined (only one axis sees gravity at a time); D_F is not separated from "
        "D_II, D_OO, D_SS"
    )
    return [*found, Undetermined(tested.run, f"{tested.of}: {left}")]


def combinations(campaign: Campaign, _runs: Sequence[Run]) -> list[StandardCombination]:
    """Return D_F + D_JJ of every gyro and axis J."""
    squares = [f"D_{letter.upper() * 2}" for letter in _AXES]
    found: list[StandardCombination] = [
        of_drift(f"D_F+{square}", channel.name, "deg/h", {"D_F": 1.0, square: 1.0})
        for channel in campaign.of_kind("gyro")
        for square in squares
    ]
    return found


def _stimulus(run: Run, campaign: Campaign) -> Stimulus:
    assert run.attitude is not None
    still = table_stimulus(run, campaign)
    return replace(still, base=run.attitude[still.row], table_angle=np.zeros_like(still.table_angle))


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    """Return static positions named by the directions of the input and the output axis."""
    named = steps.directions or []
    columns = {name: np.array([pair[place : place + 1] for pair in named]) for place, name in enumerate(_COLUMNS)}
    return PlannedRows(np.full(len(named), steps.duration), columns)


_COLUMNS = ("i_axis", "o_axis")

GEOGRAPHIC_TUMBLE = Procedure(
    name="geographic_tumble",
    reference="IEEE Std 517, tumble test in geographic positions",
    columns=(("i_axis",), ("o_axis",)),
    reduction=Reduction.AT_REST,
    by_direction=True,
    abscissae=("row",),
    kinematics=_stimulus,
    plan=PlanRules(("directions",), (), 60.0, _planned_rows),
    evaluate=geographic_test,
    purposes=("gyro_g_sensitivity", "gyro_g2_sensitivity"),
    combinations=combinations,
)

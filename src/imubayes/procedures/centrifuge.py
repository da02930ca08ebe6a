"""Precision centrifuge: constant rates of the arm, with the unit fixed to it or on a counter-rotating platform.

The arm is the outer axis; the unit sits at its radius R along x of the arm's frame, on a platform whose axis is the
inner one. Specific force is −Ω²R along x and gravity. A fixed platform has `table_rate_deg_s` 0; one that turns against
the arm holds the unit's attitude to the Earth, and `table_angle_deg` is its angle when the arm is at 0.

The textbook fits a polynomial over the levels of all rows of a temperature: for an accelerometer

    E = K1·(K0 + a_i + K2 a_i² + K3 a_i³ + K_oq a_i|a_i| + δ_o a_p − δ_p a_o + cross terms)

(IEEE Std 836 and 1293), for a gyro the drift terms D_F … D_SI (IEEE Std 517), as far as the rows separate them.
Counter-rotated, squares average to A²/2 and products to 0, A = Ω²R.  Radius, tilts and seats are taken as exact: K1 has
the relative error of the radius, and its stretch under load looks like K_oq.
"""

from collections.abc import Sequence

import numpy as np

from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.foundations.errors import input_error
from imubayes.procedures.base import PlannedRows, PlannedSteps, PlanRules, Procedure, whole_turns
from imubayes.procedures.fitted_terms import LinearCombination, StandardCombination, of_drift, term_estimates
from imubayes.procedures.kinematics import Stimulus, serial_input, serial_stimulus
from imubayes.procedures.textbook import TextbookResult, Undetermined, by_temperature, names_of

METHOD = "IEEE Std 836 centrifuge test"
_ACROSS, _ROUNDING = 0.05, 1e-9


def centrifuge_test(campaign: Campaign, runs: Sequence[Run]) -> list[TextbookResult]:
    """Return the coefficients of every channel that the levels and attitudes of a temperature separate."""
    found: list[TextbookResult] = []
    for group in by_temperature(runs):
        for place, channel in enumerate(campaign.channels):
            estimates = term_estimates(campaign, group, place, still_only=False, method=METHOD)
            found += estimates
            if estimates and channel.kind == "accelerometer":
                said = (
                    f"{channel.name}: K1 is not separated from the radius of the arm, K_oq is not separated from its "
                    "stretch"
                )
                found.append(Undetermined(names_of(group), said))
    return found


def combinations(campaign: Campaign, runs: Sequence[Run]) -> list[StandardCombination]:
    """Return what the runs of each seat determine together.

    Of an accelerometer whose input axis lies in the plane of the arm it is the relative error of k·RΩ², with gravity in
    the cross terms; of a gyro the fixed drift with that along gravity.
    """
    found: dict[str, StandardCombination] = {}
    for run in runs:
        for channel in campaign.channels if run.table is not None and run.mounting is not None else ():
            up = _up(campaign, run, channel)
            if channel.kind == "accelerometer" and abs(up[0]) < _ACROSS:
                one = _scale_of_arm(campaign, run, channel, up)
                found.setdefault(one.name, one)
            elif channel.kind == "gyro" and np.abs(up).max() > 1 - _ACROSS:
                axis = int(np.argmax(np.abs(up)))
                weight = float(np.sign(up[axis]))
                symbol = f"D_F{'+' if weight > 0 else '-'}D_{'IOS'[axis]}"
                terms = {"D_F": 1.0, f"D_{'IOS'[axis]}": weight}
                one = of_drift(symbol, channel.name, "deg/h", terms)
                found.setdefault(one.name, one)
    return list(found.values())


def _up(campaign: Campaign, run: Run, channel: Channel) -> np.ndarray:
    """Return the vertical along a channel's I, O and S axes at zero angles, shape (3,)."""
    assert run.table is not None
    assert run.mounting is not None
    in_body = campaign.tables[run.table].to_local @ campaign.mountings[run.mounting].body_to_table
    return channel.axes @ in_body[2]


def _scale_of_arm(campaign: Campaign, run: Run, channel: Channel, up: np.ndarray) -> LinearCombination:
    place, arm = f"[{channel.name}]", campaign.tables[str(run.table)].arm
    weights = {
        f"accel_scale_factor.scale{place}": 1.0,
        f"arm_error.radius[{run.table}]": 1 / arm if arm else 0.0,
        f"table_rate_error.rate_error[{run.table}]": 2.0,
        f"accel_cross_coupling.k_io{place}": float(up[1]),
        f"accel_cross_coupling.k_ip{place}": float(up[2]),
    }
    weights = {name: weight for name, weight in weights.items() if abs(weight) > _ROUNDING}
    return LinearCombination(f"k·RΩ²[{channel.name},{run.mounting}]", "ppm", weights, total=True)


def _require_arm(table: Table) -> None:
    if table.arm <= 0:
        raise input_error(
            f"the centrifuge '{table.name}' has no arm",
            f"campaign.toml, table '{table.name}', key 'arm_radius_m'",
            "the distance from the axis of the arm to that of the platform, above 0",
            "state arm_radius_m, or correct 'procedure' of the run",
        )


def _stimulus(run: Run, campaign: Campaign) -> Stimulus:
    assert run.table is not None
    _require_arm(campaign.tables[run.table])
    return serial_stimulus(run, campaign)


def _input(run: Run, channel: Channel, site: Site, table: Table | None, mounting: Mounting | None) -> np.ndarray | None:
    if table is not None:
        _require_arm(table)
    return serial_input(run, channel, site, table, mounting)


def _planned_rows(steps: PlannedSteps) -> PlannedRows:
    """Return every rate of the arm at every angle of the platform."""
    angle, rate = (part.reshape(-1) for part in np.meshgrid(steps.angles_deg or [0.0], steps.rates_deg_s or []))
    order = np.argsort(angle, kind="stable")
    angle, rate = angle[order], rate[order]
    columns = {
        "outer_rate_deg_s": rate,
        "outer_angle_deg": np.where(rate == 0, 0.0, np.nan),
        "table_rate_deg_s": -rate if steps.counter_rotation else np.zeros_like(rate),
        "table_angle_deg": angle,
    }
    return PlannedRows(np.array([whole_turns(float(each), steps.duration) for each in rate]), columns)


CENTRIFUGE = Procedure(
    name="centrifuge",
    reference="IEEE Std 836, precision centrifuge testing of linear accelerometers",
    columns=(("outer_rate_deg_s",), ("table_angle_deg",), ("samples",)),
    needs_table=True,
    abscissae=("outer_rate", "table_angle", "time"),
    kinematics=_stimulus,
    nominal_input=_input,
    plan=PlanRules(("rates_deg_s",), ("angles_deg", "counter_rotation"), 60.0, _planned_rows),
    evaluate=centrifuge_test,
    purposes=(
        "accel_quadratic",
        "accel_cubic",
        "accel_odd_quadratic",
        "accel_cross_coupling",
        "accel_cross_axis_quadratic",
        "lever_arm",
        "gyro_g_sensitivity",
        "gyro_g2_sensitivity",
    ),
    combinations=combinations,
)

"""Regenerate every shipped synthetic campaign: python data/generators/make_all.py [FOLDER]."""

import sys
from pathlib import Path

import accel_channel
import centrifuge
import desk_imu
import full_qualification
import geographic_tumble
import hidden_effects
import multi_axis_table
import polar_tumble
import redundant_imu
import reference_gyro
import rotation_modulation
import servo_table
import static_record
import trihedral_imu

CAMPAIGNS = {
    "trihedral-imu": trihedral_imu,
    "desk-imu": desk_imu,
    "accel-channel": accel_channel,
    "redundant-imu": redundant_imu,
    "polar-tumble": polar_tumble,
    "geographic-tumble": geographic_tumble,
    "servo-table": servo_table,
    "rotation-modulation": rotation_modulation,
    "reference-gyro": reference_gyro,
    "multi-axis-table": multi_axis_table,
    "centrifuge": centrifuge,
    "static-record": static_record,
    "full-qualification": full_qualification,
}


def main(folder: Path) -> None:
    for name, script in CAMPAIGNS.items():
        values = script.generate(folder / name, script.SEED)
        print(f"{name}: {len(values)} true values")
    for name in hidden_effects.CAMPAIGNS:
        print(f"{name}: {len(hidden_effects.generate(folder / name))} true values")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else Path(__file__).resolve().parents[1])

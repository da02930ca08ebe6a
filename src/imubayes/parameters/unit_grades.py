"""Grades of inertial units, to which default priors belong.

The default prior of a parameter is that of a tactical or navigation-grade unit.  Where coarser units are met with
larger errors, the parameter declares the widths for these: `coarse`, for an industrial and for a consumer unit.  Widths
are the largest values of data sheets: consumer, MPU-6050, MPU-9250, BMI160, ICM-20948, LSM6DS3 (zero-rate output
5 to 20 deg/s, sensitivity 3 %, cross-axis 2 %, zero-g 60 to 80 mg); industrial, ADIS16448, ADIS16465, MTi-30, HG4930
(0.2 to 1 deg/s, 0.2 to 1 %, 0.05 to 0.2 deg, 10 to 20 mg).  Where data sheets are silent (g², dT/dt, hysteresis) the
width follows from the bias or the scale factor in the ratio that it has for better units.
"""

from typing import Literal, get_args

Grade = Literal["consumer", "industrial", "tactical", "navigation"]
GRADES: tuple[Grade, ...] = get_args(Grade)


def graded_prior(prior: str, unit: str, coarse: tuple[float, float] | None, grade: Grade) -> str:
    """Return the default prior of a parameter for a grade of unit, as written in a model file.

    Parameters
    ----------
    prior : for tactical and navigation grade.
    unit : of the widths.
    coarse : width (of a lognormal prior the median) for industrial and consumer grade; None where it is the same.
    """
    if coarse is None or grade not in ("industrial", "consumer"):
        return prior
    width = f"{coarse[0 if grade == 'industrial' else 1]:g} {unit}"
    family, arguments = prior.rstrip(")").split("(", 1)
    if family == "normal":
        return f"normal(0, {width})"
    return ", ".join([f"{family}({width}", *arguments.split(",")[1:]]).replace(",  ", ", ") + ")"

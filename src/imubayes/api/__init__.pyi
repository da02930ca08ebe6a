from .calibrated_unit import (
    CalibratedInputs,
    CorrectedRecording,
    ReportSection,
    apply,
    correct,
    export_constants,
    onboard_constants,
    report,
)
from .fitting import Result, Settings, fit, load, read_result
from .loop import ModelChange, add, diagnose, export, history, plant, remove

__all__ = [
    "CalibratedInputs",
    "CorrectedRecording",
    "ModelChange",
    "ReportSection",
    "Result",
    "Settings",
    "add",
    "apply",
    "correct",
    "diagnose",
    "export",
    "export_constants",
    "fit",
    "history",
    "load",
    "onboard_constants",
    "plant",
    "read_result",
    "remove",
    "report",
]

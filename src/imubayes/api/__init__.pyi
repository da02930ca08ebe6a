from .calibrated_unit import (
    CalibratedInputs,
    CorrectedRecording,
    apply,
    correct,
    export_constants,
    onboard_constants,
    report,
)
from .diagnosis import diagnose
from .fitting import Result, Settings, fit, load, read_result
from .injection import plant
from .model_changes import ModelChange, add, export, history, remove

__all__ = [
    "CalibratedInputs",
    "CorrectedRecording",
    "ModelChange",
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

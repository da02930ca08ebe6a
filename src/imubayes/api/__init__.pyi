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
from .extension import Addition, add, export, history
from .fitting import Result, Settings, fit, load, read_result
from .injection import plant

__all__ = [
    "Addition",
    "CalibratedInputs",
    "CorrectedRecording",
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
    "report",
]

from .comparisons import Repeatability, RunPrediction, predict, repeatability
from .fitting import Result, Settings, fit, load, read_result
from .loop import ModelChange, add, diagnose, export, history, plant, refit, remove

__all__ = [
    "ModelChange",
    "Repeatability",
    "Result",
    "RunPrediction",
    "Settings",
    "add",
    "diagnose",
    "export",
    "fit",
    "history",
    "load",
    "plant",
    "predict",
    "read_result",
    "refit",
    "remove",
    "repeatability",
]

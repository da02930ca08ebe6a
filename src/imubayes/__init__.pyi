from .api import (
    CalibratedInputs,
    ModelChange,
    Result,
    add,
    apply,
    diagnose,
    export,
    fit,
    history,
    load,
    plant,
    read_result,
    remove,
    report,
)
from .array_shapes import Scalar, vector3
from .campaign import check_campaign, load_campaign
from .campaign_data import Campaign
from .criticism.diagnosis_record import Diagnosis
from .display.model_against_measurement import compare
from .effects.base import Effect, MotionEffect, Order, PlaceEffect, RecordEffect, SignalEffect, Stage
from .effects.memory import Decay, Play
from .errors import InputError
from .inference.ensemble_sampling import Settings
from .inference.sample_user_density import Samples, sample
from .model.bind import Model, bind
from .model.model_file import load_model
from .noise.base import Entry, EntryNoise, Noise, SeriesNoise, SharedNoise, TailNoise
from .parameters.parameter_declarations import option, parameter, reference_temperature, time_constant
from .results.carried_effects import trust
from .rotations import compose, cross, exponential, rotate
from .signal_path_state import Ambient, Experience, Motion, Sample
from .units import dimension, to_si

__version__: str

__all__ = [
    "Ambient",
    "CalibratedInputs",
    "Campaign",
    "Decay",
    "Diagnosis",
    "Effect",
    "Entry",
    "EntryNoise",
    "Experience",
    "InputError",
    "Model",
    "ModelChange",
    "Motion",
    "MotionEffect",
    "Noise",
    "Order",
    "PlaceEffect",
    "Play",
    "RecordEffect",
    "Result",
    "Sample",
    "Samples",
    "Scalar",
    "SeriesNoise",
    "Settings",
    "SharedNoise",
    "SignalEffect",
    "Stage",
    "TailNoise",
    "add",
    "apply",
    "bind",
    "check_campaign",
    "compare",
    "compose",
    "cross",
    "diagnose",
    "dimension",
    "exponential",
    "export",
    "fit",
    "history",
    "load",
    "load_campaign",
    "load_model",
    "option",
    "parameter",
    "plant",
    "read_result",
    "reference_temperature",
    "remove",
    "report",
    "rotate",
    "sample",
    "time_constant",
    "to_si",
    "trust",
    "vector3",
]

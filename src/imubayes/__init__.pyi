from .api import Addition, Result, add, diagnose, export, fit, history, plant, read_result
from .campaign import check_campaign, load_campaign
from .criticism.diagnosis import Diagnosis
from .display.comparison import compare
from .effects.base import Effect, MotionEffect, Order, PlaceEffect, RecordEffect, SignalEffect, Stage
from .effects.memory import Decay, Play
from .errors import InputError
from .frames import compose, cross, exponential, rotate
from .inference.density_sampling import Samples, sample
from .inference.ensemble_sampling import Settings
from .model.model_file import load_model
from .noise.base import Entry, EntryNoise, Noise, SeriesNoise, SharedNoise, TailNoise
from .parameters.parameter import option, parameter, reference_temperature, time_constant
from .run import Campaign
from .stimulus import Ambient, Experience, Motion, Sample
from .types import Scalar, vector3
from .units import dimension, to_si

__version__: str

__all__ = [
    "Addition",
    "Ambient",
    "Campaign",
    "Decay",
    "Diagnosis",
    "Effect",
    "Entry",
    "EntryNoise",
    "Experience",
    "InputError",
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
    "load_campaign",
    "load_model",
    "option",
    "parameter",
    "plant",
    "read_result",
    "reference_temperature",
    "rotate",
    "sample",
    "time_constant",
    "to_si",
    "vector3",
]

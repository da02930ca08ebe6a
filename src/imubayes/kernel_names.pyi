from .api import (
    ModelChange,
    Repeatability,
    Result,
    RunPrediction,
    add,
    diagnose,
    export,
    fit,
    history,
    load,
    plant,
    predict,
    read_result,
    refit,
    remove,
    repeatability,
)
from .campaign import build_campaign, check_campaign, load_campaign
from .campaign.stream_checks import Finding
from .criticism.diagnosis_record import Diagnosis
from .display.compare_report import compare
from .effects.base import (
    Decay,
    Effect,
    MotionEffect,
    Order,
    PlaceEffect,
    Play,
    RecordEffect,
    SignalEffect,
    Stage,
)
from .foundations.arrays import Scalar, compose, cross, exponential, rotate, vector3
from .foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from .foundations.errors import InputError, NotKept
from .foundations.signal_path_state import Ambient, Experience, Motion, Sample
from .foundations.units import dimension, to_si
from .inference.chains import Settings
from .inference.fitted_model import Fit
from .inference.user_density import Samples, sample
from .model.bind import Model, bind
from .model.bound_effects import Observability, observability
from .model.effect_registry import Registry
from .model.model_file import EffectSpec, ModelSpec, build_model, load_model
from .noise.components import Entry, EntryNoise, Noise, SeriesNoise, SharedNoise, TailNoise
from .parameters.declarations import option, parameter, reference_temperature, time_constant
from .results.folder_files import trust

__version__: str

__all__ = [
    "Ambient",
    "Campaign",
    "Channel",
    "Decay",
    "Diagnosis",
    "Effect",
    "EffectSpec",
    "Entry",
    "EntryNoise",
    "Experience",
    "Finding",
    "Fit",
    "InputError",
    "Model",
    "ModelChange",
    "ModelSpec",
    "Motion",
    "MotionEffect",
    "Mounting",
    "Noise",
    "NotKept",
    "Observability",
    "Order",
    "PlaceEffect",
    "Play",
    "RecordEffect",
    "Registry",
    "Repeatability",
    "Result",
    "Run",
    "RunPrediction",
    "Sample",
    "Samples",
    "Scalar",
    "SeriesNoise",
    "Settings",
    "SharedNoise",
    "SignalEffect",
    "Site",
    "Stage",
    "Table",
    "TailNoise",
    "add",
    "bind",
    "build_campaign",
    "build_model",
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
    "observability",
    "option",
    "parameter",
    "plant",
    "predict",
    "read_result",
    "reference_temperature",
    "refit",
    "remove",
    "repeatability",
    "rotate",
    "sample",
    "time_constant",
    "to_si",
    "trust",
    "vector3",
]

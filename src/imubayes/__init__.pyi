from .api import (
    CalibratedInputs,
    ConformityStatement,
    GumBudget,
    InputQuantity,
    ModelChange,
    Propagated,
    ReportSection,
    Result,
    add,
    apply,
    budget,
    conformity,
    diagnose,
    export,
    fit,
    history,
    load,
    plant,
    propagate,
    read_result,
    refit,
    remove,
    report,
)
from .campaign import check_campaign, load_campaign
from .criticism.diagnosis_record import Diagnosis
from .display.model_against_measurement import compare
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
from .explorer.start import explore
from .foundations.arrays import Scalar, compose, cross, exponential, rotate, vector3
from .foundations.campaign_data import Campaign
from .foundations.errors import InputError, NotKept
from .foundations.signal_path_state import Ambient, Experience, Motion, Sample
from .foundations.units import dimension, to_si
from .inference.ensemble_sampling import Settings
from .inference.user_density import Samples, sample
from .model.bind import Model, bind
from .model.model_file import load_model
from .noise.components import Entry, EntryNoise, Noise, SeriesNoise, SharedNoise, TailNoise
from .parameters.declarations import option, parameter, reference_temperature, time_constant
from .results.folder_files import trust

__version__: str

__all__ = [
    "Ambient",
    "CalibratedInputs",
    "Campaign",
    "ConformityStatement",
    "Decay",
    "Diagnosis",
    "Effect",
    "Entry",
    "EntryNoise",
    "Experience",
    "GumBudget",
    "InputError",
    "InputQuantity",
    "Model",
    "ModelChange",
    "Motion",
    "MotionEffect",
    "Noise",
    "NotKept",
    "Order",
    "PlaceEffect",
    "Play",
    "Propagated",
    "RecordEffect",
    "ReportSection",
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
    "budget",
    "check_campaign",
    "compare",
    "compose",
    "conformity",
    "cross",
    "diagnose",
    "dimension",
    "explore",
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
    "propagate",
    "read_result",
    "reference_temperature",
    "refit",
    "remove",
    "report",
    "rotate",
    "sample",
    "time_constant",
    "to_si",
    "trust",
    "vector3",
]

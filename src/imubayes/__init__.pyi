"""For type checkers: the names of the kernel, and those that the packages beside it add."""

from imubayes_archive import (
    ArchiveFit as ArchiveFit,
)
from imubayes_archive import (
    fit_archive as fit_archive,
)
from imubayes_archive import (
    load_archive_fit as load_archive_fit,
)
from imubayes_explorer import (
    explore as explore,
)
from imubayes_qualification import (
    CalibratedInputs as CalibratedInputs,
)
from imubayes_qualification import (
    ConformityStatement as ConformityStatement,
)
from imubayes_qualification import (
    CorrectedRecording as CorrectedRecording,
)
from imubayes_qualification import (
    GumBudget as GumBudget,
)
from imubayes_qualification import (
    InputQuantity as InputQuantity,
)
from imubayes_qualification import (
    KnownAnswer as KnownAnswer,
)
from imubayes_qualification import (
    NavigationImpact as NavigationImpact,
)
from imubayes_qualification import (
    Propagated as Propagated,
)
from imubayes_qualification import (
    ReportSection as ReportSection,
)
from imubayes_qualification import (
    apply as apply,
)
from imubayes_qualification import (
    budget as budget,
)
from imubayes_qualification import (
    conformity as conformity,
)
from imubayes_qualification import (
    correct as correct,
)
from imubayes_qualification import (
    export_constants as export_constants,
)
from imubayes_qualification import (
    navigation_impact as navigation_impact,
)
from imubayes_qualification import (
    onboard_constants as onboard_constants,
)
from imubayes_qualification import (
    propagate as propagate,
)
from imubayes_qualification import (
    report as report,
)
from imubayes_qualification import (
    selftest as selftest,
)
from imubayes_recordings import (
    Captured as Captured,
)
from imubayes_recordings import (
    NewCampaign as NewCampaign,
)
from imubayes_recordings import (
    capture as capture,
)
from imubayes_recordings import (
    new as new,
)

from .kernel_names import (
    Ambient as Ambient,
)
from .kernel_names import (
    Campaign as Campaign,
)
from .kernel_names import (
    Channel as Channel,
)
from .kernel_names import (
    Decay as Decay,
)
from .kernel_names import (
    Diagnosis as Diagnosis,
)
from .kernel_names import (
    Effect as Effect,
)
from .kernel_names import (
    EffectSpec as EffectSpec,
)
from .kernel_names import (
    Entry as Entry,
)
from .kernel_names import (
    EntryNoise as EntryNoise,
)
from .kernel_names import (
    Experience as Experience,
)
from .kernel_names import (
    Finding as Finding,
)
from .kernel_names import (
    InputError as InputError,
)
from .kernel_names import (
    Model as Model,
)
from .kernel_names import (
    ModelChange as ModelChange,
)
from .kernel_names import (
    ModelSpec as ModelSpec,
)
from .kernel_names import (
    Motion as Motion,
)
from .kernel_names import (
    MotionEffect as MotionEffect,
)
from .kernel_names import (
    Mounting as Mounting,
)
from .kernel_names import (
    Noise as Noise,
)
from .kernel_names import (
    NotKept as NotKept,
)
from .kernel_names import (
    Order as Order,
)
from .kernel_names import (
    PlaceEffect as PlaceEffect,
)
from .kernel_names import (
    Play as Play,
)
from .kernel_names import (
    RecordEffect as RecordEffect,
)
from .kernel_names import (
    Repeatability as Repeatability,
)
from .kernel_names import (
    Result as Result,
)
from .kernel_names import (
    Run as Run,
)
from .kernel_names import (
    RunPrediction as RunPrediction,
)
from .kernel_names import (
    Sample as Sample,
)
from .kernel_names import (
    Samples as Samples,
)
from .kernel_names import (
    Scalar as Scalar,
)
from .kernel_names import (
    SeriesNoise as SeriesNoise,
)
from .kernel_names import (
    Settings as Settings,
)
from .kernel_names import (
    SharedNoise as SharedNoise,
)
from .kernel_names import (
    SignalEffect as SignalEffect,
)
from .kernel_names import (
    Site as Site,
)
from .kernel_names import (
    Stage as Stage,
)
from .kernel_names import (
    Table as Table,
)
from .kernel_names import (
    TailNoise as TailNoise,
)
from .kernel_names import (
    add as add,
)
from .kernel_names import (
    bind as bind,
)
from .kernel_names import (
    build_campaign as build_campaign,
)
from .kernel_names import (
    build_model as build_model,
)
from .kernel_names import (
    check_campaign as check_campaign,
)
from .kernel_names import (
    compare as compare,
)
from .kernel_names import (
    compose as compose,
)
from .kernel_names import (
    cross as cross,
)
from .kernel_names import (
    diagnose as diagnose,
)
from .kernel_names import (
    dimension as dimension,
)
from .kernel_names import (
    exponential as exponential,
)
from .kernel_names import (
    export as export,
)
from .kernel_names import (
    fit as fit,
)
from .kernel_names import (
    history as history,
)
from .kernel_names import (
    load as load,
)
from .kernel_names import (
    load_campaign as load_campaign,
)
from .kernel_names import (
    load_model as load_model,
)
from .kernel_names import (
    option as option,
)
from .kernel_names import (
    parameter as parameter,
)
from .kernel_names import (
    plant as plant,
)
from .kernel_names import (
    predict as predict,
)
from .kernel_names import (
    read_result as read_result,
)
from .kernel_names import (
    reference_temperature as reference_temperature,
)
from .kernel_names import (
    refit as refit,
)
from .kernel_names import (
    remove as remove,
)
from .kernel_names import (
    repeatability as repeatability,
)
from .kernel_names import (
    rotate as rotate,
)
from .kernel_names import (
    sample as sample,
)
from .kernel_names import (
    time_constant as time_constant,
)
from .kernel_names import (
    to_si as to_si,
)
from .kernel_names import (
    trust as trust,
)
from .kernel_names import (
    vector3 as vector3,
)

__version__: str
__all__: list[str]

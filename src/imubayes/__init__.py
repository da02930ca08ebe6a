"""Bayesian calibration and uncertainty for inertial sensors.

    import imubayes
    result = imubayes.fit("data/trihedral-imu", "models/trihedral-imu.toml")

All runs of a campaign (rate table, dividing head, thermal ramps, free tumble) are fitted jointly with differentiable
forward models; scale factors, misalignment angles, biases and the true mounting angles come with posterior
uncertainty and a statement of what the data did and did not determine.

Public names, in four groups; everything else is private.

- Data: `new`, `NewCampaign`, `capture`, `Captured`, `load_campaign`, `build_campaign`, `check_campaign`, `Finding`,
  `Campaign` with its `Site`, `Channel`, `Table`, `Mounting` and `Run`, `to_si`, `dimension`, `InputError`, `NotKept`.
- Fit: `fit`, `Fit`, `load_model`, `build_model`, `ModelSpec`, `EffectSpec`, `bind`, `Model`, `Registry`, `Settings`,
  `sample`, `Samples`; `observability`, `Observability` for the effects that a campaign can show;
  an effect of one's own is a class on `Effect`, `SignalEffect`, `RecordEffect`, `PlaceEffect` or `MotionEffect`, noise
  one on `Noise`, `EntryNoise`, `SharedNoise`, `SeriesNoise` or `TailNoise`, written with `parameter`, `option`,
  `time_constant`, `reference_temperature`, `Stage`, `Order`, `Decay`, `Play`, `Sample`, `Motion`, `Ambient`,
  `Experience`, `Entry`, `Scalar`, `vector3`, `compose`, `cross`, `exponential`, `rotate`; `trust` lets effect files run
  that came along.
- Loop: `compare`, `diagnose`, `Diagnosis`, `add`, `refit`, `remove`, `ModelChange`, `history`, `export`, `plant`,
  `explore`; `predict`, `RunPrediction` for runs that were not fitted; `repeatability`, `Repeatability` for two
  calibrations.
- Results: `load`, `read_result`, `Result`, `report`, `ReportSection`, `apply`, `CalibratedInputs`, `correct`,
  `CorrectedRecording`, `onboard_constants`, `export_constants`, `navigation_impact`, `NavigationImpact`; an archive of
  units: `batch`, `load_batch`, `BatchResult`; an equation of one's own: `propagate`, `Propagated`,
  `InputQuantity`, `budget`, `GumBudget`, `conformity`, `ConformityStatement`; `selftest`, `KnownAnswer` for the known
  answers that an installation reproduces.
"""

from pathlib import Path
from typing import Any

import lazy_loader

from imubayes.foundations.extensions import extensions

__version__ = "0.2.0"

# The names of the kernel are listed in `kernel_names.pyi`, those of the packages beside it in their metadata.  All are
# loaded when they are first used: JAX takes seconds to import, and `imubayes --help` needs none of it.
_kernel_name, _, _KERNEL_NAMES = lazy_loader.attach_stub(__name__, str(Path(__file__).with_name("kernel_names.py")))


def __getattr__(name: str) -> Any:
    if name in _KERNEL_NAMES or name.startswith("_"):
        return sorted({*_KERNEL_NAMES, *extensions("functions")}) if name == "__all__" else _kernel_name(name)
    added = extensions("functions").get(name)
    return _kernel_name(name) if added is None else added.load()


def __dir__() -> list[str]:
    return __getattr__("__all__")

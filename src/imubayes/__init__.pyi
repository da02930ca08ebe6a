"""For type checkers: the names of the kernel, and those that the packages beside it add."""

from imubayes_archive import (
    BatchResult as BatchResult,
)
from imubayes_archive import (
    batch as batch,
)
from imubayes_archive import (
    load_batch as load_batch,
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

from .kernel_names import *  # noqa: F403  # they are listed there, once

__version__: str
__all__: list[str]

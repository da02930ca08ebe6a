"""Uses of a fitted unit: certificate, conformity, budgets, constants on board, and the effect on navigation.

`evaluation` has the law of propagation, coverage and decision rules; `budgets` the uncertainty budgets of a unit;
`certificate` the record of a report; `onboard` the constants of a unit and recordings corrected with them.  It
builds on the results of `imubayes` and on the noise of static records (`imubayes_recordings`).
"""

import lazy_loader

from imubayes.foundations.records import displayed_by

displayed_by("imubayes_qualification.display.equation_representations")

# Loaded when they are first used: the command line imports this package, and most commands need nothing of it.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""Many units: archives of campaigns, batches of fits, and the populations that the units are drawn from.

`dataset` is one Parquet file per campaign, partitioned by unit; `unit_fits` fits each with one model; `population`
answers what no single unit can: mean and spread, lots, steps and trends.  It builds on model and inference of
`imubayes`.
"""

import lazy_loader

# Loaded when they are first used: the command line imports this package, and most commands need nothing of it.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

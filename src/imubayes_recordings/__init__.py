"""Recordings of any format, and of a unit in the hand: how they become campaigns, and what their noise is.

`convert` opens a recording by its content and makes a campaign of it; `guided_capture` guides the operator of one that
grows; `noise_analysis` estimates the noise terms of static records.  It builds on the campaigns of `imubayes`.
"""

import lazy_loader

# Loaded when they are first used: the command line imports this package, and most commands need nothing of it.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

"""The Python interface: the same words as on the command line."""

import lazy_loader

from imubayes.foundations.records import displayed_by

displayed_by("imubayes.display.representations")

# Each command imports what it needs: to read a history takes no JAX.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

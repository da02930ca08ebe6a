"""The loop in a browser: a server on this machine, its page, and the linear algebra that answers a gesture.

It builds on the functions of the loop of `imubayes`, which the page calls.
"""

import lazy_loader

# Loaded when they are first used: the command line imports this package, and most commands need nothing of it.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

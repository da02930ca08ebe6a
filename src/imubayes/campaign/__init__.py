"""Campaign folders in, SI records out: the only place where units come in.

`load_campaign` reads a folder, `read_model_file` a model, and `check_campaign` says what is odd about the data.
"""

import lazy_loader

# A folder is read without the writer of campaigns from memory.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)

from .api.archives import ArchiveFit, fit_archive, load_archive_fit

__all__ = [
    "ArchiveFit",
    "fit_archive",
    "load_archive_fit",
]

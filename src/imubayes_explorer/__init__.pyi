from .start import explore

__all__ = [
    "explore",
]

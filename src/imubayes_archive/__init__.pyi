from .api.archives import BatchResult, batch, load_batch

__all__ = [
    "BatchResult",
    "batch",
    "load_batch",
]

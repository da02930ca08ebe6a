"""The model: effects and noise composed into one signal path and one likelihood."""

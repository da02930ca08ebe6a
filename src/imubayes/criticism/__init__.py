"""Where a model fails, what is missing, and what adding it brings."""

"""The loop: effects added to a model or removed, refitted, cross-validated, and the history of models tried."""

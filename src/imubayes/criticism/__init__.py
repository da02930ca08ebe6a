"""Criticism: where the model fails, and which effect is missing."""

"""Batches: every campaign of an archive fitted with one model, and the questions that no single unit can answer."""

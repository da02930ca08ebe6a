"""Simulation: from a test plan and a model to a synthetic campaign."""

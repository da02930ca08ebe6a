"""Figures of a batch and of a population."""

"""Inference: the joint fit, the posterior, and what the data can determine."""

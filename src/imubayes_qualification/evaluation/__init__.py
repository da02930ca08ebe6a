"""Evaluation of uncertainty: propagation, coverage, decision rules, and the answers that are known."""

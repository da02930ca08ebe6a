"""Foundations of all other parts: errors, units, records, files, arrays, Earth, covariates, campaign data."""

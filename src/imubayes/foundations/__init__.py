"""What every other part builds on: errors, units, records, files, arrays, Earth, covariates, campaign data."""

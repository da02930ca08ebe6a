"""How probable each explanation of what the model leaves is: one Bayesian search on the linearised fit."""

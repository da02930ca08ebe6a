"""How outputs would respond to what a model lacks: further effects, a wrong record; and covariates of residuals."""

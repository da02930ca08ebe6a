"""Populations of units: mean and spread, groups, steps and trends, and priors made of them."""

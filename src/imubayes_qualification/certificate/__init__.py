"""The record of a qualification report: certificate, limits, conformity, capability."""

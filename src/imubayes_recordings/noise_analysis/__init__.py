"""Noise of static records: overlapping Allan deviation and the noise terms of IEEE Std 952 and 1293 by likelihood.

A record is streamed once to a scratch file of its running sum (`running_sum`), from which the Allan deviation
(`allan_deviation`) and the cosine coefficients of the likelihood (`cosine_spectra`) are computed chunk by chunk,
so that memory does not grow with its length.  NumPy and SciPy only.
"""

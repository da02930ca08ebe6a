"""The former name of `Fit`, until all callers use the new one."""

from imubayes.inference.fit import Fit

Fitted = Fit

__all__ = ["Fitted"]

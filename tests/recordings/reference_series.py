"""A series that is the same on every machine and in every version: a linear congruential generator, walked up.

`allantools.json` holds what allantools 2024.6 (LGPL, not a dependency) makes of it: oadev and edf_greenhall with
confidence_interval at 95 %.  To write it anew: `pip install allantools==2024.6`, then run this file.
"""

import json
from pathlib import Path

import numpy as np

FILE = Path(__file__).with_name("allantools.json")
EXPONENTS = (2, 0, -1, -2)
RATE = 50.0


def series(samples: int = 3000) -> np.ndarray:
    state, values = 12345, []
    for _ in range(samples):
        state = (1103515245 * state + 12345) % 2**31
        values.append(state / 2**31 - 0.5)
    white = np.array(values)
    return 3.0 + white + 0.02 * np.cumsum(white[::-1])


def main() -> None:
    import allantools
    import allantools.ci as ci

    x = series()
    factors = [2**k for k in range(20) if 3 * 2**k <= len(x)]
    _, deviation, _, terms = allantools.oadev(x, rate=RATE, data_type="freq", taus=[m / RATE for m in factors])
    found = {"factor": factors, "deviation": deviation.tolist(), "terms": terms.tolist(), "degrees": {}, "interval": {}}
    for exponent in EXPONENTS:
        edf = []
        for m in factors:
            try:
                edf.append(float(ci.edf_greenhall(exponent, 2, m, len(x) + 1, overlapping=True)))
            except NotImplementedError:
                edf.append(None)
        found["degrees"][str(exponent)] = edf
        found["interval"][str(exponent)] = [
            None if e is None else [float(end) for end in ci.confidence_interval(d, e, 0.95)]
            for d, e in zip(deviation, edf, strict=True)
        ]
    FILE.write_text(json.dumps(found, indent=1) + "\n")


if __name__ == "__main__":
    main()

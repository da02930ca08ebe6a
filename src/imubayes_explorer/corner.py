"""A corner of chosen quantities: prior and posterior of each, and joint regions of pairs.

Densities are kernel estimates of the draws.  The joint region of a pair is that of highest density which holds a share
of the draws; it is sent as spans along the abscissa, row by row.
"""

from collections.abc import Sequence
from itertools import combinations

import numpy as np
import scipy  # loads its parts when they are first used

from imubayes.foundations.errors import closest_first, input_error
from imubayes.foundations.records import Record
from imubayes.results.result import Result
from imubayes.results.stored_tables import draws_of
from imubayes_explorer.calibration import EstimateLine, calibration_facts
from imubayes_explorer.edited_model import prior_text

_PLACES, _REACH, _KERNEL = 81, 5.0, 0.25
"""Places of a density, its range and the width of its kernel in standard deviations of the posterior."""
_CELLS, _SHARES, _SMOOTHED = 80, (0.95, 0.5), 0.45
"""Cells of a pair along each axis, shares of the draws in its regions, and width of its kernel in standard deviations,
for a thousand draws."""
Span = tuple[int, float, float]


class QuantityFacts(EstimateLine):
    """An estimate with densities of posterior and prior at places `x` in `unit`, over the highest value of both.

    Attributes
    ----------
    written : the prior of a parameter as a model file has it; empty of a derived quantity.
    """

    written: str
    x: tuple[float, ...]
    posterior: tuple[float, ...]
    prior: tuple[float, ...]


class PairRegion(Record):
    """A region of two quantities that holds a share of the draws.

    Attributes
    ----------
    spans : row of the ordinate, and from where to where on the abscissa, as shares of the two ranges.
    """

    share: float
    spans: tuple[Span, ...]


class PairFacts(Record):
    """Two quantities by their places: correlation and joint regions, the larger one first."""

    across: int
    up: int
    correlation: float
    regions: tuple[PairRegion, ...]


class CornerFacts(Record):
    """Chosen quantities with their pairs; `rows` is the number of rows of the regions."""

    quantities: tuple[QuantityFacts, ...]
    pairs: tuple[PairFacts, ...]
    rows: int = _CELLS


def corner_facts(result: Result, names: Sequence[str]) -> CornerFacts:
    """Return prior and posterior of quantities and their pairs; raises InputError for one that the result lacks."""
    for name in names:
        if name not in result.quantities:
            allowed = closest_first(name, result.quantities)
            raise input_error(f"no quantity '{name}'", "quantity", allowed, "choose one of these")
    prior = draws_of(result.posterior["prior"].to_dataset(), names)
    drawn = {name: np.asarray(result.draws.get(name, np.zeros(0))) for name in names}
    for name, draws in drawn.items():
        if np.isfinite(draws).sum() < 2:
            raise input_error(f"'{name}' has no draws", "quantity", "a quantity with draws", "choose another one")
    places = [_places(draws) for draws in drawn.values()]
    lines = {line.name: line for line in calibration_facts(result.summary).lines}
    quantities = []
    for (name, draws), x in zip(drawn.items(), places, strict=True):
        line, both = lines[name], (_density(draws, x), _density(prior.get(name, np.zeros(0)), x))
        highest = max(float(np.max(each)) for each in both)
        posterior, before = (tuple((each / highest).tolist()) for each in both)
        quantities.append(QuantityFacts(
            **line.model_dump(), written=prior_text(result.fit.model, name), x=tuple(x.tolist()),
            posterior=posterior, prior=before,
        ))  # fmt: skip
    pairs = (_pair(across, up, list(drawn.values()), places) for across, up in combinations(range(len(drawn)), 2))
    return CornerFacts(quantities=tuple(quantities), pairs=tuple(pairs))


def _places(draws: np.ndarray) -> np.ndarray:
    found = draws[np.isfinite(draws)]
    middle, reach = float(np.median(found)), _REACH * max(float(found.std()), 1e-300)
    return np.linspace(middle - reach, middle + reach, _PLACES)


def _density(draws: np.ndarray, x: np.ndarray) -> np.ndarray:
    """Return a kernel density of draws at places, up to a factor that all quantities share; 0 without draws."""
    known = draws[np.isfinite(draws)]
    if len(known) < 2:
        return np.zeros(len(x))
    width = _KERNEL * max(float(known.std()), 1e-300)
    return np.mean(np.exp(-0.5 * ((x[:, None] - known) / width) ** 2), axis=1) / width


def _pair(across: int, up: int, draws: Sequence[np.ndarray], places: Sequence[np.ndarray]) -> PairFacts:
    one, other = draws[across], draws[up]
    known = np.isfinite(one) & np.isfinite(other)
    ranges = [(float(places[k][0]), float(places[k][-1])) for k in (across, up)]
    counts, _, _ = np.histogram2d(one[known], other[known], bins=_CELLS, range=ranges)
    width = _SMOOTHED * (1000 / max(int(known.sum()), 1)) ** (1 / 6) * _CELLS / (2 * _REACH)
    density = scipy.ndimage.gaussian_filter(counts.T, width, mode="constant")
    # Smoothing widens a region; the level is that which a share of the draws is above.
    cells = [
        np.clip((_CELLS * (each[known] - low) / (high - low)).astype(int), 0, _CELLS - 1)
        for each, (low, high) in zip((other, one), ranges[::-1], strict=True)
    ]
    levels = np.quantile(density[cells[0], cells[1]], [1 - share for share in _SHARES]).tolist()
    spread = float(one[known].std() * other[known].std())
    together = float(np.mean((one[known] - one[known].mean()) * (other[known] - other[known].mean())))
    return PairFacts(
        across=across, up=up, correlation=together / spread if spread > 0 else 0.0,
        regions=tuple(
            PairRegion(share=share, spans=_spans(density, level)) for share, level in zip(_SHARES, levels, strict=True)
        ),
    )  # fmt: skip


def _spans(density: np.ndarray, level: float) -> tuple[Span, ...]:
    """Return where each row of a density is above a level; ends lie between cells by linear interpolation."""
    found = list[Span]()
    for place, row in enumerate(np.pad(density, ((0, 0), (1, 1)))):
        above = row >= max(level, 1e-300)
        edges = np.flatnonzero(above[1:] != above[:-1])
        ends = (edges + (level - row[edges]) / (row[edges + 1] - row[edges]) - 0.5) / density.shape[1]
        found += [(place, float(low), float(high)) for low, high in zip(ends[::2], ends[1::2], strict=True)]
    return tuple(found)

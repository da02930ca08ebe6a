"""Simulated units, each fitted by the product: does a conformance probability hold what it promises?

    python tests/study/conforming_units.py            2000 units; writes benchmarks/results/conformity.md
    python tests/study/conforming_units.py 100        some, printed only

Units are fitted side by side, as `imubayes batch` fits them; some are fitted by themselves too, for comparison.

A unit is an accelerometer in 24 positions of a dividing head, with bias, scale factor, K2, K3, misalignment and noise
drawn from the priors that its model states.  Its outputs are written down here in plain NumPy.  Limits are fixed before
the units are drawn.  The fault is planted in what is reported: draws pulled to their mean by 1.5.
"""

import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from imubayes.compiled.jax_settings import prepare_jax
from imubayes.foundations.campaign_data import Campaign, Channel, Mounting, Run, Site, Table
from imubayes.inference.fitted_model import Fit
from imubayes.inference.run_fit import joint_fit
from imubayes.model.bind import Model, bind
from imubayes.model.model_file import EffectSpec, ModelSpec
from imubayes.results.marginal import Marginal
from imubayes_archive.unit_fits.fit_unit import posteriors
from imubayes_archive.unit_fits.lanes import LANES, LaneStructure, find_modes
from imubayes_qualification.evaluation.decision_rules import (
    DecisionRule,
    MeasuredValue,
    ToleranceInterval,
    conformance_probability,
    decide,
)

prepare_jax()

ROOT = Path(__file__).parents[2]
REPORT = ROOT / "benchmarks" / "results" / "conformity.md"
UNITS, POSITIONS, SAMPLES = 2000, 24, 100
G, SCALE, ARCSEC = 9.81, 2000.0, np.pi / 648000
SIGMA = 0.4  # V, of a sample; 20 µg of a row
# Quantity → prior standard deviation in its unit, and that unit.
PRIOR = {
    "accel_bias.bias[a]": (30.0, "ug"),
    "accel_scale_factor.scale[a]": (40.0, "ppm"),
    "accel_misalignment.toward_p[a]": (3.0, "arcsec"),
    "accel_quadratic.quadratic[a]": (40.0, "ug/g^2"),
    "accel_cubic.cubic[a]": (60.0, "ug/g^3"),
}
# Limits of every quantity, in its prior standard deviations: on both sides, or above alone.
LIMITS = ((-0.6, 0.6), (-1.0, 1.0), (-1.6, 1.6), (-np.inf, 0.0), (-np.inf, 0.8))
# The output axis is along the axis of rotation; nothing senses an axis across it.
AXES = np.array([[0.0, 1, 0], [0, 0, 1], [1, 0, 0]])
MODEL = ModelSpec(
    "conforming units",
    (
        *(
            EffectSpec(effect, prior={name: f"normal(0, {sd} {unit})"})
            for (effect, name), (sd, unit) in (
                (full.removesuffix("[a]").split("."), prior) for full, prior in PRIOR.items()
            )
        ),
        EffectSpec("white_noise", prior={"sigma": "lognormal(1 noise, 0.5)"}),
    ),
)


@dataclass(frozen=True)
class Judged:
    """What is reported of one limit of one unit, and whether the unit is truly inside.

    Attributes
    ----------
    conformance : p_c; NaN where it is withheld.
    accepted : with a guard band of 1.65 u.
    margin : estimate to the nearest limit, in u, positive inside.
    inside : the truth.
    """

    conformance: float
    accepted: bool
    margin: float
    inside: bool


def unit_of(seed: int) -> tuple[dict[str, float], Campaign]:
    """Return the truth of a unit in the units of its quantities, and its campaign."""
    random = np.random.default_rng([seed, 77])
    true = {name: sd * random.standard_normal() for name, (sd, _) in PRIOR.items()}
    bias, scale, lean, k2, k3 = true.values()
    angle = 2 * np.pi * np.arange(POSITIONS) / POSITIONS
    along, across = -np.cos(angle), -np.sin(angle)  # at table angle 0 the body's x is East and its y down
    tilt = lean * ARCSEC
    sensed = (along + tilt * across) / np.hypot(1, tilt)
    value = sensed * (1 + scale * 1e-6) + 1e-6 * (bias + k2 * along**2 + k3 * along**3)
    sigma = SIGMA * np.exp(0.5 * random.standard_normal())
    output = SCALE * value + sigma / np.sqrt(SAMPLES) * random.standard_normal(POSITIONS)
    channel = Channel("a", "accelerometer", AXES, "V", SCALE, "g", SCALE / G, noise=SIGMA)
    zero, none = np.zeros(POSITIONS), np.full((POSITIONS, 1), np.nan)
    columns = {"table_angle": angle, "table_rate": zero, "table_angle_span": zero}
    run = Run("tumble", "dividing_head", "head", "flat", columns, output[:, None], zero + SAMPLES, none)
    site, head = Site(0.6, 0.0, G), {"head": Table("head", 0.0, 0.0)}
    return true, Campaign("unit", site, (channel,), head, {"flat": Mounting("flat", np.eye(3))}, (run,))


def fits_of(models: list[Model], structure: LaneStructure) -> list[Fit]:
    """Return the fits of units, those that lanes do not serve fitted by themselves."""
    varying = structure.stacked(models)
    side_by_side = posteriors(structure, varying, find_modes(structure, varying), models)
    return [joint_fit(model, None) if fit is None else fit for fit, model in zip(side_by_side, models, strict=True)]


def marginals_of(fit: Fit) -> dict[str, Marginal]:
    """Return the posteriors of the quantities of a unit."""
    assert fit.converged, fit.message
    assert fit.posterior is not None
    draws, names = fit.posterior.points, fit.model.layout.names
    # Every prior is normal about 0.
    return {n: Marginal(sd * draws[:, names.index(n)], float(len(draws))) for n, (sd, _) in PRIOR.items()}


def fitted_units(seeds: range) -> Iterator[tuple[dict[str, float], dict[str, Marginal]]]:
    """Yield truth and posterior of each unit."""
    structure = None
    for start in range(0, len(seeds), LANES):
        made = [unit_of(seed) for seed in seeds[start : start + LANES]]
        models = [bind(MODEL, campaign) for _, campaign in made]
        structure = structure or LaneStructure.of(models[0].problem)
        assert structure is not None, "units of this study can be fitted side by side"
        for (true, _), fit in zip(made, fits_of(models, structure), strict=True):
            yield true, marginals_of(fit)


def judged(true: dict[str, float], found: dict[str, Marginal], understated: float = 1.0) -> list[Judged]:
    """Return every limit of a unit; the reported uncertainties are understated by a factor."""
    rule, lines = DecisionRule("guard_band", guard_factor=1.65), []
    for name, marginal in found.items():
        sd = PRIOR[name][0]
        draws = marginal.mean + (marginal.draws - marginal.mean) / understated
        reported = Marginal(draws, marginal.effective)
        low, high = reported.interval
        for lower, upper in LIMITS:
            tolerance = ToleranceInterval(lower * sd, upper * sd)
            p = conformance_probability(reported, tolerance)
            estimate = MeasuredValue(reported.mean, reported.sd, (high - low) / 2, p)
            margin = min(reported.mean - tolerance.lower, tolerance.upper - reported.mean) / reported.sd
            lines.append(
                Judged(
                    np.nan if p.value is None else p.value, decide(rule, estimate, tolerance).outcome == "pass",
                    float(margin), tolerance.lower <= true[name] <= tolerance.upper,
                )
            )  # fmt: skip
    return lines


@dataclass(frozen=True)
class Shares:
    """What the units show.

    Attributes
    ----------
    at_90 : share truly inside of those with p_c = 0.90 ± 0.02, and their number.
    accepted_wrongly, stated : share of accepted ones that is outside, and the mean of the risk stated for them.
    at_guard : share that is outside of those whose estimate is 1.55 u to 1.75 u inside a limit; 5 % are stated.
    bins : (lowest p_c, mean p_c, share inside, number) of tenths.
    withheld : share of probabilities that are withheld.
    """

    at_90: tuple[float, int]
    accepted_wrongly: float
    stated: float
    accepted: int
    at_guard: tuple[float, int]
    bins: list[tuple[float, float, float, int]]
    withheld: float


def shares(lines: list[Judged]) -> Shares:
    """Return what the judgements of all units show."""
    p = np.array([each.conformance for each in lines])
    inside = np.array([each.inside for each in lines])
    accepted = np.array([each.accepted for each in lines]) & np.isfinite(p)
    margin = np.array([each.margin for each in lines])
    near, guard = np.abs(p - 0.9) <= 0.02, np.abs(margin - 1.65) <= 0.1
    bins = []
    for low in np.arange(10) / 10:
        own = (p >= low) & ((p < low + 0.1) | (low > 0.85))
        if own.any():
            bins.append((float(low), float(p[own].mean()), float(inside[own].mean()), int(own.sum())))
    return Shares(
        (float(inside[near].mean()), int(near.sum())), float(1 - inside[accepted].mean()),
        float(np.mean(1 - p[accepted])), int(accepted.sum()), (float(1 - inside[guard].mean()), int(guard.sum())),
        bins, float(np.mean(~np.isfinite(p))),
    )  # fmt: skip


def study(units: int) -> tuple[Shares, Shares, float]:
    """Return the shares of so many units, those with u understated 1.5 times, and the CPU seconds taken."""
    clock = time.process_time()
    honest, faulty = [], []
    for true, found in fitted_units(range(units)):
        honest += judged(true, found)
        faulty += judged(true, found, 1.5)
    return shares(honest), shares(faulty), time.process_time() - clock


def report(units: int, honest: Shares, faulty: Shares, seconds: float) -> str:
    """Return the figures as a page."""
    rows = "".join(f"| {low:.1f} | {mean:.3f} | {share:.3f} | {n} |\n" for low, mean, share, n in honest.bins)
    h, f = honest, faulty
    lines = [
        ("truly inside, of p_c = 0.90 ± 0.02", f"{h.at_90[0]:.3f} of {h.at_90[1]}", f"{f.at_90[0]:.3f}", "0.90 ± 0.03"),
        (
            "outside, of those 1.55 u to 1.75 u inside a limit",
            f"{h.at_guard[0]:.3f} of {h.at_guard[1]}", f"{f.at_guard[0]:.3f}", "0.05 ± 0.015",
        ),
        (
            "outside, of those accepted with w = 1.65 u",
            f"{h.accepted_wrongly:.4f} of {h.accepted}", f"{f.accepted_wrongly:.4f}", "as stated",
        ),
        ("risk stated for those accepted", f"{h.stated:.4f}", f"{f.stated:.4f}", ""),
        ("probabilities withheld", f"{h.withheld:.4f}", f"{f.withheld:.4f}", ""),
    ]  # fmt: skip
    table = "".join(f"| {' | '.join(line)} |\n" for line in lines)
    return f"""# Conformity of simulated units

{units} accelerometers on a dividing head, outputs in plain NumPy, each fitted by the product and compared with
{len(PRIOR) * len(LIMITS)} limits (`tests/study/conforming_units.py`); {seconds:.0f} s of CPU.

| share | reported | u understated 1.5 times | required |
| --- | --- | --- | --- |
{table}
| p_c from | mean p_c | share inside | limits |
| --- | --- | --- | --- |
{rows}"""


if __name__ == "__main__":
    count = int(sys.argv[1]) if len(sys.argv) > 1 else UNITS
    text = report(count, *study(count))
    print(text)
    if len(sys.argv) == 1:
        REPORT.write_text(text)

"""Comparison of models, drift and the prior of the next unit, from tables whose truth is known."""

import datetime

import numpy as np
import polars as pl
import pytest

from imubayes.foundations.errors import InputError
from imubayes.model.model_file import EffectSpec, ModelSpec, read_model
from imubayes_archive.population.drift import drifts
from imubayes_archive.population.model_comparison import compare_models
from imubayes_archive.population.parameter_population import populations
from imubayes_archive.population.population_priors import KnownPrior, next_unit_model, with_priors
from imubayes_archive.unit_fits.posterior_table import (
    Outcome,
    Quantities,
    UnitIdentity,
    UnitPosterior,
    parameter_table,
    unit_table,
)

Z = np.array([-1.96, -0.674, 0.0, 0.674, 1.96])
WIDE = 1000.0


def campaign(unit: str, date: datetime.date, estimates: dict[str, tuple[float, float]]) -> UnitPosterior:
    """Return a fitted campaign with estimates (mean, sd) under wide priors."""
    mean, sd = np.array(list(estimates.values())).T
    size = len(mean)
    part = Quantities(
        "parameter", tuple(estimates), ("ug",) * size, mean, sd, mean + sd * Z[:, None], np.zeros(size),
        np.full(size, WIDE), 1 - (sd / WIDE) ** 2,
    )  # fmt: skip
    outcome = Outcome("fitted", chi2=10.0, log_evidence=-5.0)
    return UnitPosterior(UnitIdentity(unit, "c", f"{unit}-{date}", "f", date), outcome, (part,), np.diag(sd**2))


def tables(found: list[UnitPosterior], model: str = "m") -> tuple[pl.DataFrame, pl.DataFrame]:
    return parameter_table(model, found), unit_table(model, "code", found)


DAY = datetime.date(2024, 1, 1)


def nested(shift: float, seed: int = 1, units: int = 60) -> tuple[list[UnitPosterior], list[UnitPosterior]]:
    """Return batches of an old model and of one with another parameter, whose estimate of `a` is `shift` away.

    The old estimate has variance 1, the new one 1 + 0.5², and they share the noise of variance 1.
    """
    random, old, new = np.random.default_rng(seed), [], []
    for place in range(units):
        first = random.normal(0, 1.0)
        second = first + random.normal(shift, 0.5)
        old.append(campaign(f"U{place}", DAY, {"a": (first, 1.0)}))
        new.append(campaign(f"U{place}", DAY, {"a": (second, np.sqrt(1.25)), "b": (1.0, 0.1)}))
    return old, new


def test_a_change_is_judged_by_the_variance_that_the_new_model_adds():
    (old, new) = nested(0.0)
    record, changes = compare_models(tables(old, "o"), tables(new, "n"))
    (line,) = record.parameters
    assert (record.campaigns, record.added, record.removed) == (60, ("b",), ())
    assert np.allclose(changes["change_sd"], 0.5)
    assert line.significant == 0
    assert 0.01 < line.p < 0.999
    # A shift of one old standard deviation is two of the difference, and hidden by the sum of the variances.
    shifted, _ = compare_models(*(tables(each, name) for each, name in zip(nested(1.0), "on", strict=True)))
    (line,) = shifted.parameters
    assert line.p < 1e-20
    assert line.mean_change == pytest.approx(1.0, abs=0.2)
    assert line.mean_change_sd == pytest.approx(0.5 / np.sqrt(60))


def test_campaigns_of_one_batch_alone_are_counted():
    old, new = nested(0.0, units=8)
    record, changes = compare_models(tables(old[2:], "o"), tables(new[:-1], "n"))
    assert (record.campaigns, record.only_old, record.only_new) == (5, 1, 2)
    assert changes["unit"].n_unique() == 5


def test_drift_between_calibrations_of_a_unit_is_found_and_the_unit_named():
    random, found = np.random.default_rng(5), []
    for place in range(20):
        drift = 30.0 if place == 3 else 0.0
        for year in (2022, 2024):
            value = random.normal(0, 1) + drift * (year - 2022)
            found.append(campaign(f"U{place}", datetime.date(year, 1, 1), {"a": (value, 1.0)}))
    record, changes = drifts(*tables(found))
    (drift,) = record.parameters
    assert (drift.pairs, drift.significant, drift.units) == (20, 1, ("U3",))
    assert changes.filter("significant")["years"].to_list() == pytest.approx([2.0], abs=0.01)


def test_the_model_of_the_next_unit_has_the_population_as_its_prior():
    random = np.random.default_rng(7)
    found = [
        campaign(f"U{place}", DAY, {"accel_bias.bias[ax]": (random.normal(300, 100), 10.0),
                                    "mounting_error.x[up]": (random.normal(0, 5), 1.0)})
        for place in range(200)
    ]  # fmt: skip
    spec = ModelSpec(
        "m", (EffectSpec("mounting_error"), EffectSpec("accel_bias", prior={"bias": "normal(0, 1000 ug)"}))
    )
    population = populations(*tables(found))[0]
    model, replaced = next_unit_model(spec, population)
    assert [each.parameter for each in replaced] == ["accel_bias.bias[ax]"]
    assert model.effects[0] == spec.effects[0]
    text = model.effects[1].prior["bias"]
    mean, sd = (float(part.split()[0]) for part in text.removeprefix("normal(").removesuffix(")").split(","))
    assert mean == pytest.approx(300, abs=25)
    assert sd == pytest.approx(100, abs=15)
    with pytest.raises(InputError, match="no parameter has a population"):
        next_unit_model(spec, populations(*tables(found[:3]))[0])


def test_the_prior_of_a_scatter_between_runs_stays_at_zero():
    random = np.random.default_rng(8)
    found = [
        campaign(f"U{place}", DAY, {"run_scatter.tau[ax]": (abs(random.normal(0, 2)), 0.5)}) for place in range(200)
    ]
    model, _ = next_unit_model(ModelSpec("m", (EffectSpec("run_scatter"),)), populations(*tables(found))[0])
    text = model.effects[0].prior["tau"]
    assert text.startswith("halfnormal(")
    assert float(text.removeprefix("halfnormal(").removesuffix(")").split()[0]) == pytest.approx(2, rel=0.15)


def test_a_channel_whose_prior_is_not_known_keeps_the_effect():
    """Of two channels one has a population: an effect that went with the other would be missing, its noise as well."""
    spec = read_model("reference-gyro")
    noise = next(each for each in spec.effects if each.name == "white_noise")
    known = {"white_noise.sigma[gx]": KnownPrior("log", 0.0, 0.1, "output")}
    changed, replaced = with_priors(spec, known, ["white_noise.sigma[gx]", "white_noise.sigma[gz]"])
    parts = [each for each in changed.effects if each.name == "white_noise"]
    assert [each.channels for each in parts] == [("gx",), ("gz",)]
    assert dict(parts[1].prior) == dict(noise.prior)
    assert [each.parameter for each in replaced] == ["white_noise.sigma[gx]"]
    assert [each for each in changed.effects if each.name != "white_noise"] == [
        each for each in spec.effects if each.name != "white_noise"
    ]

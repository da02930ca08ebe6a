"""Each law goes red: members that break one, and one that keeps them all."""

from dataclasses import replace

import equinox as eqx
import jax.numpy as jnp
import laws
import pytest
import recover

from imubayes.effects.base import Decay, Order, RecordEffect, SignalEffect, Stage
from imubayes.foundations.arrays import Scalar
from imubayes.foundations.errors import InputError
from imubayes.foundations.signal_path_state import Ambient, Sample
from imubayes.model.effect_registry import Registry
from imubayes.noise.components import (
    Entry,
    EntryNoise,
    GaussMarkovNoise,
    RowSpan,
    SeriesNoise,
    StateCovariance,
    TailNoise,
)
from imubayes.parameters.declarations import option, parameter


class GyroTrend(SignalEffect):
    """A sound effect: signal + c·(T − T_ref)."""

    name = "gyro_trend"
    stage, order, kinds = Stage.SENSOR, Order.BIAS, ("gyro",)
    needs = ("temperature",)
    reference = "for these tests"
    slope: Scalar = parameter("deg/h/degC", "normal(0, 1 deg/h/degC)", (0.1, 2), "the slope")
    reference_degC: float = option(25.0, "reference temperature, °C")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * (sample.ambient.temperature - self.reference_degC)


class Base(SignalEffect):
    """signal + b, to be broken in one place."""

    name = "base"
    stage, order, kinds = Stage.SENSOR, Order.BIAS, ("gyro",)
    reference = "for these tests"


def offset(unit="deg/h", prior="normal(0, 1 deg/h)", typical=(0.1, 2.0), meaning="the offset"):
    return parameter(unit, prior, typical, meaning)


class NotNull(Base):
    """signal + b + 1."""

    name = "not_null"
    bias: Scalar = offset()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.bias + 1e-6


class BrokenGradient(Base):
    """signal · √|x| with x the rate: no derivative at rest."""

    name = "broken_gradient"
    bias: Scalar = offset()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.bias * jnp.sqrt(jnp.sum(sample.rate**2) * self.bias**2)


class WrongReference(GyroTrend):
    """signal + c·(T − 20), which is not what its setting says."""

    name = "wrong_reference"

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + self.slope * (sample.ambient.temperature - 20.0)


class Invisible(Base):
    """signal + 0·b."""

    name = "invisible"
    bias: Scalar = offset()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + 0.0 * self.bias


class OtherName(Base):
    """signal + b."""

    name = "another_name"
    bias: Scalar = offset()


class Undocumented(Base):
    name = "undocumented"
    bias: Scalar = offset()


class Wordy(Base):
    """It does something to the signal."""

    name = "wordy"
    bias: Scalar = offset()


class Sourceless(Base):
    """signal + b."""

    name = "sourceless"
    reference = ""
    bias: Scalar = offset()


class UnknownUnit(Base):
    """signal + b."""

    name = "unknown_unit"
    bias: Scalar = offset(unit="furlong")


class WrongDimension(Base):
    """signal + b."""

    name = "wrong_dimension"
    bias: Scalar = offset(prior="normal(0, 1 ppm)")


class NotTypical(Base):
    """signal + b."""

    name = "not_typical"
    bias: Scalar = offset(typical=(2.0, 0.1))


class NarrowPrior(Base):
    """signal + b."""

    name = "narrow_prior"
    bias: Scalar = offset(typical=(1e3, 1e4))


class WrongStage(Base):
    """signal + b."""

    name = "wrong_stage"
    stage = Stage.TABLE
    bias: Scalar = offset()


class UnknownNeed(Base):
    """signal + b."""

    name = "unknown_need"
    needs = ("humidity",)
    bias: Scalar = offset()


class ConditionNeed(Base):
    """signal + b, asked only of runs that turn: its response says that."""

    name = "condition_need"
    needs = ("turning",)
    bias: Scalar = offset()


class DeafNoise(EntryNoise):
    """σ² = 1, whatever σ."""

    name = "deaf_noise"
    reference = "for these tests"
    sigma: Scalar = parameter("output", "lognormal(1 noise, 0.5)", (1e-6, 1e3), "the deviation")

    def variance(self, entry: Entry) -> Scalar:
        return jnp.ones_like(self.sigma) / entry.samples


class NegativeNoise(DeafNoise):
    """σ² − 1, which may be negative."""

    name = "negative_noise"

    def variance(self, entry: Entry) -> Scalar:
        return self.sigma**2 - 1.0


class DeafSlowNoise(GaussMarkovNoise):
    """Correlation time 100 s, whatever T."""

    name = "deaf_slow_noise"

    def states(self, row: RowSpan) -> StateCovariance:
        return GaussMarkovNoise(self.sigma, 0.0 * self.time + 100.0).states(row)


class IndefiniteSlowNoise(GaussMarkovNoise):
    """A third of the variance that its covariances need."""

    name = "indefinite_slow_noise"

    def states(self, row: RowSpan) -> StateCovariance:
        found = GaussMarkovNoise(self.sigma, self.time + 1000.0).states(row)
        return eqx.tree_at(lambda known: known.variance, found, found.variance / 3)


class GyroDrag(RecordEffect):
    """A sound effect with a memory: signal + c·(T_τ − T)."""

    name = "gyro_drag"
    stage, order, kinds = Stage.SENSOR, Order.BIAS, ("gyro",)
    needs = ("temperature", "temperature_rate")
    reference = "for these tests"
    slope: Scalar = parameter("deg/h/degC", "normal(0, 1 deg/h/degC)", (0.1, 2), "the slope")
    tau: Scalar = parameter("min", "lognormal(10 min, 1)", (1, 60), "the time", null=600.0, shape=(3.0, 10.0, 30.0))

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay:
        return Decay(jnp.exp(-seconds / self.tau), now.temperature - before.temperature)

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal - self.slope * memory


class RestlessDrag(GyroDrag):
    """signal + c·(T_τ − T), whose memory grows by itself."""

    name = "restless_drag"

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay:
        return Decay(jnp.exp(-seconds / self.tau), now.temperature - before.temperature + 1e-3)


class HeavyDrag(GyroDrag):
    """signal + c·(T_τ − T) + T_τ − T: not the identity at null."""

    name = "heavy_drag"

    def apply(self, signal: Scalar, sample: Sample, memory: Scalar) -> Scalar:
        return signal - (self.slope + 1e-9) * memory


class RoughDrag(GyroDrag):
    """signal + c·(T_τ − T), with a gain that has no derivative if no time passes."""

    name = "rough_drag"

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay:
        return Decay(jnp.exp(-(jnp.sqrt(seconds / self.tau) ** 2)), now.temperature - before.temperature)


class AgelessDrag(GyroDrag):
    """signal + c·(T_τ − T), whatever τ."""

    name = "ageless_drag"

    def carry(self, before: Ambient, now: Ambient, seconds: Scalar) -> Decay:
        return Decay(jnp.exp(-seconds / 600.0) * (1 + 0 * self.tau), now.temperature - before.temperature)


class Squared(Base):
    """signal + b²·10⁹, which has no derivative if b is 0."""

    name = "squared"
    bias: Scalar = offset()

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + 1e9 * self.bias**2


class Steep(Base):
    """signal + √|b|, whose derivative is infinite if b is 0."""

    name = "steep"
    bias: Scalar = offset(prior="halfnormal(1 deg/h)")

    def apply(self, signal: Scalar, sample: Sample) -> Scalar:
        return signal + jnp.sqrt(self.bias)


class NegativeShape(GyroDrag):
    """signal + c·(T_τ − T), τ of either sign."""

    name = "negative_shape"
    tau: Scalar = parameter("min", "normal(10 min, 5 min)", (1, 60), "the time", null=600.0, shape=(3.0, 10.0))


class FarShape(GyroDrag):
    """signal + c·(T_τ − T), tried if no prior expects it."""

    name = "far_shape"
    tau: Scalar = parameter("min", "lognormal(10 min, 0.1)", (1, 60), "the time", null=600.0, shape=(3.0, 10.0, 900.0))


class ShapeElsewhere(GyroDrag):
    """signal + c·(T_τ − T), its null outside of what is tried."""

    name = "shape_elsewhere"
    tau: Scalar = parameter("min", "lognormal(10 min, 1)", (1, 60), "the time", null=6.0, shape=(3.0, 10.0))


class WildSeries(SeriesNoise):
    """φ = c + ½, which may exceed 1."""

    name = "wild_series"
    reference = "for these tests"
    correlation: Scalar = parameter("1", "uniform(0, 0.99)", (0.1, 0.9), "the correlation")

    def lag_one_correlation(self) -> Scalar:
        return self.correlation + 0.5


class DeafSeries(WildSeries):
    """φ = 0, whatever c."""

    name = "deaf_series"

    def lag_one_correlation(self) -> Scalar:
        return 0.0 * self.correlation


class BoundlessTails(TailNoise):
    """ν = d − d."""

    name = "boundless_tails"
    reference = "for these tests"
    degrees_of_freedom: Scalar = parameter("1", "lognormal(8, 0.8)", (3, 30), "the degrees of freedom")

    def degrees(self) -> Scalar:
        return self.degrees_of_freedom - self.degrees_of_freedom


class CutTails(BoundlessTails):
    """ν = 10⁶·d."""

    name = "cut_tails"

    def degrees(self) -> Scalar:
        return 1e6 * self.degrees_of_freedom


@pytest.mark.parametrize(
    ("law", "broken", "says"),
    [
        (laws.null_is_the_identity, NotNull, "Not equal"),
        (laws.gradients_are_finite, BrokenGradient, "broken_gradient: gradient"),
        (laws.silent_without_its_covariate, WrongReference, "Not equal"),
        (laws.changes_something, Invisible, "changes nothing"),
        (laws.name_is_that_of_the_class, OtherName, "calls itself another_name"),
        (laws.text_says_formula_and_source, Undocumented, "no docstring"),
        (laws.text_says_formula_and_source, Wordy, "no formula"),
        (laws.text_says_formula_and_source, Sourceless, "names no source"),
        (laws.units_and_priors_are_known, UnknownUnit, "'furlong' is not a unit"),
        (laws.units_and_priors_are_known, WrongDimension, "not a unit of this parameter"),
        (laws.units_and_priors_are_known, NotTypical, "typical range"),
        (laws.units_and_priors_are_known, NarrowPrior, "no room for what is typical"),
        (laws.stage_and_covariates_are_known, WrongStage, "stands at"),
        (laws.stage_and_covariates_are_known, UnknownNeed, "humidity"),
        (laws.stage_and_covariates_are_known, ConditionNeed, "turning"),
        (laws.silent_without_its_covariate, RestlessDrag, "Not equal"),
        (laws.null_is_the_identity, HeavyDrag, "Not equal"),
        (laws.gradients_are_finite, RoughDrag, "rough_drag: gradient"),
        (laws.changes_something, AgelessDrag, "ageless_drag.tau changes nothing"),
        (laws.linear_coefficients_show_at_null, Squared, "squared.bias has no derivative"),
        (laws.linear_coefficients_show_at_null, Steep, "steep.bias: derivative"),
        (laws.linear_coefficients_show_at_null, NegativeShape, "may be negative"),
        (laws.linear_coefficients_show_at_null, FarShape, "outside the prior"),
        (laws.linear_coefficients_show_at_null, ShapeElsewhere, "not among what is tried"),
        (laws.variance_is_positive, WildSeries, "wild_series: correlation"),
        (laws.misstated_noise_is_less_likely, DeafSeries, "says nothing of neighbours"),
        (laws.variance_is_positive, BoundlessTails, "boundless_tails: 0.0 degrees"),
        (laws.misstated_noise_is_less_likely, CutTails, "has no tails"),
        (laws.misstated_noise_is_less_likely, DeafNoise, "deaf_noise.sigma"),
        (laws.misstated_noise_is_less_likely, DeafSlowNoise, "deaf_slow_noise.time"),
        (laws.variance_is_positive, IndefiniteSlowNoise, "eigenvalue"),
        (laws.variance_is_positive, NegativeNoise, "negative_noise: variance"),
    ],
)
def test_a_broken_member_breaks_its_law(law, broken, says):
    with pytest.raises((AssertionError, InputError), match=says):
        law(broken)


@pytest.mark.parametrize("law", [*laws.OF_ALL, *laws.OF_EFFECTS], ids=lambda law: law.__name__)
@pytest.mark.parametrize("sound", [GyroTrend, GyroDrag], ids=lambda member: member.name)
def test_a_sound_effect_keeps_them_all(law, sound):
    law(sound)


def registry(member: type) -> Registry:
    return Registry(Registry().effects | {member.name: member})


def test_a_sound_effect_is_recovered():
    recover.is_recovered(recover.recover(GyroTrend, registry(GyroTrend)))


def test_an_effect_that_cannot_be_seen_is_refused():
    with pytest.raises(InputError, match="no run can show 'invisible': its response is zero"):
        recover.recover(Invisible, registry(Invisible))


def test_an_answer_that_is_off_is_not_called_recovered():
    found = recover.recover(GyroTrend, registry(GyroTrend))
    off = replace(found, scores=found.scores + 6.0)
    with pytest.raises(AssertionError):
        recover.is_recovered(off)

"""Diagnoses made up for tests: of a scale factor asymmetry, and of each other kind of explanation."""

from imubayes.criticism.diagnosis_record import (
    CovariateLabel,
    Diagnosis,
    EffectGroup,
    RankedEffect,
    ScreenedEffect,
    UndetectableEffect,
)
from imubayes.criticism.explanation_records import (
    Absorber,
    CoefficientEstimate,
    EffectSlot,
    Evidence,
    Explanation,
    FoundForm,
    FoundNoise,
    ProbableEffect,
    ProbableExplanation,
    RmsChange,
    Suggestion,
    Verdict,
)
from imubayes.inference.candidate_runs import RunDesign

KINDS: tuple[Explanation, ...] = ("nothing", "noise", "effects", "input", "outside")
_LEADING: dict[Verdict, Explanation] = {
    "adequate": "nothing", "noise_model": "noise", "missing_effect": "effects", "equivalent_effects": "effects",
    "run_disagrees": "input", "unexplained_structure": "outside",
}  # fmt: skip
ASYMMETRY, QUADRATIC = "gyro_scale_asymmetry", "gyro_scale_quadratic"


def slot(*names: tuple[str, float]) -> EffectSlot:
    candidates = tuple(ProbableEffect(effect=name, channels=("gx",), probability=p) for name, p in names)
    return EffectSlot(candidates=candidates, gain=6.6, probability=0.998)


def evidence(
    shares: dict[Explanation, float],
    slots: tuple[EffectSlot, ...] = (),
    form: FoundForm | None = None,
    noise: tuple[FoundNoise, ...] = (),
    known: float = 0.03,
    inclusion: dict[str, float] | None = None,
) -> Evidence:
    explanations = tuple(
        ProbableExplanation(kind=kind, probability=shares.get(kind, 0.0), log_odds=0.0 if kind in shares else -20.0)
        for kind in KINDS
    )
    included = {"accel_cubic": 0.04} if inclusion is None else inclusion
    return Evidence(
        explanations=explanations, slots=slots, form=form, noise=noise, noise_known=known, hypotheses=100,
        inclusion=tuple(ProbableEffect(effect=name, channels=("ax",), probability=p) for name, p in included.items()),
    )  # fmt: skip


def line(effect: str, drop: float, probability: float) -> RankedEffect:
    coefficient = CoefficientEstimate(name=f"{effect}.size[gx]", value=120.0, sd=12.0, unit="ppm")
    return RankedEffect(
        effect=effect, channels=("gx",), delta_chi2=drop, probability=probability, log_odds=drop / 2, shape={},
        coefficients=(coefficient,),
    )  # fmt: skip


def diagnosis(
    verdict: Verdict = "equivalent_effects",
    probability: float = 0.998,
    form: FoundForm | None = None,
    noise: tuple[FoundNoise, ...] = (),
) -> Diagnosis:
    """Return a diagnosis with a verdict of some probability; of effects one group of two."""
    effects = _LEADING.get(verdict) == "effects"
    ranked = (line(ASYMMETRY, 98.4, 0.54), line(QUADRATIC, 95.1, 0.46))
    candidates = tuple(map(_screened, ranked))
    group = EffectGroup(
        channels=("gx",), probability=probability, log_odds=45.0, delta_chi2=98.4, candidates=candidates,
        residual=RmsChange(channel="gx", before=2.8, after=1.5, unit="deg/h"),
        covariate=CovariateLabel(name="rate_i", unit="deg/s", phrase="rate along the input axis"),
        discriminating_run=RunDesign(procedure="rate_table", table="rate", mounting="x-up", max_rate_deg_s=300.0),
    )  # fmt: skip
    hidden = UndetectableEffect(
        effect="accel_quadratic", absorbed_by=(Absorber("run offsets", 0.93),), reason="absorbed", unit="ug/g^2"
    )
    lacking = UndetectableEffect(effect="lever_arm", reason="not_supplied", needs=("turning",))
    found = None
    if verdict in _LEADING:
        slots = (slot((ASYMMETRY, 0.54), (QUADRATIC, 0.46)),) if effects else ()
        found = evidence({_LEADING[verdict]: probability}, slots, form, noise)
    return Diagnosis(
        verdict=verdict, message="It did not settle." if verdict == "not_converged" else "", result="R",
        explanations=found, groups=(group,) if effects else (), delta_chi2=98.4 if effects else None,
        ranking=(*ranked, line("gyro_g_sensitivity", 2.0, 0.003)), undetectable=(hidden, lacking),
        suggested=Suggestion(effects=(ASYMMETRY,), channels=None) if effects else None,
        all_that_fit=Suggestion(effects=(ASYMMETRY, QUADRATIC), channels=None) if effects else None,
    )  # fmt: skip


def _screened(of: RankedEffect) -> ScreenedEffect:
    return ScreenedEffect(
        effect=of.effect, channels=of.channels, probability=of.probability, delta_chi2=of.delta_chi2, shape=of.shape,
        coefficients=of.coefficients,
    )  # fmt: skip

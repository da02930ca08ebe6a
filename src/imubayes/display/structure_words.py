"""The wording of residual structure, and the source of an effect class for a formula that the catalogue lacks."""

from imubayes.criticism.diagnosis_record import ResidualStructure
from imubayes.criticism.formula_search import FormulaTerm
from imubayes.criticism.localised_structure import Step

_NAMES = ("coefficient", "second", "third")
_SOURCE = '''"""Found in the residuals: {formula}."""
{numpy}
from imubayes import Order, Scalar, SignalEffect, Stage, parameter


class FoundShape(SignalEffect):
    """Signal + {formula}."""

    name = "found_{kind}_shape"
    stage, order, kinds = Stage.SENSOR, Order.BIAS, ("{kind}",)
    needs = {needs!r}
{parameters}

    def apply(self, signal, sample):
        return signal + {total}
'''


def step_text(step: Step) -> str:
    """Return where a step is, as "step at 120 s of run ramp"."""
    where = f"from row {step.at:.0f}" if step.unit == "row" else f"at {step.at:.4g} {step.unit}"
    return f"step {where} of run {step.run}"


def structure_shape(structure: ResidualStructure) -> str:
    """Return the formula of a structure in symbols, or where its step is; may be empty."""
    return step_text(structure.step) if structure.step else structure.shape


def formula_source(structure: ResidualStructure) -> str:
    """Return an effect class for the formula of a structure, to save beside the model; empty without a formula."""
    if not structure.terms:
        return ""
    named = list(zip(_NAMES, structure.terms, strict=False))
    total = " + ".join(f"self.{name} * {term.expression}" for name, term in named)
    return _SOURCE.format(
        formula=" + ".join(f"{name}·{term.shape}" for name, term in named),
        numpy="\nimport jax.numpy as jnp\n" if "jnp." in total else "",
        kind=structure.kind,
        needs=tuple(dict.fromkeys(need for term in structure.terms for need in term.needs)),
        parameters="\n".join(_parameter(name, term) for name, term in named),
        total=total,
    )


def _parameter(name: str, term: FormulaTerm) -> str:
    """Return the declaration of a coefficient; its prior is three times as wide as the estimate."""
    wide = float(f"{3 * abs(term.value):.1g}") or 1.0
    low = float(f"{abs(term.value) / 10:.1g}")
    prior = f"normal(0, {wide:g} {term.unit})"
    return f'    {name}: Scalar = parameter("{term.unit}", "{prior}", ({low:g}, {wide:g}), "the coefficient")'

"""The source of an effect class for a formula that the catalogue lacks."""

from imubayes.criticism.diagnosis_record import ResidualFormula
from imubayes.criticism.formula_search import FormulaTerm

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


def formula_source(found: ResidualFormula) -> str:
    """Return an effect class for a formula, to save beside the model."""
    named = list(zip(_NAMES, found.terms, strict=False))
    total = " + ".join(f"self.{name} * {term.expression}" for name, term in named)
    return _SOURCE.format(
        formula=" + ".join(f"{name}·{term.shape}" for name, term in named),
        numpy="\nimport jax.numpy as jnp\n" if "jnp." in total else "",
        kind=found.kind,
        needs=tuple(dict.fromkeys(need for term in found.terms for need in term.needs)),
        parameters="\n".join(_parameter(name, term) for name, term in named),
        total=total,
    )


def _parameter(name: str, term: FormulaTerm) -> str:
    """Return the declaration of a coefficient; its prior is three times as wide as the estimate."""
    wide = float(f"{3 * abs(term.value):.1g}") or 1.0
    low = float(f"{abs(term.value) / 10:.1g}")
    prior = f"normal(0, {wide:g} {term.unit})"
    return f'    {name}: Scalar = parameter("{term.unit}", "{prior}", ({low:g}, {wide:g}), "the coefficient")'

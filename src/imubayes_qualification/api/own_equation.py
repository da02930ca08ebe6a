"""Uncertainty of an equation of one's own, and the known answers of this installation.

mass = imubayes.propagate(lambda m, rho: m / rho, [
imubayes.InputQuantity.normal("m", 0.1, 2e-5), imubayes.InputQuantity.between("rho", 7900, 8100),
])
print(mass, mass.gum, imubayes.conformity(mass, upper=1.3e-5))
"""

from imubayes_qualification.certificate.value_conformity import ConformityStatement, conformity
from imubayes_qualification.evaluation.input_quantities import InputQuantity
from imubayes_qualification.evaluation.known_answers import KnownAnswer, selftest
from imubayes_qualification.evaluation.law_of_propagation import GumBudget, budget
from imubayes_qualification.evaluation.propagation import Propagated, propagate

__all__ = [
    "ConformityStatement",
    "GumBudget",
    "InputQuantity",
    "KnownAnswer",
    "Propagated",
    "budget",
    "conformity",
    "propagate",
    "selftest",
]

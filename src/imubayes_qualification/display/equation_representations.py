"""How propagated quantities, budgets and statements of conformity show themselves; registered on import."""

from imubayes.display.layout import Report
from imubayes.display.shown_records import shown_as
from imubayes_qualification.certificate.value_conformity import ConformityStatement
from imubayes_qualification.display import own_equation as equations
from imubayes_qualification.evaluation.law_of_propagation import GumBudget
from imubayes_qualification.evaluation.propagation import Propagated

shown_as(Propagated, equations.propagated_headline, equations.propagated_report)
shown_as(GumBudget, equations.budget_headline, lambda found: Report((), [equations.budget_sheet(found)]))
shown_as(ConformityStatement, equations.conformity_headline, equations.conformity_report)

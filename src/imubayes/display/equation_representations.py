"""How propagated quantities, budgets and statements of conformity show themselves; registered on import."""

from imubayes.display import own_equation as equations
from imubayes.display.layout import Report
from imubayes.display.shown_records import shown_as
from imubayes.qualification.law_of_propagation import GumBudget
from imubayes.qualification.propagation import Propagated
from imubayes.qualification.value_conformity import ConformityStatement

shown_as(Propagated, equations.propagated_headline, equations.propagated_report)
shown_as(GumBudget, equations.budget_headline, lambda found: Report((), [equations.budget_sheet(found)]))
shown_as(ConformityStatement, equations.conformity_headline, equations.conformity_report)

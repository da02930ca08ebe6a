"""Tolerances of the qualification statistics: value, meaning, origin, and what moves when they are changed."""

RISK_ERRORS = 3.0
"""Monte Carlo errors by which a risk from draws may differ from that of quadrature.

Origin: 3 standard deviations, exceeded by chance once in 370 comparisons.  A larger value lets a wrong risk pass.
"""

RISK_SHAPE = 0.005
"""Difference between the two methods that is allowed beyond the Monte Carlo error.

Origin: a four-parameter marginal misses the tail of a posterior with mixed widths by some thousandths of probability
(tests/qualification/test_conformance.py: gamma, folded and t₅ marginals stay below 0.004).  No decision rule in use
turns on less.  A smaller value withholds risks of marginals that are merely not sinh-arcsinh.
"""

COVERAGE = 0.95
"""Probability of the coverage interval, and default of the conformance probability that a decision asks for."""

GUARD_FACTOR = 1.65
"""Width of the one-sided 95 % guard band in standard uncertainties (JCGM 106, 8.3.2; ILAC-G8:09/2019)."""

LEAST_EFFECTIVE = 400.0
"""Effective draws below which no conformance probability is stated.

Origin: at p = 0.95 the Monte Carlo error of 400 draws is 0.011, a fifth of the risk.
"""

LEAST_SHARE = 1e-3
"""Share of the variance below which a contribution is summed with others in one line of a budget.

Origin: it changes a standard uncertainty by half a thousandth, below its second digit.
"""

ADDS_UP = 0.02
"""Share of the posterior variance by which the contributions of a budget may miss it before that is said.

Origin: the budget is required to add up to the posterior variance within 2 %.
"""

CONDITIONING_DRAWS = (120, 3000)
"""Least and most draws of the noise scales over which the contributions of a budget are averaged.

Origin: contributions scatter over draws by 30 % where a scale is known, which 120 draws average to 3 %, and by several
times themselves where a scatter between runs is known from its prior alone, which takes thousands.
"""

CONDITIONING_WORK = 1e10
"""Multiplications that are spent on the averages of one budget: ten seconds on one core."""

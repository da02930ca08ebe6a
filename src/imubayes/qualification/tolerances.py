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

USEFUL_RUN = 0.99
"""Share of a standard uncertainty that a further run may leave at most, to be proposed in a budget.

Origin: a change by a hundredth is the least that two significant digits show.  The report states by how much each run
narrows a quantity; a larger value proposes runs that narrow nothing visibly.
"""

CONTRADICTION_ERRORS = 4.0
"""Monte Carlo errors by which the sampled variance of a linear part may differ from the one that is known.

Origin: 4 standard deviations, exceeded by chance once in 16 000 quantities.  A smaller value gives up the sharper
estimate for the sampled one more often; a larger one overlooks a posterior that is not its approximation.
"""

MOST_WIDENED = 1.25
"""Factor by which a sampled standard deviation may contradict the approximation and its contributions be scaled.

Origin: Gauss–Newton neglects the curvature of the model, which changed one width of full-qualification by 3.5 %; shares
of contributions still hold then.  Beyond it the approximation is another distribution, and the difference stays in the
remainder, where the report names it.
"""

CONDITIONING_WORK = 2e9
"""Multiplications spent on averaging the contributions of a budget over draws of the noise scales.

Origin: a quarter of a second on one core.  Variances scatter over draws by 30 % where a scale is known, which the 600
draws of a large budget average to 1.2 %, 0.6 % of the standard uncertainty; where a scatter between runs is known from
its prior alone they scatter by several times themselves, so a small budget takes all draws.
"""

SPLIT_DRAWS = 40
"""Draws of the noise scales over which the contributions of the data are divided among the runs.

Origin: the shares of runs scatter less than their sum, and degrees of freedom from 40 draws are known to 25 %.  Each
costs a product of the whitened Jacobian.
"""

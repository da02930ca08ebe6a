"""Every threshold and search limit of criticism, with its meaning, its origin and the effect of changing it.

Origins.  *Derived*: follows from the reasoning given.  *Blind study*: set by random campaigns from the independent
generator (`tests/study/blind.py`), where false alarms, detections and wrong names are counted; a change must be
followed by a new run of that study.  *Convention*: usual practice; results depend on it only weakly.  *Numerical*:
separates signal from rounding; anything within an order of magnitude or two gives the same results.  *Effort*: bounds
computing time or memory.

Vocabulary: a *false alarm* is any verdict but `adequate` on a complete model; *power* is the chance to detect a missing
effect; a *wrong name* is a single effect reported with confidence that is not the cause.
"""

import math

# ---- False-alarm budget: probability of any false alarm per diagnosis, all looks counted -----------------------------
# Design value: 5 % in all, spent on three families of tests (Bonferroni between them).  Raising one raises false alarms
# and power together; lowering it hides weak effects.
FALSE_ALARM_EFFECT = 0.02
FALSE_ALARM_STRUCTURE = 0.02
FALSE_ALARM_NOISE = 0.01
FALSE_ALARM = FALSE_ALARM_EFFECT + FALSE_ALARM_STRUCTURE + FALSE_ALARM_NOISE

# ---- Noise adopted before effects are judged (stepwise_search) -------------------------------------------------------
# p-values assume known noise.  Where its correlation was estimated from the same samples, the budget is multiplied by
# this.  Blind study with AR(1) noise (7a6fcab): larger gives false alarms, smaller costs power in correlated noise.
ESTIMATED_CORRELATION_FACTOR = 0.1
# Autocorrelation or run scatter below this p-value, once an alarm is raised, is modelled before an effect is claimed:
# left out, it passes for effects.  Blind study (195861c): smaller gives wrong names, larger costs power.
SUSPECTED_NOISE_P = 0.1
# A pattern less probable than this is not noise, whatever the autocorrelation: it is projected out before the noise is
# estimated.  Blind study: larger lets patterns of noise be projected out, smaller lets effects inflate the noise.
PATTERN_NOT_NOISE_P = 1e-6
# Most effects, most patterns and most rounds of outlier rejection in one search.  Effort: the study needs two effects.
MAX_EFFECTS, MAX_PATTERNS, MAX_OUTLIER_ROUNDS = 4, 8, 4

# ---- Candidates: projected responses (projection, score_test) --------------------------------------------------------
# A direction of a candidate whose projection retains less than this share of its squared length is rounding, and cannot
# be detected.  Numerical: a drift turns a servo table by 10⁶ times the noise of its angle, and what only the priors of
# the model speak against is 1e-10 of that; projections are accurate to some 1e-20.  Larger overlooks such effects.
RETAINED_MIN = 1e-12
# The same for free forms and formulas, which may all but coincide with what the model has.  Numerical: smaller lets the
# curvature of the model pass for structure.
FORM_RETAINED_MIN = 1e-6
# The same between neighbouring values of a scanned shape parameter, projected out together.  Numerical.
SHAPE_RETAINED_MIN = 1e-4
# A response that at the largest typical size changes all samples together by less than this share of their noise is the
# rounding error of the derivative.  Numerical: smaller gives such candidates absurd coefficients.
RESPONSE_MIN = 1e-6
# A candidate supported only by the priors is implausible beyond so many times the largest typical size.  Convention.
IMPLAUSIBLE_SIZE = 100.0
# A candidate is implausible where even its estimate less three standard deviations exceeds so many times the largest
# typical size: an effect of the right shape, but another quantity, as K2 of 10⁵ ppm/(deg/s) for a scale factor error of
# 500 ppm at Earth rate.  Convention: units a hundred times worse than usual exist.
IMPOSSIBLE_SIZE = 1e4
# Simulated residuals for the weights of a chi-bar-squared distribution, and most rounds of its least squares.  Effort:
# weights are known to 0.01.
CONE_DRAWS, CONE_ROUNDS = 4000, 200
# A run offset is a stratum of its own where it inflates the variance of the run's mean by more than this factor.
# Convention: smaller makes more between-run strata, each with few degrees of freedom and little power.
OFFSET_INFLATION = 1.2

# ---- Evidence for what the noise took up (marginal_evidence) ---------------------------------------------------------
# Where nothing is significant, an effect between runs is claimed whose Bayes factor exceeds the number of candidates
# over this.  Derived: it bounds the chance of a false alarm (Markov's inequality); a quarter of the budget for effects.
# Larger makes alarms of a scatter that its prior did not expect.  Where that is found already, a name for it may spend
# the whole budget.
MARGINAL_EVIDENCE = FALSE_ALARM_EFFECT / 4
# Prior widths of a coefficient in units of its largest typical size, equally likely.  Convention: each more costs every
# candidate the logarithm of their number; without one as large as the effect it seems less evident than it is.
SIZE_WIDTHS = (0.01, 0.1, 1.0, 10.0, 100.0)
# A candidate whose log Bayes factor on a grid of scales is further below what is asked for is not evaluated between
# them; bound of a scale in prior standard deviations, and most steps of its search, or points of a line.  Effort.
GRID_SLACK, SCATTER_REACH, SCATTER_STEPS = 10.0, 6.0, 15
# In correlated noise the candidates below this p-value are evaluated, so many at most, of so many samples at most.
# Effort.
TAKEN_UP_P, TAKEN_UP_MOST, TAKEN_UP_ROWS = 0.1, 8, 10_000

# ---- Records with correlated noise in the model (slow_noise_records, slow_noise_evidence) ----------------------------
# Factor on the budgets for effects and structure there, whose noise is estimated from the same rows, and p-value of an
# effect that correlated noise took up, all candidates counted.  Derived: half of the two budgets, 2 %, and 1.5 % leave
# the false alarms below 5 %.  Larger makes alarms of noise that wanders.
SLOW_NOISE_FACTOR, SLOW_NOISE_EVIDENCE = 0.5, 0.015
# Simulated records.  Effort: of 400, six are below the threshold.
SLOW_DRAWS = 400
# Shapes of the noise: share and correlation of Gauss–Markov noise; variances of flicker noise and of the step of a
# random walk, over that of white noise of a row.  Numerical: neighbours differ by less than one unit of log likelihood.
SLOW_SHARES = (0.05, 0.1, 0.2, 0.4, 0.6, 0.8, 0.95, 0.99)
SLOW_CORRELATIONS = (0.2, 0.4, 0.6, 0.8, 0.9, 0.95, 0.98, 0.995)
SLOW_FLICKERS = (0.0, 0.003, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0, 10.0)
SLOW_WALKS = (0.0, 1e-4, 3e-4, 1e-3, 3e-3, 0.01, 0.03, 0.1, 0.3, 1.0, 3.0)
# Fewest and most rows of the longest record of a channel.  Effort: covariances of a record are held in full.
SLOW_LEAST_ROWS, SLOW_MOST_ROWS = 24, 200
# Share of its square that a direction keeps past the model.  Numerical.
SLOW_RETAINED_MIN = 1e-6

# ---- Equivalence groups (equivalent_effects, discriminating_run) -----------------------------------------------------
# Two candidates are distinguishable where substituting one for the other leaves at least this χ².  Derived: three
# standard deviations (9) raised to four for some fifty rivals that can lead by chance; confirmed by the blind study
# (ef1da2f).  Smaller means wrong names, larger means longer groups.
DISTINGUISHABLE_CHI2 = 16.0
# Share of the leader's χ² that an equivalent candidate leaves at most, and one that is as likely.  Derived: half of the
# χ² of the weakest leader that is claimed are odds of 20 to 1 already; what is as likely and has nothing in common with
# the leader is a cause of its own.  Larger lists effects that explain nothing of what was found.
EXPLAINED_ALIKE, EXPLAINED_AS_LIKELY = 0.5, 0.75
# A plain function is the response of an effect where it leaves less than this share of its square.  Numerical, with
# room for the curvature of the model: smaller takes an effect for a rival of itself.
SAME_RESPONSE = 1e-3
# What is added to the output may be a change of the scale factor if it is below this share of the largest input.
# Convention: scale factors change by a few per cent over temperature.  Larger lets Earth rate at rest be scaled.
SCALE_CHANGE_MAX = 0.1
# Odds of 20 to 1 do not decide between two candidates that explain half of the same.  Convention (95 %), blind study.
DECISIVE_LOG_ODDS = math.log(20.0)

# Prior widths of the coefficients of an effect in units of their largest typical sizes, equally likely.  Convention:
# units ten times better and worse than usual are met; without the larger one two effects of such a size lose to a third
# that imitates them, without the smaller one an effect of many coefficients loses to any pair of fewer.
RIVAL_WIDTHS = (0.1, 1.0, 10.0)

# ---- Scales beside a candidate (scales_beside) -----------------------------------------------------------------------
# Least share of the evidence that must lie within runs, and between them, corrected p-value below which a candidate is
# tested again, and most candidates.  Effort: within one stratum the scales do not matter.
BOTH_STRATA_SHARE, SCALES_BESIDE_P, SCALES_BESIDE_MOST = 0.02, 0.5, 8
# Times that the scales are estimated.  Numerical.
SCALE_STEPS = 6
# Share of the threshold that is asked for at these scales.  Simulation of 4 to 10 runs without an effect: p-values
# below 0.01 occur up to 1.6 times as often as they should.
SECOND_LOOK = 0.5

# ---- Verdict (diagnosis, residual_evidence) --------------------------------------------------------------------------
# Where nothing is significant, the best candidate below this p-value is told with the verdict.  Convention: one in ten
# diagnoses of a right model tells one.
NEARLY_SIGNIFICANT_P = 0.1
# Where effects explain more than half of the variance of some channel, what remains is screened at the noise that is
# left.  Derived: priors weigh by what the noise is.  Numerical: above, a second screening is hardly different.
LESS_NOISE = 0.5
# Degrees of freedom of a stratum below which its variance beside effects is not taken from what they leave: the search
# fits so few by chance.  Convention.
FREEDOM_TO_JUDGE = 3.0
# Structure left by the candidates counts against the leader if it is worth more than this share of the leader's Δχ²: a
# large effect reveals its smallest imperfection.  Blind study: smaller withholds right names, larger gives wrong ones.
REMAINDER_SHARE = 0.01
# From this Δχ² a leader that leaves structure is refitted before it is doubted: the score is linear, and the curvature
# of a large effect looks like structure.  Blind study: below, curvature was never seen.
LARGE_EFFECT_CHI2 = 1000.0
# So many effects on one channel, of the same covariates, only approximate one cause that the catalogue lacks.  Blind
# study, as above.
CROWDED_EFFECTS = 3
# A share that makes one thing the main part of another: of a leader's χ² for a second effect that mends its shape, of a
# channel's structure for a step in one run.  Blind study, as above.
MAIN_SHARE = 0.75
# A step in one run that is worth so many times the leader's Δχ² was not caused by it.  Convention.
STEP_DOMINATES = 1.5
# Remaining structure contradicts a single name only below this p-value.  Blind study: larger withholds right names.
AGAINST_SINGLE_NAME_P = 1e-3
# Most channels for which a formula is sought.  Effort.
MAX_FORMULAS = 3
# A covariate is named as the one an effect depends on where its free form explains more than this share of what the
# effect explains.  Convention: smaller names covariates that are merely correlated with the right one.
COVARIATE_SHARE = 0.9

# A stated uncertainty that the model takes as exact is told where it shifts a parameter by so many of its posterior
# standard deviations, and so is the worst bias by an undetectable effect.  Derived: added in quadrature it widens an
# interval by 12 %, a digit of the standard uncertainty.
NEGLECTED_SHIFT = 0.5

# ---- Detectability ---------------------------------------------------------------------------------------------------
# Power at which the smallest detectable size is given.  Convention (Cohen 1988).
DETECTION_POWER = 0.8
# Smallest share of a response at which a parameter family is listed as absorbing it.  Convention.
ABSORBER_SHARE = 0.01

# ---- Outliers --------------------------------------------------------------------------------------------------------
# Outlier threshold, in robust (MAD-based) standard deviations.  Derived: under normality 6e-7 per sample, one false
# outlier in some 10⁶ samples.  Smaller rejects valid samples of heavy-tailed noise, larger leaves outliers that mask.
OUTLIER_SD = 5.0
# Ratio of the median absolute value to the standard deviation of a normal distribution, to four digits.
NORMAL_MAD = 0.6745
# A rejected sample is readmitted if it lies within so many predictive standard deviations of what the rest predicts.
# Convention: below OUTLIER_SD, because the first threshold was masked by the outliers themselves.
READMIT_SD = 4.0
# Lower bound of one minus leverage in studentising: above, a sample has no residual to judge.  Numerical.
UNLEVERAGED_MIN = 0.02
# A covariate with at most so many values (rounded to so many digits of its range) is scanned by value, otherwise in so
# many quantile bins.  Convention.
OUTLIER_MAX_VALUES, OUTLIER_DIGITS, OUTLIER_BINS = 64, 3, 16
# Outliers have a common cause where at least so many rows of so many runs fall on one value, or where successive ones
# share a sign, with less than this probability.  Blind study: smaller lets narrow effects pass for
# outliers.
CLUSTER_ROWS, CLUSTER_RUNS, CLUSTER_P = 3, 2, 0.01

# ---- Noise tests (noise_tests, gauss_markov) -------------------------------------------------------------------------
# Simulations of white noise through the projection, and rows times simulations held at once.  Effort: the
# standard deviation is known to 5 %; the tail is that of a Pearson III distribution.
NOISE_DRAWS, NOISE_DRAWS_AT_ONCE = 200, 20_000_000
# Bound of the estimated negative noise statistic (a correlation cannot be −1).  Numerical.
STRONGEST_ANTICORRELATION = 0.95
# Grid of the restricted likelihood: share of the variance that is correlated, correlation from row to row.  Effort.
MARKOV_SHARES = (0.1, 0.2, 0.35, 0.5, 0.65, 0.8, 1.0)
MARKOV_CORRELATIONS = (0.2, 0.35, 0.5, 0.65, 0.8, 0.9, 0.96)
# Grid points within this log likelihood of the best (1.4 standard deviations) are nearly as likely; the one with most
# low-frequency noise is taken.  Blind study (7a6fcab): zero gives false alarms in correlated noise.
MARKOV_NEARLY = 1.0
# A projected direction with less than this share of its squared length in a channel is ignored there.  Numerical.
DIRECTION_HELD_MIN = 0.1

# ---- Noise at the end of a fit (noise_assumptions) -------------------------------------------------------------------
# Beyond the budget above: a diagnosis that finds nothing else takes these tests for a verdict on the noise.
# Nominal probability that a fit with the noise of its model is said to have another, all tests together.  Design value
# for the 1 % that is asked for: with 200 draws a nominal 0.005 is 0.003 to 0.008 in five campaigns of 4800 draws each,
# 0.01 is 0.006 to 0.013.
FALSE_ALARM_INTERVALS = 0.006
# Above it and below this a departure is told as suspected.  Convention: one sound fit in twenty carries the notice; of
# fits to a random walk of 0.3 of the noise from row to row, half are above the first and most below this.
SUSPECTED_INTERVALS_P = 0.05
# Lowest frequencies of each run that count as slow.  Convention: fewer find only drifts, more lose them in the rest.
SLOW_MODES = 4
# Step of the output over its noise above which rounding is not smoothed by noise.  Derived: with noise σ of which the
# step q makes q²/12, q > 2σ leaves true noise below 0.41 q, whose rounding error follows the input (Widrow & Kollár
# 2008).
COARSE_STEP = 2.0
# Outputs lie on a grid where this share of them coincide, their distances are multiples of a step to this share of it,
# and the step is above this rounding of the largest output.  Numerical.
COINCIDENT_SHARE, GRID_SHARE, GRID_ROUNDING = 0.2, 1e-3, 1e-12

# ---- Noise as fitted and as known beforehand (known_noise) -----------------------------------------------------------
# A scale that exceeds what is known with less than this p-value, all comparisons together (Holm), contradicts it, and
# no model is adequate.  Convention: half of the budget for noise, because an excess that matters is far beyond; larger
# gives false alarms.
NOISE_CONTRADICTED_P = 0.5 * FALSE_ALARM_NOISE
# A ratio of fitted to recorded noise up to this is agreement, whatever its uncertainty.  Convention: the standard
# deviation of samples is rounded, and the stimulus varies a little within a row.  Larger hides weak structure.
NOISE_AGREES = 1.05
# A ratio beyond this, or below its inverse, is told where it exceeds so many standard uncertainties.  Convention.
NOISE_TOLD, NOISE_TOLD_SD = 1.3, 3.0
# Standard deviation of the logarithm of a scale among equal sensors, as in the default prior of white_noise.
# Convention: with it a scatter of five runs is told from 12 times that of two sisters, one of many runs from 8 times.
# Scales drawn from half-normal priors, each by itself, differ more: then one campaign in a hundred is told.
SISTERS_LOG_SD = 0.5
# Fewest degrees of freedom between runs for such a comparison.  Numerical: below, a variance is rounding.
SISTERS_FREEDOM_MIN = 0.5
# Fewest degrees of freedom within runs for which a comparison is made.  Convention: below, σ is known to 30 % at best.
NOISE_FREEDOM_MIN = 5.0

# ---- Free forms (lack_of_fit) ----------------------------------------------------------------------------------------
# One value per level up to so many levels, otherwise a cubic spline of so many columns; fewer rows have no form.
# Convention: more columns follow narrower structure at the cost of power for broad structure.
MAX_LEVELS, SPLINE_COLUMNS, FORM_MIN_ROWS = 16, 7, 8
# Course of one run: fewest rows, fewest rows of a segment, most segments.  Convention.
COURSE_MIN_ROWS, SEGMENT_ROWS, MAX_SEGMENTS = 12, 3, 8
# Values of a covariate closer than this share of its range are one level.  Convention: the scatter about a set point.
SAME_LEVEL = 0.02

# ---- Common course of runs (common_course) ---------------------------------------------------------------------------
# A course that runs of one input have in common, with less than this p-value for all channels tested, is structure.
# Simulation of AR(1) noise in 2 to 4 runs: p-values below 1e-3 occur 1 to 2 times as often as they should for φ ≤ 0.5
# and up to 20 times for φ = 0.95, so that a two-hundredth of the budget for structure is asked for.
COMMON_COURSE_P = 0.005 * FALSE_ALARM_STRUCTURE
# Rows by which runs of one input may differ in length.  Convention: the reduction of a log may drop the last.
COURSE_ROWS_APART = 2
# A temperature that varies by less is steady (the ripple of a chamber), and so is an input that varies by less than
# this share of its largest value.  Convention.
STEADY_DEGREES, STEADY_INPUT = 1.0, 0.01

# ---- Localised structure ---------------------------------------------------------------------------------------------
# Samples of a kind of channel between which features are scanned; above, they would not fit into memory.  Effort.
FEATURE_MIN_ROWS, FEATURE_MAX_ROWS = 12, 30_000
# Steps in a run are sought between so many parts at most, of so many rows at least.  Convention.
MAX_STEP_PARTS, STEP_PART_ROWS = 16, 3
# Columns whitened at a time: the compiled whitening depends on their number.  Effort.
WHITENING_BLOCK = 256

# ---- Term library and formula search ---------------------------------------------------------------------------------
# Powers, harmonics of the table angle, centres of bumps, waves through the range; time constants in minutes.
# Convention: every family more is one look more for every other.
MAX_POWER, HARMONICS, BUMP_CENTRES, MAX_WAVES = 5, 6, 9, 16
TIME_CONSTANTS_MIN = (2.0, 5.0, 10.0, 30.0, 60.0)
# Widths of a play, in shares of the range of a temperature; a play as wide as the range is never taken up.  Convention:
# neighbours respond much alike.
PLAY_SHARES = (0.01, 0.02, 0.05, 0.1, 0.2, 0.4, 1.0)
# Shapes of a memory tried about the best of these: the first step, a factor, and how many rounds, each by the root of
# the step before.  Numerical: from half the distance of neighbours to 12 %.  Fewer rounds miss a time constant between
# two of the list, and the other memory then seems to be excluded.
MEMORY_STEP, MEMORY_ROUNDS = 1.6, 3
# Most terms of a formula, and p-value (all terms of the library counted) below which one is taken.  Convention.
MAX_TERMS, TERM_P = 3, 0.01
# A product or a wave is chosen from many: it must explain so much more χ² than the best plain term.  Derived: three
# standard deviations.  Smaller prefers products of covariates that vary together.
ELABORATE_PENALTY = 9.0
# Terms within this χ² of the best (two standard deviations) are listed beside it.  Convention.
NEAR_CHI2 = 4.0
# Resampled sets of runs for the inclusion frequency.  Effort: its standard error is at most 3.5 %.
RESAMPLES = 200

# ---- Look-elsewhere correction (multiple_testing) --------------------------------------------------------------------
# Simulated residuals, and how many at once.  Effort: the 1 % quantile is known to some 20 %.
LOOK_DRAWS, LOOK_DRAWS_AT_ONCE = 3000, 250
# Below this quantile of the simulated minima the corrected p-value is proportional to the single one.  Derived: the
# union bound is tight in the tail; 30 of 3000 draws fix the factor.
LOOK_TAIL = 0.01

# ---- Adding an effect (warm_start, cross_validation) -----------------------------------------------------------------
# A new coefficient whose squared whitened column is below this in prior units has no gradient at its null (it enters as
# β² or |β|), and combinations this much weaker than the strongest are not determined.  Numerical.
NO_GRADIENT, SINGULAR = 1e-14, 1e-9
# A prior contradicts the data where the estimate lies so many standard deviations of its prior predictive distribution
# from the prior mean.  Convention (0.3 %): it is widened in an addition.  Larger lets a prior decide against the data.
PRIOR_CONFLICT_SD = 3.0
# A refit that loses more χ² than this is refused: a larger model cannot fit worse but for its new priors.  Derived.
REFIT_LOSS = -0.5
# A gain in log predictive density helps if it exceeds GAIN_MIN, and so many standard errors or, by flips of signs, the
# one-sided chance of that many (convention).  GAIN_MIN is derived: a superfluous parameter costs half a unit on unseen
# data (Akaike).
GAIN_STANDARD_ERRORS, GAIN_CHANCE, GAIN_MIN = 2.0, 0.0228, 0.5
# A single run is left out in so many blocks at most, of so many rows at least.  Convention.
MAX_BLOCKS, BLOCK_ROWS = 8, 4

# ---- Injection and recovery ------------------------------------------------------------------------------------------
# Steps to find the injected size, and relative tolerance of its Δχ².  Numerical.
SIZING_STEPS, SIZING_TOLERANCE = 6, 0.02

# ---- Runs that do not agree with the others (run_agreement) ----------------------------------------------------------
# Chance, for all that is tried, below which a run or row does not agree with the others.  Convention: noise that is not
# quite as recorded makes as much of the tail as of the rest, and a wrong input that matters is far beyond.
DISAGREEMENT_P = 1e-5
# Chance, for a run and all that is tried at a glance, below which each wrong input of it is worked out.  Convention:
# one sound run in a hundred costs some predictions more.
DOUBTED_RUN_P = 0.01
# Chance of what a run adds to the others, all runs together, below which a fit says that it does not agree.
# Convention: the line asks for a diagnosis, which decides.
RUN_TOLD_P = 0.005
# Explanations whose evidence, twice its logarithm, is within this of the best are not distinguished: odds of 150 to 1.
DISAGREEMENT_EQUAL = 10.0
# Rows that are told at most.  Convention: more are a matter of the model.
MOST_WRONG_ROWS = 3
# Scatter of the corrected runs over the noise of raw samples, up to which they agree with one another.  Convention.
RUNS_AGREE = 1.5

"""Score tests at the noise scales beside a candidate, for what acts within runs and between them.

An effect that acts between runs as well as within has inflated the scatter between them, and at the scales of the fit
its coefficient follows the weaker evidence within runs.  Restricted maximum likelihood with the effect in the model
finds both scales without it: rows are weighted by what the candidate leaves in each stratum, and again by what it
leaves then.  The F test with Satterthwaite's degrees of freedom at those scales is the usual test of a mixed model
(Giesbrecht & Burns, Biometrics 41, 1985).
"""

from collections.abc import Sequence

import numpy as np

from imubayes.criticism import thresholds
from imubayes.criticism.multiple_testing import LookElsewhere
from imubayes.criticism.projection import Projection, noise_of_run_means
from imubayes.criticism.score_test import Candidate, ProjectedResponse, assess, response_of


def evident_at_scales_beside(
    projection: Projection,
    prepared: Sequence[ProjectedResponse],
    candidates: Sequence[Candidate],
    corrected: LookElsewhere,
    threshold: float,
) -> tuple[Candidate, np.ndarray] | None:
    """Return the most significant candidate at the scales beside it, and the root of the weights there, (R,).

    None where none is below the threshold.

    Parameters
    ----------
    projection, prepared, candidates : as screened at the scales of the fit.
    """
    least, most = thresholds.BOTH_STRATA_SHARE, 1 - thresholds.BOTH_STRATA_SHARE
    likely = [
        each
        for each in candidates
        if least < each.score.within_runs < most and corrected(each.p) < thresholds.SCALES_BESIDE_P
    ][: thresholds.SCALES_BESIDE_MOST]
    if not likely:
        return None
    floor = noise_of_run_means(projection)
    found = [at_scales_beside(projection, *response_of(prepared, each), floor) for each in likely]
    best = min((each for each in found if each[0].plausible), key=lambda each: each[0].p, default=None)
    if best is None or corrected(best[0].p) >= thresholds.SECOND_LOOK * threshold:
        return None
    return best


def at_scales_beside(
    projection: Projection, response: ProjectedResponse, chosen: np.ndarray, floor: tuple[np.ndarray, np.ndarray]
) -> tuple[Candidate, np.ndarray]:
    """Return a candidate with the chosen coefficients at the scales beside it, and the root of the weights, (R,).

    Parameters
    ----------
    floor : of the variance of each stratum: a share of that of another, see `noise_of_run_means`.
    """
    scale, judged = np.ones(len(projection.freedom)), projection.freedom >= thresholds.FREEDOM_TO_JUDGE
    # A few run means may agree by chance to better than the noise of their rows allows.
    within, share = floor
    root, now = np.ones(len(projection.residual)), assess(projection, response, chosen)
    for _ in range(thresholds.SCALE_STEPS):
        scale = np.where(judged, scale * now.score.variance, 1.0)
        root = 1 / np.sqrt(projection.strata.at_rows(scale))
        at = projection.reweighted(root)
        now = assess(at, response.reweighted(at, root), chosen, share * scale[within] / scale)
    return now, root

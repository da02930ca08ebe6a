"""Pictures of a result, one call each: `figure = residual_figure(residuals, "table_rate")`."""

from imubayes.display.figures.measurement import measurement_figure
from imubayes.display.figures.posterior import corner_figure, identifiability_figure
from imubayes.display.figures.prior_posterior import prior_posterior_figure, temperature_figure, thermal_courses
from imubayes.display.figures.residual import residual_figure, run_chi2_figure
from imubayes.display.figures.setup import campaign_timeline_figure, mounted_pairs, mounting_sketch_figure

__all__ = [
    "campaign_timeline_figure",
    "corner_figure",
    "identifiability_figure",
    "measurement_figure",
    "mounted_pairs",
    "mounting_sketch_figure",
    "prior_posterior_figure",
    "residual_figure",
    "run_chi2_figure",
    "temperature_figure",
    "thermal_courses",
]

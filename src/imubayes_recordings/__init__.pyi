from .api.capture import Captured, capture
from .api.new_campaign import NewCampaign, new
from .display.kalibr_noise import KALIBR_NAMES, density_lines, yaml_number, yaml_row
from .noise_analysis.allan_deviation import allan_variance
from .noise_analysis.noise_record import NoiseDensity, StaticNoise, of_record, static_noise
from .noise_analysis.running_sum import from_samples

__all__ = [
    "KALIBR_NAMES",
    "Captured",
    "NewCampaign",
    "NoiseDensity",
    "StaticNoise",
    "allan_variance",
    "capture",
    "density_lines",
    "from_samples",
    "new",
    "of_record",
    "static_noise",
    "yaml_number",
    "yaml_row",
]

"""Reduction of raw logs to rows: means over the spans of constant stimulus.

A log is streamed twice.  The first pass summarises short blocks (`block_survey`), from which the levels of the stimulus
are detected (`stimulus_levels`) and the spans in which the outputs are steady (`settling`, `constant_spans`), or takes
the spans from the segment column (`segment_labels`).  The second pass averages each span exactly (`span_means`); means
with clipped samples are left out (`clipping`).  Memory does not grow with the length of the log.
"""

from imubayes.campaign.reduction.block_survey import BlockBuilder, BlockSurvey, sampling_interval
from imubayes.campaign.reduction.clipping import Limits, clipping_note
from imubayes.campaign.reduction.constant_spans import BenchSettings, Span, UnsettledLevel, constant_spans
from imubayes.campaign.reduction.log_reduction import Rows, reduce_log
from imubayes.campaign.reduction.segment_labels import SegmentTracker

__all__ = [
    "BenchSettings",
    "BlockBuilder",
    "BlockSurvey",
    "Limits",
    "Rows",
    "SegmentTracker",
    "Span",
    "UnsettledLevel",
    "clipping_note",
    "constant_spans",
    "reduce_log",
    "sampling_interval",
]

"""Reduction of raw logs to rows: means over the spans of constant stimulus.

A log is streamed twice.  The first pass summarises short blocks (`log_survey`), from which the levels of the stimulus
and the spans in which the outputs are steady are detected (`constant_spans`), or takes the spans from the segment
column (`log_reduction`).  The second pass averages each span exactly (`span_means`); means with clipped samples are
left out.  Memory does not grow with the length of the log.
"""

from imubayes.campaign.equipment import BenchSettings
from imubayes.campaign.reduction.by_hand import reduce_by_hand
from imubayes.campaign.reduction.clock_offset import clock_offset
from imubayes.campaign.reduction.constant_spans import Span, UnsettledLevel, constant_spans
from imubayes.campaign.reduction.log_reduction import Limits, Rows, SegmentTracker, clipping_note, reduce_log
from imubayes.campaign.reduction.log_survey import BlockBuilder, BlockSurvey, turning_span
from imubayes.campaign.sampling_rate import refuse_impossible_rate, sampling_interval

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
    "clock_offset",
    "constant_spans",
    "reduce_by_hand",
    "reduce_log",
    "refuse_impossible_rate",
    "sampling_interval",
    "turning_span",
]

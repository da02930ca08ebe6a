"""Raw logs become rows: means over the spans in which the stimulus was constant.

A log is read twice as a stream.  The first pass summarises short blocks (`blocks`), from which the spans of
constant rate, angle and rest are recognised (`detect`), or takes them from the segment column (`segments`).
The second pass sums each span exactly (`accumulate`).  Memory does not grow with the length of the log.
"""

from imubayes.campaign.reduction.block_survey import BlockBuilder, BlockSurvey, sampling_interval
from imubayes.campaign.reduction.constant_spans import Span, constant_spans
from imubayes.campaign.reduction.log_reduction import BINNED, Rows, reduce_log
from imubayes.campaign.reduction.segment_labels import SegmentTracker

__all__ = [
    "BINNED",
    "BlockBuilder",
    "BlockSurvey",
    "Rows",
    "SegmentTracker",
    "Span",
    "constant_spans",
    "reduce_log",
    "sampling_interval",
]

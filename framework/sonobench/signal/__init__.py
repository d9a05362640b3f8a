"""Framing, correlation, peaks and steered power: signal maths that front ends share, bundled or not."""

from sonobench.signal.coherence import check_exponent, coherence, phases, raised, snr_exponent
from sonobench.signal.correlation import TablePlan, correlations, cross_spectra, plan_tables, weighed, whitened
from sonobench.signal.framing import GROUP, Frames, Framing, Tail, WindowName, drain, empty_tail, framing, mean_square, push, window
from sonobench.signal.peaks import local_maxima, pick, refine
from sonobench.signal.rig import Rig, pair_sensors, rig, stack_sensor, widened
from sonobench.signal.search import Picked, Search, open_search
from sonobench.signal.steering import Steering, grid, steered_power, steering
from sonobench.signal.stream import StreamState, TableFrame, TableStream, open_stream

__all__ = [
    "GROUP",
    "Frames",
    "Framing",
    "Picked",
    "Rig",
    "Search",
    "Steering",
    "StreamState",
    "TableFrame",
    "TablePlan",
    "TableStream",
    "Tail",
    "WindowName",
    "check_exponent",
    "coherence",
    "correlations",
    "cross_spectra",
    "drain",
    "empty_tail",
    "framing",
    "grid",
    "local_maxima",
    "mean_square",
    "open_search",
    "open_stream",
    "pair_sensors",
    "phases",
    "pick",
    "plan_tables",
    "push",
    "raised",
    "refine",
    "rig",
    "snr_exponent",
    "stack_sensor",
    "steered_power",
    "steering",
    "weighed",
    "whitened",
    "widened",
    "window",
]

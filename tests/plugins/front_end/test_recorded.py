import numpy as np
import pytest
from signal_sounds import WALL_PAIRS, WALLS_M, header

from sonobench import Detections, Header, Scan, SetupError
from sonobench_plugins.front_end.gcc_peaks import GccPeaks
from sonobench_plugins.front_end.recorded import Recorded


def test_scans_pass_as_they_are():
    sensors = GccPeaks().open(header(WALLS_M, WALL_PAIRS))[0].sensors
    setup, state = Recorded().open(Header("r", (), np.eye(4)[None], sensors, ("a",), period_s=0.1, nominal={"p_d": 0.9}))
    assert (setup.sensors, setup.period_s, dict(setup.nominal)) == (sensors, 0.1, {"p_d": 0.9})
    scan = Scan(0.1, np.ones(4, bool), (Detections(np.zeros((1, 1)), np.zeros(1, int)),))
    state, out = Recorded().step(state, scan)
    assert out[0] is scan
    assert Recorded().flush(state) == []


def test_a_recording_of_samples_names_both_sides():
    with pytest.raises(SetupError, match=r"recorded reads measurement scans; recording test has none.*samples of \['a'\]"):
        Recorded().open(header(WALLS_M, WALL_PAIRS))

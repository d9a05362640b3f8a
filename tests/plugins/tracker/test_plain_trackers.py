import numpy as np
import phd_scenes as scenes
import pytest

from sonobench.errors import SetupError
from sonobench.protocols import Tracker
from sonobench_plugins.tracker.nobody import Nobody
from sonobench_plugins.tracker.room_centre import RoomCentre


def test_nobody_reports_nobody_after_every_scan():
    frames = scenes.scans(np.random.default_rng(0))[:3]
    assert isinstance(Nobody(), Tracker)
    assert [(e.time_s, e.states.shape) for e in scenes.run(Nobody(), scenes.setup(), frames)] == [(f.time_s, (0, 2)) for f in frames]


def test_room_centre_reports_the_middle_of_the_box():
    assert isinstance(RoomCentre(), Tracker)
    (estimate,) = scenes.run(RoomCentre(), scenes.setup(), scenes.scans(np.random.default_rng(0))[:1])
    np.testing.assert_array_equal(estimate.states, [[1.5, 1.5]])
    with pytest.raises(SetupError, match="needs the room's box"):
        RoomCentre().init(np.random.default_rng(0), scenes.setup(box_m=None))

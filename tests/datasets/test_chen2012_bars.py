"""What the bundled studies of Chen, Chen, Yin & Hou 2012 show over all their paired runs; half an hour on two quiet cores."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pandas as pd
import pytest
from chen2012_runs import ARE, FULL, measured

pytestmark = [pytest.mark.study, pytest.mark.xdist_group("chen2012")]
RUNS = 100
LITERAL = ("ek-phd", "uk-phd", "ck-phd")
Means = Callable[[str], pd.DataFrame]


@pytest.fixture(scope="module")
def means(tmp_path_factory: pytest.TempPathFactory) -> Means:
    """Means by swept value (rows), and by score and pipeline (columns), of a study that runs once."""
    folder, known = tmp_path_factory.mktemp("chen2012"), dict[str, pd.DataFrame]()

    def of(name: str) -> pd.DataFrame:
        if name not in known:
            known[name] = measured(name, folder, RUNS).groupby("at").mean()
            print(f"\n{name}, {RUNS} runs\n{known[name].round(4).to_string()}")
        return known[name]

    return of


@pytest.mark.parametrize("pipeline", LITERAL)
def test_paper_mode_reaches_the_level_of_tables_2_and_3(means: Means, pipeline: str) -> None:
    full, are = means("chen2012-snr")[FULL, pipeline], means("chen2012-snr")[ARE, pipeline]
    assert full[55e-6] == pytest.approx(0.582, abs=0.015)
    assert are[55e-6] == pytest.approx(0.039, abs=0.010)
    assert full[125e-6] == pytest.approx(0.884, abs=0.020)
    assert are[125e-6] == pytest.approx(0.302, abs=0.030)
    assert full[390e-6] == pytest.approx(1.342, abs=0.010)
    assert are[390e-6] == pytest.approx(2.23, abs=0.08)
    for delay_std_s in (1250e-6, 3900e-6):
        assert 1.38 <= full[delay_std_s] <= 1.45
        assert are[delay_std_s] == pytest.approx(2.55, abs=0.08)


@pytest.mark.parametrize(("name", "sign"), [("chen2012-snr", 1), ("chen2012-p-d", -1), ("chen2012-clutter", 1), ("chen2012-period", 1)])
def test_the_error_grows_with_what_makes_the_scene_harder(means: Means, name: str, sign: int) -> None:
    for pipeline in LITERAL:
        full = means(name)[FULL, pipeline].sort_index()
        assert (sign * np.diff(full) > 0).all(), full


def test_the_count_grows_with_the_error_of_the_delays_from_15_db_up(means: Means) -> None:
    for pipeline in LITERAL:
        are = means("chen2012-snr")[ARE, pipeline].sort_index()
        assert (np.diff(are[are.index <= 1250e-6]) > 0).all(), are


def test_the_linearised_filter_is_level_with_the_cubature_filter_in_the_papers_scene(means: Means) -> None:
    mean = means("chen2012-time").iloc[0]
    assert abs(mean[FULL, "ek-phd"] - mean[FULL, "ck-phd"]) < 0.005
    assert abs(mean[FULL, "uk-phd"] - mean[FULL, "ck-phd"]) < 0.005


def test_the_linearised_filter_is_worse_where_births_are_as_wide_as_the_room(means: Means) -> None:
    mean = means("chen2012-room-births")[FULL]
    assert (mean["ek-room"] - mean["ck-room"] > 0.02).all(), mean


def test_the_consistent_intensity_is_far_better_at_25_db(means: Means) -> None:
    mean = means("chen2012-time").iloc[0]
    for pipeline in ("ek-corrected", "uk-corrected", "ck-corrected"):
        assert mean[FULL, pipeline] <= 0.74
        assert mean[ARE, pipeline] <= 0.06


def test_one_pair_after_the_other_is_no_reading_of_the_tables(means: Means) -> None:
    mean = means("chen2012-pairs").iloc[0]
    assert mean[FULL, "ck-pairs"] > means("chen2012-time").iloc[0][FULL, "ck-phd"] + 0.1

"""How often the board is wrong, measured through real run folders; the study's table stands in docs/boards.md.

python -m pytest tests/framework/board/test_simulation.py -m study -s
"""

from __future__ import annotations

import pytest
from board_simulation import LAWS, study


def test_over_ten_normal_scenarios_the_interval_covers_and_letters_seldom_separate_equals(tmp_path):
    found = study(tmp_path, "normal", 10, 200)
    assert 0.90 <= found.coverage <= 0.985  # three standard errors of 200 draws
    assert 0.90 <= found.mean_coverage <= 0.985
    assert found.false_alarms <= 0.10


@pytest.mark.study
@pytest.mark.parametrize("scenarios", [10, 24])
@pytest.mark.parametrize("law", LAWS)
def test_the_simulations_of_the_docs(tmp_path, law, scenarios):
    found = study(tmp_path, law, scenarios, 2000)
    cells = [law, scenarios, *(f"{100 * share:.1f} %" for share in found[1:])]
    print("\n| " + " | ".join(map(str, cells)) + " |")
    if law == "normal":
        assert 0.93 <= found.coverage <= 0.97
        assert 0.93 <= found.mean_coverage <= 0.97
        assert found.false_alarms <= 0.06
    if law == "strongly skewed (log-normal)":
        assert found.warned_skew > 0.3

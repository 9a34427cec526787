"""An axis of mismatch is said once, where it is declared: everything else follows from that."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from mjmerge.config.acts import EVERY
from mjmerge.scenario.axis import SIZES, axes
from mjmerge.scenario.axis_tables import markdown, where_markdown
from mjmerge.scenario.levels import LEVELS, NAMES
from mjmerge.scenario.mismatch import SENSING, Mismatch

PAGE = Path(__file__).parents[2] / "docs" / "mismatch.md"
AXES = axes(Mismatch)
NOTHING = Mismatch()


def test_every_key_of_a_mismatch_is_an_axis():
    assert list(AXES) == list(Mismatch.model_fields)


@pytest.mark.parametrize("name", AXES)
def test_an_axis_says_all_there_is_to_know(name):
    axis = AXES[name]
    assert axis.changes
    assert axis.source
    assert set(axis.on) <= set(EVERY)
    assert (axis.rc is None) == (axis.full is None), "levels are for both sizes"
    if axis.rc is None:
        assert "goes with `" in axis.source or "no level" in axis.source


def test_what_the_ego_measures_stands_last():
    assert tuple(AXES)[-len(SENSING) :] == SENSING


@pytest.mark.parametrize("size", SIZES)
def test_levels_get_worse_one_by_one_and_a_scenario_accepts_them(size):
    assert LEVELS[size].keys() == {name for name, axis in AXES.items() if axis.rc is not None}
    for name, levels in LEVELS[size].items():
        assert len(levels) == len(NAMES)
        assert all(getattr(Mismatch(**level), name) != getattr(NOTHING, name) for level in levels), name
        values = [level[name] for level in levels]
        if isinstance(values[0], str):
            continue
        start = [getattr(NOTHING, name)] * isinstance(getattr(NOTHING, name), float)
        steps = np.diff([*start, *values])
        assert (steps >= 0).all() or (steps <= 0).all(), name


def test_the_tables_of_the_page_are_the_declarations(written):
    page = PAGE.read_text(encoding="utf-8")
    for mark, table in (("axes", markdown), ("where", where_markdown)):
        begin, end = f"<!-- {mark} -->\n\n", f"\n<!-- /{mark} -->"
        before, _, rest = page.partition(begin)
        _, _, after = rest.partition(end)
        assert after
        page = before + begin + table(Mismatch) + end + after
    written(PAGE, page)

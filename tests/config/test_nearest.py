"""What a name that is none could have meant: a slip of the pen first, then whatever has all of its words."""

import pytest

from mjmerge.errors import nearest

AXES = (
    "command_delay_s", "sensing_delay_s", "leader_acceleration_delay_s", "drive_lag_s", "friction", "load_kg",
    "patch_friction",
)  # fmt: skip


@pytest.mark.parametrize(
    ("name", "meant"),
    [
        ("delay", ["command_delay_s", "leader_acceleration_delay_s", "sensing_delay_s"]),
        ("sensing delay", ["sensing_delay_s"]),
        ("delay-sensing", ["sensing_delay_s"]),
        ("frictoin", ["friction"]),
        ("comand_delay_s", ["command_delay_s"]),
        ("load", ["load_kg"]),
        ("drive_lagg", ["drive_lag_s"]),
    ],
)
def test_a_misspelt_name_comes_first_and_then_names_with_all_of_its_words(name, meant):
    assert nearest(name, AXES) == f"did you mean {' or '.join(map(repr, meant))}?"


def test_a_word_that_is_in_too_many_names_means_none_of_them():
    names = [f"{n}_m" for n in "abcdefgh"]
    assert nearest("m", names).startswith("valid names: ")


def test_nothing_is_like_anything_where_there_is_nothing():
    assert nearest("a", ()) == "there are none"

"""What a name that is none could have meant: a slip of the pen first, then whatever has all of its words."""

import pytest

from mjmerge.errors import ScenarioError, nearest
from mjmerge.scenario.load import load

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


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("friction=0.3", "friction: unknown key; did you mean 'mismatch.friction'?"),
        ("k_o=1", "k_o: unknown key; did you mean 'law.k_o'?"),
        ("mismatch.k_o=1", "mismatch.k_o: unknown key; did you mean 'law.k_o'?"),
        ("gap_m=1", "did you mean 'drivers.vehicle_1.gap_m' or 'drivers.vehicle_2.gap_m'?"),
        ("drivers.vehicle_1.gap_m=1", "unknown key; valid names: gain_per_s, kind, speed_mps"),
        ("law.k_0=1", "law.k_0: unknown key; did you mean 'k_o' or"),
    ],
)
def test_a_key_in_the_wrong_place_is_told_where_it_belongs(given, says):
    with pytest.raises(ScenarioError) as refused:
        load("charge", [given])
    assert says in str(refused.value)


def test_a_key_that_another_law_has_is_answered_with_those_of_this_one():
    with pytest.raises(ScenarioError, match=r"law\.k_o: unknown key; did you mean 'k_p' or 'k_v'\?"):
        load("charge", ["law.kind=mpc", "law.k_o=2"])

"""Does a run folder say the truth about itself? Each recording, and every other file against the first."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

from mjmerge.errors import UnreadableError
from mjmerge.outputs import PARTIAL
from mjmerge.record import content
from mjmerge.record.content import ContentError
from mjmerge.record.manifest import EXPLANATION
from mjmerge.record.read import recording
from mjmerge.review.check import Check, checked, differing, some
from mjmerge.review.claims import what_follows
from mjmerge.review.verify import Verified, verify
from mjmerge.verdict.judge import VERDICTS

_RELATIVE = 1e-9
_OTHERS = ("run.*", "median.rrd", "violation-*.rrd")
_OF_ALL = ("verdict", "reason", "verdicts", "floor_held", "floor_held_runs", "collisions", "stops")
"""What a summary of several simulations says of all of them; the rest is of the worst, which is recorded."""
_OUTSIDE = ("real_time_factor", "run_dir", "versions")
"""What two equal runs differ in."""


def verify_run(folder: Path) -> Verified:
    """Checks what a run left: its first recording, and against that all other files of the folder.

    The comparison beside the ideal and the figure are not looked at.

    Raises:
        UnreadableError: there is no recording in it, or one that does not even say what the run was.
    """
    first = verify(recording(folder))
    checks = [*_other_recordings(first.recorded.path.parent, first), *beside(first)]
    last = [check for check in first.checks if check.name == "not derived"]
    return replace(first, checks=(*(c for c in first.checks if c not in last), *checks, *last))


def beside(first: Verified) -> Iterator[Check]:
    """The files beside a recording that are no recordings, against it."""
    folder = first.recorded.path.parent
    yield from _texts(folder, first)
    yield from _explanation(folder, first)
    if first.verdict is not None:
        yield _summary(folder, first)


def _other_recordings(folder: Path, first: Verified) -> Iterator[Check]:
    """Each other recording is right; that of the same simulation is equal, another one's is another seed."""
    for path in sorted({path for pattern in _OTHERS for path in folder.glob(pattern)}):
        if path == first.recorded.path or path.suffix not in (".mcap", ".rrd", PARTIAL):
            continue
        try:
            other = verify(path)
        except UnreadableError as error:
            yield Check(path.name, False, error.why)
            continue
        wrong = [f"{c.name}: {c.says}" for c in other.checks if c.right is False]
        same = path.name.startswith("run.")
        wrong += [f"{text}, unlike {first.recorded.path.name}" for text in _unlike(first, other, same)]
        says = f"right, and equal to {first.recorded.path.name}" if same else "right, of another seed"
        yield checked(path.name, wrong, says)


def _unlike(first: Verified, other: Verified, same: bool) -> Iterator[str]:
    """How two recordings of a folder contradict each other."""
    one, two = first.recorded, other.recorded
    if one.scenario_yaml != two.scenario_yaml:
        yield "it has another scenario"
    if one.world_xml != two.world_xml:
        yield "it has another world"
    if (one.manifest["seed"] == two.manifest["seed"]) != same:
        yield f"it has the seed {two.manifest['seed']}"
    if same and one.explanation != two.explanation and None not in (one.explanation, two.explanation):
        yield "it is explained otherwise"
    if same and len(one.ticks) == len(two.ticks):
        names = sorted(one.columns.keys() | two.columns.keys())
        differ = [
            name
            for name in names
            if name not in one.columns
            or name not in two.columns
            or one.columns[name].tobytes() != two.columns[name].tobytes()
        ]
        if differ:
            yield f"it has other numbers in {some(differ)}"
    elif same:
        yield f"it has {len(two.ticks)} ticks, not {len(one.ticks)}"


def _texts(folder: Path, first: Verified) -> Iterator[Check]:
    """The scenario and the world beside a recording are those in it."""
    physical = first.recorded.manifest.get("plant") == "mujoco"
    for name, there in (
        ("scenario.yaml", first.recorded.scenario_yaml),
        ("world.xml", first.recorded.world_xml),
    ):
        if name == "world.xml" and not physical and not (folder / name).exists():
            continue
        try:
            said = (folder / name).read_text(encoding="utf-8")
        except (OSError, UnicodeDecodeError) as error:
            why = "not there" if isinstance(error, FileNotFoundError) else f"cannot be read: {error}"
            yield Check(name, False, why)
            continue
        wrong = [] if said == there else [f"another than the one in {first.recorded.path.name}"]
        yield checked(name, wrong, f"as in {first.recorded.path.name}")


def _explanation(folder: Path, first: Verified) -> Iterator[Check]:
    """Why it fails is as in the recording; nothing where neither says."""
    path, there = folder / EXPLANATION, first.recorded.explanation
    if not path.exists():
        if there is not None:
            yield Check(path.name, False, "not there")
        return
    try:
        claimed = content.explanation_of(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, ContentError) as error:
        yield Check(path.name, False, str(error))
        return
    wrong = [] if claimed == there else [f"another than the one in {first.recorded.path.name}"]
    yield checked(path.name, wrong, f"as in {first.recorded.path.name}")


def _summary(folder: Path, first: Verified) -> Check:
    """Every number of the summary follows from the recording, or, of many runs, from the rest of it."""
    path = folder / "summary.json"
    if not path.exists():
        return Check(path.name, False, "not there: the run did not end")
    try:
        claimed = content.json_of(path.read_text(encoding="utf-8"), path.name)
    except (OSError, UnicodeDecodeError, ContentError) as error:
        return Check(path.name, False, str(error))
    if not isinstance(claimed, dict):
        return Check(path.name, False, "it is not a mapping")
    assert first.verdict is not None
    expected = what_follows(first.recorded, first.recorded.trace(), first.verdict)
    runs = claimed.get("runs")
    if type(runs) is not int or runs < 1:
        return Check(path.name, False, f"runs: {runs!r} is no number of runs")
    wrong = list(_many(claimed, expected, runs)) if runs > 1 else []
    of_all = {"runs", "seed", "distinct_runs", *_OF_ALL, "min_distance_m", "min_clearance_m", "duration_s"}
    of_all |= {"metrics_range", "metrics_bounds", "metrics_held"}
    left_out = of_all if runs > 1 else set()
    for key in sorted((expected.keys() | claimed.keys()) - left_out - {*_OUTSIDE}):
        if key not in expected:
            wrong.append(f"{key}: nobody writes that")
        elif key not in claimed:
            wrong.append(f"{key}: not in it")
        else:
            wrong += differing(key, claimed[key], expected[key], _RELATIVE, "the recording says")
    says = "every number follows from the recording"
    if runs > 1:
        says = f"as the worst run's recording says; of the {runs - 1} others what they came to is not derived"
    if "metrics" in expected:
        says += "; its own metrics are as the recording says"
    return checked(path.name, wrong, says)


def _many(claimed: dict[str, Any], worst: dict[str, Any], runs: int) -> Iterator[str]:
    """What the summary of several simulations says of them all, against the worst's and against itself."""
    missing = [key for key in ("seed", *_OF_ALL, "min_distance_m", "min_clearance_m") if key not in claimed]
    if missing:
        yield f"{some(missing)}: not in it"
        return
    seed, own = claimed["seed"], worst["seed"]
    if type(seed) is not int or not seed <= own < seed + runs:
        yield f"seed: it says {seed!r}, and the worst of {runs} is {own}"
    counts = claimed["verdicts"]
    numbers = isinstance(counts, dict) and all(type(n) is int and n > 0 for n in counts.values())
    if not numbers or not set(counts) <= set(VERDICTS) or sum(counts.values()) != runs:
        yield f"verdicts: not those of {runs} runs"
    else:
        if claimed["verdict"] != max(counts, key=VERDICTS.index):
            yield f"verdict: it says {claimed['verdict']!r}, and its verdicts are {counts}"
        if worst["verdict"] not in counts:
            yield f"verdicts: none is {worst['verdict']!r}, which the worst run is"
    held = claimed["floor_held_runs"]
    if type(held) is not int or not 0 <= held <= runs or claimed["floor_held"] is not (held == runs):
        yield f"floor_held: it says {claimed['floor_held']!r}, held in {held!r} of {runs} runs"
    elif not worst["floor_held"] and held == runs:
        yield "floor_held: it is, and the worst run's is not"
    distances = claimed["min_distance_m"]
    least = [d for d in worst["min_distance_m"].values() if d is not None]
    said = [d for d in distances.values() if d is not None] if isinstance(distances, dict) else []
    if len(said) < len(least) or (least and min(said) != min(least)):
        yield f"min_distance_m: it says {distances}, and the worst run's least is {min(least)}"
    if "metrics" in worst:
        yield from _many_metrics(claimed, worst, runs)
    for key in ("collisions", "stops"):
        ours = [dict(c) for c in worst[key]]
        there = (
            [c for c in claimed[key] if isinstance(c, dict) and c.get("seed") == own]
            if isinstance(claimed[key], list)
            else []
        )
        yield from differing(key, there, ours, _RELATIVE, "the recording says")


def _many_metrics(claimed: dict[str, Any], worst: dict[str, Any], runs: int) -> Iterator[str]:
    """What the summary of several simulations says of its own metrics, against the worst's and itself."""
    ranges = claimed.get("metrics_range")
    if not isinstance(ranges, dict) or ranges.keys() != worst["metrics"].keys():
        yield "metrics_range: not that of the scenario's metrics"
        return
    for name, value in worst["metrics"].items():
        said = ranges[name] if isinstance(ranges[name], dict) else {}
        least, most, unknown = (said.get(key) for key in ("least", "most", "unknown"))
        right = type(unknown) is int and (value is None) <= unknown <= runs - (value is not None)
        if value is not None:
            right = (
                right and all(isinstance(v, int | float) for v in (least, most)) and least <= value <= most
            )
        if not right:
            yield f"metrics_range.{name}: it says {said}, and the worst run's is {value}"
    bounds = claimed.get("metrics_bounds", {})
    ours = worst.get("metrics_bounds", {})
    if not isinstance(bounds, dict) or bounds.keys() != ours.keys():
        yield "metrics_bounds: not those of the scenario"
        return
    held = []
    for name, bound in ours.items():
        said = bounds[name] if isinstance(bounds[name], dict) else {}
        count = said.get("held_runs")
        sides = all(said.get(key) == bound[key] for key in ("at_least", "at_most"))
        if not (
            sides and type(count) is int and bound["held_runs"] <= count <= runs - 1 + bound["held_runs"]
        ):
            yield f"metrics_bounds.{name}: it says {said}, and the worst run's is {bound}"
        held.append(count == runs)
        if (said.get("first_broken_seed") is None) != held[-1]:
            yield f"metrics_bounds.{name}: it held in {count} of {runs} runs, or did not"
    if ours and claimed.get("metrics_held") is not all(held):
        yield f"metrics_held: it says {claimed.get('metrics_held')!r}"

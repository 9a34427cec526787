"""What a person gets from a file of traffic: scenarios, figures, and a report of the law beside the human."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from mjmerge.config.document import is_text
from mjmerge.figures.overview import ran
from mjmerge.figures.style import COLOURS, LINE, End, ends, head, save, sheet
from mjmerge.merges.event import GENTLE_MPS2
from mjmerge.merges.judged import Merge, Merges, as_json
from mjmerge.merges.margins import Margins
from mjmerge.merges.scenario import CARS, written
from mjmerge.outputs import put
from mjmerge.roster import colour
from mjmerge.state import Array
from mjmerge.sweep.report import markdown_table

if TYPE_CHECKING:
    from matplotlib.figure import Figure

FILES = ("car-*.yaml", "car-*.png", "report.md", "traffic.json")
"""What its folder may hold; ``traffic.json`` is written last."""
_HUMAN = "#555555"
_COLUMNS = (
    "least d_1",
    "least d_2",
    "bumper gap ahead",
    "behind",
    "time gap ahead",
    "behind",
    "TTC ahead",
    "behind",
    "in lane at",
    "peak acceleration",
)


def write(found: Merges, folder: Path) -> None:
    """All files; the folder is there."""
    for one in found.merges:
        put(folder / f"{one.event.name}.yaml", written(one.keys))
        save(figure(one), folder / f"{one.event.name}.png")
    put(folder / "report.md", "\n".join(lines(found)) + "\n")
    put(folder / "traffic.json", json.dumps(as_json(found, str(folder)), indent=2) + "\n")


def sentence(found: Merges) -> str:
    """What became of the file, in a line: its counts add up."""
    as_recorded = [one for one in found.merges if not one.event.step]
    users, tracks = found.traffic.road_users, len(found.traffic.tracks)
    unused = f", {users - tracks} of no use" if users > tracks else ""
    return (
        f"{users} road users: {tracks} tracks{unused}; {found.changes} lane changes: "
        f"{len(as_recorded)} make scenarios, {found.changes - len(as_recorded)} do not"
    )


def lines(found: Merges) -> Iterator[str]:
    """The report, in Markdown."""
    yield f"# Lane changes of {_plain(found.traffic.path.name)}"
    yield ""
    yield f"{found.traffic.format}, a state every {found.traffic.step_s:g} s. {sentence(found)}."
    yield ""
    yield (
        f"In each the law takes the place of the human, on {found.plant}. Leader and follower drive as they "
        "were recorded: the follower may have made room for the human, and does not see the law. All others "
        "are left out."
    )
    yield ""
    if found.merges:
        head = ("scenario", "gap at least", "in r", "Assumption 1", "verdict", "smoothed by at most")
        rows = []
        for one in found.merges:
            least_m = float(one.event.gap_m.min())
            rows.append(
                (
                    one.event.name,
                    f"{least_m:.2f} m",
                    f"{least_m / one.event.r_m:.2f}",
                    "broken" if one.event.breaks else "kept",
                    one.verdict.verdict,
                    f"{one.event.smoothing_m:.2f} m",
                )
            )
        yield from markdown_table(head, rows)
    for one in found.merges:
        yield from _section(one)
    yield "## What makes no scenario"
    yield ""
    yield from [f"- {_plain(one.id)}: {_plain(one.why)}" for one in found.skipped] or ["Nothing."]
    yield ""
    yield "## What was found and put right in the file"
    yield ""
    yield from [f"- {_plain(note)}" for note in found.traffic.notes] or ["Nothing."]


def _section(one: Merge) -> Iterator[str]:
    what = one.event
    yield f"## {what.name}"
    yield ""
    yield f"{_plain(one.scenario.description)} r is {what.r_m:.2f} m."
    if what.breaks:
        yield f"It breaks Assumption 1: {what.breaks}."
    if what.first_mps2 > GENTLE_MPS2:
        yield f"At the start the barrier asks for {what.first_mps2:.1f} m/s²: more than physical cars can do."
    if what.change.between:
        between = ", ".join(_plain(name) for name in what.change.between)
        yield f"Between leader and follower there was also, at some time, {between}: left out."
    yield f"Verdict: **{one.verdict.verdict}**, {_plain(one.verdict.reason)}."
    yield ""
    yield from markdown_table(("", *_COLUMNS), (("human", *_row(one.human)), ("law", *_row(one.law))))
    yield f"![{what.name}]({what.name}.png)"
    yield ""


def _row(of: Margins) -> Iterator[str]:
    two = (of.leader, of.follower)
    yield from (f"{pair.distance_m:.2f} m" for pair in two)
    yield from (_told(pair.bumper_m, "m") for pair in two)
    yield from (_told(pair.time_gap_s, "s") for pair in two)
    yield from (_told(pair.ttc_s, "s") for pair in two)
    yield _told(of.entered_s, "s")
    yield f"{of.peak_mps2:.1f} m/s²"


def _told(value: float | None, unit: str) -> str:
    return "-" if value is None else f"{value:.2f} {unit}"


def _plain(text: str) -> str:
    """What a file says, without what Markdown would read."""
    kept = "".join(c if c.isprintable() else " " for c in text if is_text(c))
    return "".join(f"\\{c}" if c in "\\`*[]<>|#" else c for c in kept)


def figure(one: Merge) -> Figure:
    """The lane change over time, of human and law: along the lane, across it, speeds and distances.

    Along the lane, positions are those that a car of the leader's mean speed would see; bodies are filled,
    lines are front axles.
    """
    what, trace = one.event, one.trace
    drawn, (along, across, speed, distance) = sheet((2.2, 1, 1, 1.2), 10.5)
    t, front = trace.time_s, trace.front_m[0]
    mean_mps = (front[-1, 1, 0] - front[0, 1, 0]) / t[-1] if np.isfinite(front[-1, 1, 0]) else 0.0
    end = what.time_s <= t[-1] + 1e-9
    human_t, human = what.time_s[end], what.front_m[end]
    names: tuple[list[End], ...] = ([], [], [], [])
    for j, car in enumerate(CARS):
        body, own, name = what.bodies[j], colour(car), ("law", "leader", "follower")[j]
        at = front[:, j, 0] - mean_mps * t, front[:, j, 1], _speed(t, front[:, j])
        nose_m = at[0] + body.front_overhang_m
        along.fill_between(t, nose_m - body.length_m, nose_m, color=own, alpha=0.3, linewidth=0)
        for panel, values, names_there in zip((along, across, speed), at, names, strict=False):
            panel.plot(t, values, color=own)
            names_there.append(End(name, values, own))
    at = human[:, 0, 0] - mean_mps * human_t, human[:, 0, 1], _speed(human_t, human[:, 0])
    for panel, values, names_there in zip((along, across, speed), at, names, strict=False):
        panel.plot(human_t, values, color=_HUMAN, linestyle="--")
        names_there.append(End("human", values, _HUMAN))
    across.axhline(what.lane_m / 2, color=LINE, linewidth=0.8)
    names[1].append(End("edge of the new lane", np.array([what.lane_m / 2]), LINE))
    for j, car in enumerate(CARS[1:], 1):
        of_human_m = np.hypot(*(human[:, 0] - human[:, j]).T) - what.r_m
        for of, when, d_m, style in (
            ("law", t, trace.distance_m[0, :, j - 1], "-"),
            ("human", human_t, of_human_m, "--"),
        ):
            distance.plot(when, d_m, color=colour(car), linestyle=style)
            names[3].append(End(f"{of}, $d_{j}$", d_m, colour(car)))
    distance.axhline(0, color=LINE, linewidth=0.8)
    along.set_ylabel(f"along the lane, less {mean_mps:.1f} m/s · t (m)")
    across.set_ylabel("across (m)")
    speed.set_ylabel("speed (m/s)")
    distance.set_ylabel("distance $d_j$ (m)")
    distance.set_xlabel(f"time (s), from {what.from_s:.1f} s of the record")
    for panel, each in zip((along, across, speed, distance), names, strict=True):
        ends(panel, each)
    for margins, own, style in ((one.law, COLOURS["ego"], "-"), (one.human, _HUMAN, "--")):
        if margins.entered_s is not None:
            across.axvline(margins.entered_s, color=own, linewidth=0.8, linestyle=style)
    head(drawn, *ran(trace), f"{one.verdict.verdict}: {one.verdict.reason}")
    return drawn


def _speed(time_s: Array, at_m: Array) -> Array:
    found: Array = np.gradient(at_m[:, 0], time_s)
    return found

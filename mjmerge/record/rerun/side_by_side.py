"""``compare.rrd``: several runs in one scene and in the same plots.

The last one is solid, the others are its ghosts, with hollow discs. ``/<label>/law`` and
``/<label>/car/<car>`` hold the messages of each, ``/world/<label>/...`` what is drawn of it,
``/phases/.../<label>`` and the like its states, ``/events/<label>`` its events, ``/run/report`` the table.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from mjmerge.config.acts import BODIES, EVERY
from mjmerge.errors import OutputError, RecordingError
from mjmerge.record import plots, report
from mjmerge.record.plots import Color, Line, Plot
from mjmerge.record.posed import PosedBlock
from mjmerge.record.recording import Header, Outcome
from mjmerge.record.rerun import layout
from mjmerge.record.rerun.draw import (
    send_discs,
    send_frames,
    send_levels,
    send_numbers,
    still_frames,
    still_levels,
)
from mjmerge.record.rerun.happened import (
    send_events,
    send_marks,
    send_no_contact,
    send_states,
    states_of,
    still_contact,
    still_states,
)
from mjmerge.record.rerun.recorder import CHUNK_TICKS
from mjmerge.record.rerun.stream import new_stream, save
from mjmerge.record.scene import TARGET, Scene
from mjmerge.verdict.metrics import MERGED_M

APPLICATION = "mjmerge_compare"
_PATIENCE_S = 30.0
_GHOST_ALPHA = 0.35
_PALE = 0.55
"""How far the colours of a ghost's lines are towards grey."""
_GREY = 150


@dataclass(frozen=True)
class ShownSide:
    """One of the runs.

    Attributes:
        label: a few words that tell it from the others.
        header: what the run was.
        posed: all of it; ``block.qpos`` may be empty, (T, 0).
        outcome: how it ended; ``None`` if it did not.
    """

    label: str
    header: Header
    posed: PosedBlock
    outcome: Outcome | None


@dataclass(frozen=True)
class _Told:
    """A side, and how it is told."""

    side: ShownSide
    name: str
    scene: Scene
    solid: bool

    def entity(self, frame: str) -> str:
        """Of one of its frames."""
        return layout.entity(frame).replace("/world/", f"/world/{self.name}/", 1)

    def color(self, color: Color) -> Color:
        """Of one of its lines."""
        if self.solid:
            return color
        r, g, b = (round(c + _PALE * (_GREY - c)) for c in color)
        return r, g, b


def write_comparison(path: Path, sides: Sequence[ShownSide]) -> None:
    """Writes a recording with several runs in it; ``<path>.partial`` until it is complete.

    Args:
        path: the file, which must not exist.
        sides: the runs; the last one is drawn solid.

    Raises:
        OutputError: the file exists.
        RecordingError: nothing was written.
    """
    partial_path = path.with_name(path.name + ".partial")
    for there in (path, partial_path):
        if there.exists():
            raise OutputError(f"{there} exists; recordings are not overwritten")
    told = [
        _Told(
            side,
            f"{plots.entity(side.label)}_{k}" if _twice(side, sides) else plots.entity(side.label),
            Scene(side.header.model, side.header.scenario.r_m),
            k == len(sides) - 1,
        )
        for k, side in enumerate(sides)
    ]
    rr.set_strict_mode(True)
    stream = new_stream(APPLICATION)
    save(stream, partial_path, _blueprint(told))
    stream.send_recording_name(_title(sides))
    table = rr.TextDocument(_report(sides), media_type=rr.MediaType.MARKDOWN)
    stream.log("/run/report", table, static=True)
    stream.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    for one in told:
        _tell(stream, one)
    longest = max(sides, key=lambda side: side.posed.time_ns[-1])
    which = _plots(told)
    for entity, style in still_levels(which):
        stream.log(entity, style, static=True)
    send_levels(stream, which, longest.posed.time_ns[[0, -1]])
    stream.flush(timeout_sec=_PATIENCE_S)
    stream.disconnect()
    if not partial_path.is_file():
        raise RecordingError("nothing was written (RERUN=off in the environment does that)")
    partial_path.rename(path)


def _twice(side: ShownSide, sides: Sequence[ShownSide]) -> bool:
    return sum(plots.entity(other.label) == plots.entity(side.label) for other in sides) > 1


def _tell(stream: rr.RecordingStream, told: _Told) -> None:
    """Everything of one side."""
    scene, posed = told.scene, told.side.posed
    if told.solid:
        frames = [replace(f, shapes=()) if f.name == TARGET else f for f in scene.frames]
        drawn = scene.showing(scene.fixed, frames)
    else:
        drawn = scene.showing((), [f.faded(_GHOST_ALPHA) for f in scene.frames])
    scenario, side = told.side.header.scenario, told.side.label
    still = [*still_frames(drawn, told.entity, hollow=not told.solid), *still_states(scenario, side)]
    has_bodies = told.side.header.plant in BODIES
    still += still_contact(scenario.roster, side) if has_bodies else []
    for entity, what in still:
        stream.log(entity, what, static=True)
    send_frames(stream, scene, posed, told.entity)
    before = np.full(posed.shades.shape[1], -1)
    send_discs(stream, scene, posed.time_ns[posed.drawn], posed.shades, before, entity=told.entity)
    if has_bodies:
        send_no_contact(stream, int(posed.time_ns[0]), side=side)
    send_marks(stream, scene, posed.marks, side=side)
    if told.side.outcome is not None:
        send_states(stream, states_of(told.side.outcome), side=side)
        send_events(stream, told.side.outcome, side=side)
    for start in range(0, len(posed.time_ns), CHUNK_TICKS):
        part = slice(start, start + CHUNK_TICKS)
        block = replace(
            posed.block,
            ticks=posed.block.ticks[part],
            time_s=posed.block.time_s[part],
            columns={name: values[part] for name, values in posed.block.columns.items()},
        )
        chunk = replace(posed, block=block, time_ns=posed.time_ns[part])
        send_numbers(stream, chunk, root=f"/{told.name}")


def _plots(told: Sequence[_Told]) -> list[Plot]:
    """The plots of a run, with the lines of every side."""
    scenario, paint = told[-1].side.header.scenario, told[-1].scene.paint
    plant = max((one.side.header.plant for one in told), key=EVERY.index)
    wanted = plots.everything(scenario, paint, plant)
    return [
        replace(plot, lines=tuple(_line(one, of) for of in plot.lines for one in told)) for plot in wanted
    ]


def _line(told: _Told, line: Line) -> Line:
    label = f"{line.label}, {told.side.label}"
    return replace(line, label=label, color=told.color(line.color), topic=f"/{told.name}{line.topic}")


def _blueprint(told: Sequence[_Told]) -> rrb.Blueprint:
    solid = told[-1]
    scenario, camera = solid.side.header.scenario, f"{solid.name}/camera/ego"
    over_s = max(one.side.header.scenario.duration_s for one in told)
    distance, clearance, opinion, *busy = (layout.plot_view(p, over_s) for p in _plots(told))
    finished = any(one.side.outcome is not None for one in told)
    return layout.columns(
        rrb.Vertical(
            rrb.Tabs(*(layout.world_view(n, scenario, camera) for n in ("Chase", "3D")), active_tab=0),
            layout.world_view("From above", scenario, camera),
            row_shares=[3, 2],
        ),
        rrb.Vertical(distance, opinion, rrb.Tabs(clearance, *busy, active_tab=0)),
        rrb.Vertical(
            rrb.Tabs(
                rrb.TextDocumentView(name="Report", origin="/run/report"),
                *([rrb.TextLogView(name="Events", origin="/events")] if finished else []),
            ),
            *layout.state_views(over_s),
            row_shares=[11, 8, 7],
        ),
    )


def _report(sides: Sequence[ShownSide]) -> str:
    """The table, a column per side."""
    summaries = [side.outcome.summary if side.outcome else {} for side in sides]
    rows: list[tuple[str, list[str]]] = [
        ("scenario", [side.header.scenario.name for side in sides]),
        ("plant", [side.header.plant for side in sides]),
        ("seed", [str(side.header.seed) for side in sides]),
        *_given(sides),
        ("verdict", [side.outcome.verdict if side.outcome else "did not finish" for side in sides]),
    ]
    fewest = min((side.header.scenario.roster for side in sides), key=lambda there: len(there.cars))
    for j, car in enumerate(fewest.neighbours):
        least = [float(np.nanmin(side.posed.block.columns["distance_m"][:, j])) for side in sides]
        rows.append((f"min d_{j + 1} ({car.replace('_', ' ')})", [f"{d:.4f} m" for d in least]))
    for key, name, unit in (
        ("min_clearance_m", "body clearance", "m"),
        ("merged_at_s", f"merged (lateral error < {MERGED_M} m)", "s"),
        ("peak_u_c_mps2", "largest barrier command", "m/s²"),
    ):
        rows.append((name, [_number(found.get(key), unit) for found in summaries]))
    head = ["| | " + " | ".join(side.label for side in sides) + " |", "|---|" + "---|" * len(sides)]
    body = [f"| {name} | " + " | ".join(words) + " |" for name, words in rows]
    note = f"*{sides[-1].label}* is solid; the others are ghosts, with hollow discs and greyish lines."
    return "\n".join([f"### {_title(sides)}", "", note, "", *head, *body])


def _title(sides: Sequence[ShownSide]) -> str:
    """What is beside what: the scenario once, where there is one."""
    names = {side.header.scenario.name for side in sides}
    labels = " and ".join(side.label for side in sides)
    (name, *more) = names
    return labels if more or name in labels else f"{name}: {labels}"


def _given(sides: Sequence[ShownSide]) -> Iterator[tuple[str, list[str]]]:
    """Mismatch and settings of each, where one has any."""
    said = [dict(line.split(": ", 1) for line in side.header.ran[1:]) for side in sides]
    for name in ("mismatch", "set"):
        if any(name in one for one in said):
            yield name, [report.cell(one.get(name, "-")) for one in said]


def _number(value: Any, unit: str) -> str:
    return "-" if value is None else f"{value:.3f} {unit}"

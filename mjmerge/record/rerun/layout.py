"""How the Rerun viewer shows a run: three 3D views, plots, states, the report and the events."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import rerun as rr
import rerun.blueprint as rrb
from rerun.blueprint.encodings import ComponentSourceKind, VisualizerComponentMapping

from mjmerge.law.asked import is_name
from mjmerge.record import plots, schema
from mjmerge.record.plots import Line, Plot
from mjmerge.record.rerun import arrow
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array
from mjmerge.verdict.hypotheses import called
from mjmerge.verdict.phases import CONTRACT, NAMES, ROAD, WATCHED

SIM_TIME, MCAP_TIME = "sim_time", "message_log_time"
"""Simulated time in our own files, and in an MCAP as Rerun reads it."""
_TRAIL_S = 4.0
_DECISION_COLORS = [[110, 110, 120], [90, 130, 220], [80, 190, 120]]
_STATE_COLORS = [[60, 110, 75], [235, 140, 50], [220, 50, 50]]
_NO_CONTACT, _CONTACT = [60, 110, 75], [220, 50, 50]
_BACKGROUND = [24, 26, 30]


def entity(frame: str) -> str:
    """Entity of a frame, ``ego/chassis`` to ``/world/ego/chassis``.

    Entities below each other would add up their motions, so what is below a car stays on one level.
    """
    group, _, rest = frame.partition("/")
    return rr.new_entity_path(["world", group, rest or "base"])


def phase_entity(subject: str, side: str = "") -> str:
    """Entity of what changes its state: ``/hypotheses/...`` for those, ``/phases/...`` otherwise.

    Args:
        subject: what does.
        side: which run it is of, where there are several.
    """
    group = "phases" if subject in WATCHED | ROAD else "hypotheses"
    return _of_side(f"/{group}/{subject.replace(' ', '_')}", side)


def contact_entity(side: str = "") -> str:
    """Entity of who has touched whom."""
    return _of_side("/contact", side)


def events_entity(side: str = "") -> str:
    """Entity of what happened."""
    return _of_side("/events", side)


def mark_entity(number: int, side: str = "") -> str:
    """Entity of the mark where bodies touched."""
    return _of_side(f"/world/contact_{number}", side)


def _of_side(entity: str, side: str) -> str:
    return f"{entity}/{plots.entity(side)}" if side else entity


def own_hypothesis(entity: str) -> str | None:
    """The hypothesis of a law's own that such an entity is about; ``None`` for any other entity."""
    name = entity.removeprefix("/hypotheses/")
    return called(name) if name != entity and is_name(name) else None


def state_colors(subject: str) -> list[list[int]]:
    """Of the states of a subject, from the calmest on."""
    colors = _DECISION_COLORS if subject == "decision" else _STATE_COLORS
    return colors[: len(NAMES.get(subject, CONTRACT))]


def contact_colors(count: int) -> list[list[int]]:
    """Of so many states of contact, the first of which is none."""
    return [_NO_CONTACT, *[_CONTACT] * (count - 1)]


def blueprint(
    scenario: Scenario,
    paint: Mapping[str, Array],
    plant: str,
    *,
    timeline: str = SIM_TIME,
    live: bool = False,
) -> rrb.Blueprint:
    """The layout of one run.

    Args:
        scenario: the run's; cameras stand at distances that suit its safety margin.
        paint: colour of each car, 0 to 1.
        plant: what moved the cars.
        timeline: ``SIM_TIME``, or ``MCAP_TIME`` for what Rerun has read itself.
        live: whether the time is that of the newest data.
    """
    over_s = None if live else scenario.duration_s
    return columns(
        rrb.Vertical(
            rrb.Tabs(*(world_view(n, scenario) for n in ("Chase", "3D")), active_tab=0),
            world_view("From above", scenario),
            row_shares=[3, 2],
        ),
        rrb.Vertical(
            *(plot_view(p, over_s) for p in plots.main(scenario, paint, plant)),
            rrb.Tabs(*(plot_view(p, over_s) for p in plots.actuation(scenario, paint, plant)), active_tab=0),
        ),
        rrb.Vertical(
            rrb.Tabs(
                rrb.TextDocumentView(name="Report", origin="/run/report"),
                rrb.TextLogView(name="Events", origin="/events" if timeline == SIM_TIME else "/log"),
                rrb.TextDocumentView(name="Scenario", origin="/run/scenario"),
            ),
            *state_views(over_s),
            row_shares=[11, 6, 9],
        ),
        timeline=timeline,
        live=live,
    )


def state_views(duration_s: float | None = None) -> tuple[rrb.View, rrb.View]:
    """Phases, with who has touched whom; and hypotheses; over all of a run of known length."""
    phases, over = ["/contact/**", "/phases/**"], _whole(duration_s)
    return (
        rrb.StateTimelineView(name="Phases", origin="/", contents=phases, time_view=over),
        rrb.StateTimelineView(
            name="Contract: the theorem's hypotheses", origin="/hypotheses", time_view=over
        ),
    )


def _whole(duration_s: float | None) -> rrb.TimeAxis | None:
    """A time axis from the start to the end of a run; ``None`` for one that goes along with the time."""
    if duration_s is None:
        return None
    start, end = (rrb.TimeRangeBoundary.absolute(seconds=at) for at in (0.0, duration_s))
    return rrb.TimeAxis(view_range=rrb.TimeRange(start, end))


def columns(*parts: rrb.Container, timeline: str = SIM_TIME, live: bool = False) -> rrb.Blueprint:
    """A layout of columns: what is drawn, what is plotted, what is said."""
    return rrb.Blueprint(
        rrb.Horizontal(*parts, column_shares=[4, 3, 3][: len(parts)]),
        rrb.TimePanel(timeline=timeline, state="collapsed", play_state="following" if live else "playing"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )


def world_view(name: str, scenario: Scenario, camera: str = "camera/ego") -> rrb.Spatial3DView:
    """``Chase``, ``3D`` or ``From above``: goes along the road with a camera, some safety margins away."""
    eye, up = {
        "Chase": ((-5.0, 0.0, 3.0), (0, 0, 1)),
        "3D": ((-3.5, -5.0, 3.5), (0, 0, 1)),
        "From above": ((0.0, 0.0, 6.5), (0, 1, 0)),
    }[name]
    r_m = scenario.r_m
    middle_m = (scenario.initial.ego.front_m[1] + scenario.starts[1 + scenario.law.j_1].front_m[1]) / 2
    trail = rrb.VisibleTimeRange(
        SIM_TIME,
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_TRAIL_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    return rrb.Spatial3DView(
        name=name,
        origin=f"/world/{camera}",
        contents="/world/**",
        background=rrb.Background(color=_BACKGROUND),
        line_grid=False,
        eye_controls=rrb.EyeControls3D(
            kind=rrb.Eye3DKind.Orbital,
            position=(eye[0] * r_m, middle_m + eye[1] * r_m, eye[2] * r_m),
            look_target=(0.0, middle_m, 0.0),
            eye_up=up,
        ),
        overrides={"/world/trails": rrb.VisibleTimeRanges([trail])},
    )


def plot_view(plot: Plot, duration_s: float | None = None) -> rrb.TimeSeriesView:
    """A plot of fields of our messages, over all of a run where it is known how long it is."""
    overrides: dict[Any, Any] = {}
    for line in plot.lines:
        overrides.setdefault(line.topic, []).append(_visualizer(line))
    return rrb.TimeSeriesView(
        name=plot.name,
        origin="/",
        contents=[*overrides, *plots.levels([plot])],
        overrides=overrides,
        axis_x=_whole(duration_s),
        plot_legend=rrb.Corner2D.RightTop,
    )


def _visualizer(line: Line) -> Any:
    ends = {schema.LAW_TOPIC: schema.LAW_MESSAGE, schema.SIGNAL_TOPIC: schema.SIGNAL_MESSAGE}
    message = next((m for topic, m in ends.items() if line.topic.endswith(topic)), schema.CAR_MESSAGE)
    source = VisualizerComponentMapping(
        "Scalars:scalars",
        ComponentSourceKind.SourceComponent,
        source_component=arrow.component(message),
        selector=f".{line.field}",
    )
    style = rr.SeriesLines(names=line.label, colors=[line.color], widths=[1.5])
    return style.visualizer(mappings=[source])

"""What happened as Rerun's data: states as they change, events, and where bodies touched.

``side`` is which run it is of, where a recording shows several.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import rerun as rr
from numpy.typing import NDArray

from mjmerge.record.contacts import HEAD, MARK_RGB, NOTHING, PIN_RADIUS_R, Mark, states
from mjmerge.record.recording import Outcome
from mjmerge.record.rerun import layout
from mjmerge.record.scene import Scene
from mjmerge.roster import Roster
from mjmerge.scenario.schema import Scenario
from mjmerge.state import nanoseconds
from mjmerge.verdict import phases
from mjmerge.verdict.metrics import Event

Still = list[tuple[str, rr.AsComponents]]
"""Entities and what never changes of them."""
_LEVELS = {"info": "INFO", "warning": "WARN", "error": "ERROR"}


def times_of(time_ns: NDArray[np.int64], timeline: str = layout.SIM_TIME) -> list[rr.TimeColumn]:
    """Times, ns, (B,), as Rerun wants them."""
    return [rr.TimeColumn(timeline, duration=time_ns.astype("timedelta64[ns]"))]


def send_states(
    stream: rr.RecordingStream,
    changes: Sequence[tuple[int, str, str]],
    timeline: str = layout.SIM_TIME,
    side: str = "",
) -> None:
    """Sends changes of state: time in ns, subject, state; ``side`` is the run, where there are several."""
    for subject in dict.fromkeys((*phases.NAMES, *(about for _, about, _ in changes))):
        mine = [(at, state) for at, about, state in changes if about == subject]
        if mine:
            at = np.array([at for at, _ in mine], np.int64)
            states = rr.StateChange.columns(state=["" if s == phases.ENDED else s for _, s in mine])
            stream.send_columns(layout.phase_entity(subject, side), times_of(at, timeline), states)


def states_of(outcome: Outcome) -> list[tuple[int, str, str]]:
    """Changes of state as :func:`send_states` takes them."""
    return [(int(nanoseconds(p.time_s)), p.subject, p.state) for p in outcome.phases]


def send_events(stream: rr.RecordingStream, outcome: Outcome, side: str = "") -> None:
    """Sends what happened; ``side`` is the run, where there are several."""
    events = outcome.events or [Event(0.0, "info", "", "nothing to report")]  # the view wants an entity
    rows = rr.TextLog.columns(
        text=[f"{e.car}: {e.text}" if e.car else e.text for e in events],
        level=[_LEVELS[e.level] for e in events],
    )
    at = nanoseconds([e.time_s for e in events])
    stream.send_columns(layout.events_entity(side), times_of(at), rows)


def still_states(scenario: Scenario, side: str = "") -> Still:
    """How states are called and coloured; ``side`` is the run, where there are several."""
    return [
        (
            layout.phase_entity(subject, side),
            rr.StateConfiguration(values=list(names), colors=layout.state_colors(subject)),
        )
        for subject, names in phases.names(scenario.law, ends=scenario.road.ends_m is not None).items()
    ]


def send_marks(
    stream: rr.RecordingStream,
    scene: Scene,
    marks: Sequence[Mark],
    timeline: str = layout.SIM_TIME,
    side: str = "",
) -> None:
    """Sends a pin with a label where bodies began to touch, from then on, and whose they were.

    Args:
        stream: where to.
        scene: what the pins stand in.
        marks: the contacts.
        timeline: of their times.
        side: which run they are of, where there are several.
    """
    for mark in marks:
        at = times_of(np.array([mark.time_ns]), timeline)
        foot, head = mark.pin_m(scene.r_m, scene.label_m).tolist()
        radius, said = PIN_RADIUS_R * scene.r_m, mark.collision.sentence
        entity = layout.mark_entity(mark.number, side)
        line = rr.LineStrips3D.columns(strips=[[foot, head]], radii=[radius], colors=[MARK_RGB])
        ball = rr.Points3D.columns(positions=[head], radii=[HEAD * radius], colors=[MARK_RGB])
        stream.send_columns(entity, at, [*line, *ball])
        text, white = f"{side}: {said}" if side else said, (255, 215, 215)
        label = rr.Points3D.columns(positions=[head], radii=[0.0], colors=[white], labels=[text])
        stream.send_columns(f"{entity}/label", at, label)
        stream.send_columns(layout.contact_entity(side), at, rr.StateChange.columns(state=[mark.state]))


def send_no_contact(
    stream: rr.RecordingStream, time_ns: int, timeline: str = layout.SIM_TIME, side: str = ""
) -> None:
    """Sends that no bodies touch yet; the arguments are those of :func:`send_marks`."""
    nothing = rr.StateChange.columns(state=[NOTHING])
    stream.send_columns(layout.contact_entity(side), times_of(np.array([time_ns]), timeline), nothing)


def still_contact(there: Roster, side: str = "") -> Still:
    """How contacts are called and coloured."""
    names = states(there)
    colors = layout.contact_colors(len(names))
    return [(layout.contact_entity(side), rr.StateConfiguration(values=names, colors=colors))]

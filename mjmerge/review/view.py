"""An MCAP as Rerun shows it: the file as Rerun reads it, with our layout and the drawing of its world.

Rerun makes entities of the topics and frames of ``/tf``, but draws no ``/scene``: what is drawn is made again
from the attached MJCF.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import rerun as rr
import rerun.chunk as rc

from mjmerge.config.acts import BODIES
from mjmerge.errors import OutputError, UnreadableError
from mjmerge.record import plots, report
from mjmerge.record.attached import compiled
from mjmerge.record.mcap.reader import sound
from mjmerge.record.mcap.recorder import WORLD
from mjmerge.record.read import read
from mjmerge.record.rerun import layout
from mjmerge.record.rerun.draw import (
    send_arrows,
    send_discs,
    send_levels,
    still_arrows,
    still_frames,
    still_levels,
)
from mjmerge.record.rerun.happened import (
    send_marks,
    send_no_contact,
    send_states,
    still_contact,
    still_states,
    times_of,
)
from mjmerge.record.rerun.stream import new_stream, save
from mjmerge.record.scene import DRAWN_EVERY_S, Scene
from mjmerge.review.poses import touched
from mjmerge.scenario.ran import ran

APPLICATION = "mjmerge_mcap"
_PATIENCE_S = 30.0


def write_view(mcap: Path, rrd: Path) -> None:
    """Writes what the viewer opens for an MCAP.

    Args:
        mcap: the recording.
        rrd: the file to write, which must not exist.

    Raises:
        UnreadableError: it is no recording, or its world does not compile.
        OutputError: the file exists.
    """
    if rrd.exists():
        raise OutputError(f"{rrd} exists; recordings are not overwritten")
    found = read(mcap)
    if not found.columns or not len(found.ticks):
        raise UnreadableError(mcap, "there is not a whole tick in it")
    model = compiled(mcap, found.world_xml)
    scenario = found.scenario()
    scene, plant = Scene(model, scenario.r_m), str(found.manifest["plant"])
    stream = new_stream(APPLICATION)
    blueprint = layout.blueprint(scenario, scene.paint, plant, timeline=layout.MCAP_TIME)
    save(stream, rrd, blueprint)
    said = ran(scenario, plant, int(found.manifest["seed"]), continuous=bool(found.manifest["continuous"]))
    stream.send_recording_name("; ".join(said))
    try:
        with sound(mcap) as readable:
            stream.send_chunks(rc.McapReader(readable, timeline_type="duration_ns").stream())
    except (OSError, ValueError, RuntimeError) as error:
        raise UnreadableError(mcap, "Rerun makes nothing of it") from error
    stream.log("/world", rr.ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
    frames = {layout.entity(frame.name): frame.name for frame in scene.frames}
    for entity, name in frames.items():
        stream.log(entity, rr.CoordinateFrame(name), static=True)
    for entity, what in [*still_frames(scene, layout.entity), *still_arrows(scene)]:
        moves_with = rr.CoordinateFrame(frames.get(entity.rpartition("/")[0], WORLD))
        stream.log(entity, what, moves_with, static=True)
    which = plots.everything(scenario, scene.paint, plant)
    contact = still_contact(found.roster) if plant in BODIES else []
    for entity, what in [*still_states(scenario), *contact, *still_levels(which)]:
        stream.log(entity, what, static=True)
    time = layout.MCAP_TIME
    send_states(stream, found.states, time)
    marks, shades = touched(found, scene.r_m)
    send_discs(stream, scene, found.time_ns, shades, np.full(shades.shape[1], -1), time)
    if plant in BODIES:
        send_no_contact(stream, int(found.time_ns[0]), time)
    send_marks(stream, scene, marks, time)
    for number in {mark.number for mark in marks}:
        for entity in (pin := layout.mark_entity(number), f"{pin}/label"):
            stream.log(entity, rr.CoordinateFrame(WORLD), static=True)
    part = slice(None, None, max(1, round(DRAWN_EVERY_S / found.step_s)))
    columns = {name: values[part] for name, values in found.columns.items()}
    send_arrows(stream, scene, times_of(found.time_ns[part], time), columns)
    for name, text, kind in (
        (
            "report",
            report.of(said, scenario.description, found.summary, found.verdict, found.explanation),
            rr.MediaType.MARKDOWN,
        ),
        ("scenario", found.scenario_yaml, rr.MediaType.TEXT),
    ):
        stream.log(f"/run/{name}", rr.TextDocument(text, media_type=kind), static=True)
    send_levels(stream, which, found.time_ns[[0, -1]], time)
    stream.flush(timeout_sec=_PATIENCE_S)
    stream.disconnect()

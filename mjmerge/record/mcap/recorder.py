"""``run.mcap``: the archive. Foxglove's messages for what it can draw, ours for what we measured.

Topics: ``/law`` (LawState), ``/car/<car>`` (CarState), ``/told`` (ToldState, where the ego was not told the
truth), ``/tf``, ``/scene`` (at t = 0, where a disc changes its colour, and where bodies touch), ``/look/...``
(points, see ``clouds.py``), ``/log``, and ``/phases`` (Log: "subject: state", from here on). All times are
simulated, so that equal runs give equal bytes. A block is one chunk and is on disk once written.
"""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import foxglove
import numpy as np
from foxglove import messages as fox
from foxglove.channels import LogChannel, PointCloudChannel, SceneUpdateChannel
from foxglove.mcap import MCAPWriteOptions
from numpy.typing import NDArray

from mjmerge.record import schema
from mjmerge.record.contacts import CLEAR, DISC_RGBA, HEAD, MARK_RGB, PIN_RADIUS_R, Mark
from mjmerge.record.manifest import CONVENTIONS, EXPLANATION, SCHEMA_VERSION, manifest
from mjmerge.record.mcap import foxglove as foxglove_layout
from mjmerge.record.mcap.clouds import clouds
from mjmerge.record.mcap.wire import Layout
from mjmerge.record.posed import PosedBlock
from mjmerge.record.recording import Header, Outcome
from mjmerge.record.scene import Frame, Scene, Shape
from mjmerge.state import NS_PER_S, Array, nanoseconds

WORLD = "world"
_CHUNK_BYTES = 256 * 1024
_COMPRESSION = 1
"""Of zstd: half the time of its default for 5 % more bytes."""
_LEVELS = {"info": fox.LogLevel.Info, "warning": fox.LogLevel.Warning, "error": fox.LogLevel.Error}


class McapRecorder:
    """Writes an MCAP file."""

    def __init__(self, path: Path, header: Header, scene: Scene) -> None:
        """Args: the file, which must not exist; what is known of the run; what to draw."""
        self._context = foxglove.Context()  # our own: the global one would mix recordings
        self._writer = foxglove.open_mcap(path, context=self._context, writer_options=writer_options())
        self._layouts = {"/tf": _transforms_layout(scene)}
        self._channels = {"/tf": self._channel("/tf", fox.FrameTransforms.get_schema())}
        wire = header.wire
        descriptors = wire.descriptor_set()
        for topic, message in wire.kinds.items():
            self._layouts[topic] = wire.layout(message)
            name = f"{schema.PACKAGE}.{message}"
            described = foxglove.Schema(name=name, encoding="protobuf", data=descriptors)
            self._channels[topic] = self._channel(topic, described)
        self._log = LogChannel("/log", context=self._context)
        self._phases = LogChannel("/phases", context=self._context)

        about = manifest(header)
        self._attach("scenario.yaml", "application/yaml", header.scenario_yaml)
        self._attach("world.xml", "application/xml", header.world_xml)
        self._attach("manifest.json", "application/json", json.dumps(about, indent=2))
        run = {key: str(about[key]) for key in ("scenario", "description", "plant", "seed", "control_step_s")}
        self._writer.write_metadata("mjmerge", {"schema_version": str(SCHEMA_VERSION)} | run | CONVENTIONS)
        self._writer.write_metadata("versions", dict(header.versions))
        self._attach(
            "foxglove.json",
            "application/json",
            foxglove_layout.text(header.scenario, scene.paint, header.plant),
        )
        self._drawing, self._shades = scene, np.full(len(wire.roster.neighbours), CLEAR)
        self._discs_drawn: dict[tuple[int, int], fox.SceneUpdate] = {}
        self._scene = SceneUpdateChannel("/scene", context=self._context)
        self._scene.log(_scene_update(scene), log_time=0)
        for topic, cloud in clouds(scene):
            PointCloudChannel(topic, context=self._context).log(cloud, log_time=0)

    def write(self, posed: PosedBlock) -> None:
        """Adds consecutive ticks, and puts them on disk."""
        self._discs(posed)
        for mark in posed.marks:
            update = fox.SceneUpdate(entities=[_pin(mark, self._drawing)])
            self._scene.log(update, log_time=mark.time_ns)
        poses = np.concatenate([posed.pos_m, np.roll(posed.quat, -1, axis=-1)], axis=-1)  # x y z w
        self._send("/tf", poses.reshape(len(poses), 7 * poses.shape[1]), posed.time_ns[posed.drawn])
        for topic, rows in posed.rows.items():
            self._send(topic, rows, posed.time_ns)
        self._writer.flush()

    def _send(self, topic: str, rows: Array, time_ns: NDArray[np.int64]) -> None:
        """A message per row; one topic after the other compresses better than tick by tick."""
        log = self._channels[topic].base.log  # without a look at what kind of message it is
        for data, at in zip(self._layouts[topic].encode(rows, time_ns), time_ns.tolist(), strict=True):
            log(data, at)

    def _discs(self, posed: PosedBlock) -> None:
        """Draws a disc anew where its colour changes."""
        shades = posed.shades
        if (shades == self._shades).all():
            return
        for f, frame in enumerate(self._drawing.frames):
            if frame.neighbour is None:
                continue
            now = shades[:, frame.neighbour]
            for k in np.flatnonzero(np.diff(now, prepend=self._shades[frame.neighbour])).tolist():
                self._scene.log(self._disc(f, int(now[k])), log_time=int(posed.time_ns[posed.drawn[k]]))
        self._shades = shades[-1]

    def _disc(self, frame: int, shade: int) -> fox.SceneUpdate:
        """A disc in one of its colours; each is made once."""
        if (frame, shade) not in self._discs_drawn:
            of = self._drawing.frames[frame]
            shapes = tuple(replace(s, rgba=DISC_RGBA[shade]) for s in of.shapes)
            entity = _entity(replace(of, shapes=shapes), self._drawing.label_m)
            self._discs_drawn[frame, shade] = fox.SceneUpdate(entities=[entity])
        return self._discs_drawn[frame, shade]

    def close(self, outcome: Outcome) -> None:
        """Adds the events, the phases, the verdict and the summary, and completes the file."""
        for event in outcome.events:
            log = _log_message(event.time_s, _LEVELS[event.level], event.car, event.text)
            self._log.log(log, log_time=int(nanoseconds(event.time_s)))
        for phase in sorted(outcome.phases, key=lambda p: p.time_s):
            log = _log_message(phase.time_s, fox.LogLevel.Info, phase.subject, phase.state)
            self._phases.log(log, log_time=int(nanoseconds(phase.time_s)))
        self._writer.write_metadata("outcome", {"verdict": outcome.verdict})
        self._writer.write_metadata("sha256", dict(outcome.digests))
        self._attach("summary.json", "application/json", json.dumps(outcome.summary, indent=2))
        if outcome.explanation is not None:
            self._attach(EXPLANATION, "application/json", json.dumps(outcome.explanation, indent=2))
        self._writer.close()

    def abort(self) -> None:
        """Completes the file with what it has."""
        self._writer.close()

    def _channel(self, topic: str, described: foxglove.Schema) -> foxglove.Channel:
        return foxglove.Channel(topic, message_encoding="protobuf", schema=described, context=self._context)

    def _attach(self, name: str, media_type: str, text: str) -> None:
        self._writer.attach(log_time=0, create_time=0, name=name, media_type=media_type, data=text.encode())


def writer_options() -> MCAPWriteOptions:
    """How a file is written."""
    return MCAPWriteOptions(
        chunk_size=_CHUNK_BYTES,
        compression_level=_COMPRESSION,
        compression_threads=0,  # threads change the bytes
    )


def _transforms_layout(scene: Scene) -> Layout:
    """A ``foxglove.FrameTransforms`` with every frame of the scene below the world."""
    vector = Layout().double(1).double(2).double(3)
    quaternion = Layout().double(1).double(2).double(3).double(4)
    out = Layout()
    for frame in scene.frames:
        transform = Layout().time(1).text(2, WORLD).text(3, frame.name)
        out.message(1, transform.message(4, vector).message(5, quaternion))
    return out


def _log_message(time_s: float, level: fox.LogLevel, name: str, message: str) -> fox.Log:
    """A line; the name is in the text, because Rerun shows nothing else of it."""
    at = _timestamp(int(nanoseconds(time_s)))
    return fox.Log(timestamp=at, level=level, message=f"{name}: {message}" if name else message)


def _timestamp(time_ns: int) -> fox.Timestamp:
    return fox.Timestamp(*divmod(time_ns, NS_PER_S))


def _scene_update(scene: Scene) -> fox.SceneUpdate:
    """Everything that is drawn, each thing locked to its frame."""
    return fox.SceneUpdate(
        entities=[_entity(f, scene.label_m) for f in (Frame(WORLD, scene.fixed), *scene.frames)]
    )


def _entity(frame: Frame, label_m: float) -> fox.SceneEntity:
    """The shapes of a frame. MCAP has no capsules: a cylinder and two spheres."""
    cubes, spheres, cylinders, triangles = [], [], [], []
    for s in frame.shapes:
        color = fox.Color(**dict(zip("rgba", s.rgba.tolist(), strict=True)))
        pose, size = _pose(s), fox.Vector3(**dict(zip("xyz", (2 * s.half_size_m).tolist(), strict=True)))
        match s.kind:
            case "box":
                cubes.append(fox.CubePrimitive(pose=pose, size=size, color=color))
            case "ellipsoid":
                spheres.append(fox.SpherePrimitive(pose=pose, size=size, color=color))
            case "cylinder" | "capsule":
                scales = {"bottom_scale": 1.0, "top_scale": 1.0}
                cylinders.append(fox.CylinderPrimitive(pose=pose, size=size, color=color, **scales))
            case "mesh":
                points = [fox.Point3(x=x, y=y, z=z) for x, y, z in s.vertices_m.tolist()]
                indices = s.triangles.ravel().tolist()
                mesh = fox.TriangleListPrimitive(pose=pose, points=points, color=color, indices=indices)
                triangles.append(mesh)
        if s.kind == "capsule":
            ball = fox.Vector3(x=2 * s.half_size_m[0], y=2 * s.half_size_m[0], z=2 * s.half_size_m[0])
            for end in (-1, 1):
                spheres.append(fox.SpherePrimitive(pose=_pose(s, end), size=ball, color=color))
    texts = []
    if frame.label:
        at = fox.Pose(position=fox.Vector3(z=label_m), orientation=fox.Quaternion(w=1.0))
        white = fox.Color(r=1.0, g=1.0, b=1.0, a=1.0)
        texts = [
            fox.TextPrimitive(
                pose=at, billboard=True, font_size=12.0, scale_invariant=True, color=white, text=frame.label
            )
        ]
    return fox.SceneEntity(
        timestamp=_timestamp(0),
        frame_id=frame.name,
        id=frame.name,
        frame_locked=True,
        cubes=cubes,
        spheres=spheres,
        cylinders=cylinders,
        triangles=triangles,
        texts=texts,
    )


def _pin(mark: Mark, scene: Scene) -> fox.SceneEntity:
    """A pin with a label where bodies began to touch, for the rest of the run."""
    foot, head = (dict(zip("xyz", m, strict=True)) for m in mark.pin_m(scene.r_m, scene.label_m).tolist())
    thick, ball = (2 * k * PIN_RADIUS_R * scene.r_m for k in (1.0, HEAD))
    red = fox.Color(**dict(zip("rgb", MARK_RGB, strict=True)), a=1.0)
    at = fox.Pose(position=fox.Vector3(**head), orientation=fox.Quaternion(w=1.0))
    line = fox.LinePrimitive(thickness=thick, points=[fox.Point3(**foot), fox.Point3(**head)], color=red)
    label = fox.TextPrimitive(
        pose=at,
        billboard=True,
        font_size=14.0,
        scale_invariant=True,
        color=fox.Color(r=1.0, g=1.0, b=1.0, a=1.0),
        text=mark.collision.sentence,
    )
    return fox.SceneEntity(
        timestamp=_timestamp(mark.time_ns),
        frame_id=WORLD,
        id=f"contact/{mark.number}",
        lines=[line],
        spheres=[fox.SpherePrimitive(pose=at, size=fox.Vector3(x=ball, y=ball, z=ball), color=red)],
        texts=[label],
    )


def _pose(shape: Shape, end: int = 0) -> fox.Pose:
    """Pose of a shape, or of an end of its straight part: -1 the lower, 1 the upper."""
    x, y, z = shape.pos_m + end * shape.half_size_m[2] * shape.axis
    w, *xyz = shape.quat.tolist()
    return fox.Pose(
        position=fox.Vector3(x=x, y=y, z=z),
        orientation=fox.Quaternion(x=xyz[0], y=xyz[1], z=xyz[2], w=w),
    )

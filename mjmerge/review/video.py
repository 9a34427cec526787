"""``mjmerge video``: a recording as an mp4, rendered off-screen in MuJoCo, with z and d_j drawn beside it.

What ran and what came of it stand above it.

How MuJoCo draws is chosen by ``MUJOCO_GL`` when it is imported, so the drawing is done by a process of its
own (``python -m mjmerge.review.video``), with EGL if that works here and with OSMesa otherwise.
"""

from __future__ import annotations

import errno
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from mjmerge.errors import MjmergeError, WorkerError
from mjmerge.outputs import no_room, whole
from mjmerge.simulation.trace import Trace
from mjmerge.state import NS_PER_S, Array

if TYPE_CHECKING:
    import mujoco

    from mjmerge.record.contacts import Mark
    from mjmerge.record.scene import Scene
    from mjmerge.review.captions import Picture

Camera = Literal["chase", "overhead"]

_BACKENDS = ("egl", "osmesa")
_FAILED, _NO_ROOM = 4, 5  # exit codes of the process that draws
_ADVICE = """\
cannot draw off-screen here: neither EGL nor OSMesa works. Install one of them:
  Debian, Ubuntu:  apt-get install libegl1 libegl-mesa0 libgl1-mesa-dri   (or: libosmesa6)
  Fedora:          dnf install mesa-libEGL mesa-dri-drivers               (or: mesa-libOSMesa)
or open the recording in a viewer: mjmerge view"""
_SIZE, _PANEL_PX = (1280, 720), 448
"""Width and height of a picture, and the width of the plots beside the drawing, pixels; even, as H.264 wants
them."""
_VIEWS: dict[str, tuple[float, float, float]] = {"chase": (0.0, -25.0, 6.2), "overhead": (90.0, -89.9, 9.0)}
"""Azimuth and elevation, degrees, and distance in safety margins r."""
_SHADOW = 2048  # pixels of the shadow's map, each way
_QUALITY = "20"  # of x264: 18 is hard to tell from the original, 23 is its default


@dataclass(frozen=True)
class Options:
    """How the video is to be.

    Attributes:
        camera: from behind the ego, or from above.
        fps: pictures per second of the video.
        speed: simulated seconds per second of the video.
    """

    camera: Camera = "chase"
    fps: int = 30
    speed: float = 1.0


def video(
    recording: Path, out: Path, options: Options, progress: Callable[[float], None] | None = None
) -> str:
    """Writes a recording as an mp4.

    Args:
        recording: the file.
        out: the video to write.
        options: how it is to be.
        progress: called with the part that is done, 0 to 1.

    Returns:
        What drew it: ``egl`` or ``osmesa``.

    Raises:
        MjmergeError: PyAV is not installed, or nothing here draws off-screen.
        UnreadableError: it is no recording, or it has no world in it.
        OutputError: the video is there already, or cannot be written.
    """
    if find_spec("av") is None:
        raise MjmergeError("videos need PyAV: pip install 'mjmerge[video]'")
    chosen = os.environ.get("MUJOCO_GL", "").lower()
    order = sorted(_BACKENDS, key=lambda name: name != chosen)
    used = ""

    def write(partial: Path) -> None:
        nonlocal used
        for backend in order:
            trouble = _draw_elsewhere(backend, recording, partial, options, progress)
            if trouble is None:
                used = backend
                return
            if trouble:
                raise MjmergeError(f"the video was not made: {trouble}")
        raise MjmergeError(_ADVICE)

    try:
        whole(out, write)
    except BaseException:
        out.with_name(f"{out.name}.partial").unlink(missing_ok=True)  # of no use: it has no index
        raise
    return used


def _draw_elsewhere(
    backend: str,
    recording: Path,
    out: Path,
    options: Options,
    progress: Callable[[float], None] | None,
) -> str | None:
    """Draws in a process of its own.

    Returns:
        ``None`` when it is done; what went wrong; nothing at all (``""``) if it could not even begin to draw.
    """
    command = [sys.executable, "-m", "mjmerge.review.video", str(recording), str(out)]
    command += [str(value) for value in asdict(options).values()]
    environment = {**os.environ, "MUJOCO_GL": backend, "PYOPENGL_PLATFORM": backend}
    began = False
    with (
        tempfile.TemporaryFile("w+") as complaints,
        subprocess.Popen(
            command, env=environment, stdout=subprocess.PIPE, stderr=complaints, text=True
        ) as process,
    ):
        assert process.stdout is not None
        try:
            for line in process.stdout:
                began = True
                if progress is not None:
                    progress(float(line))
        except BaseException:
            process.terminate()
            raise
        process.wait()
        complaints.seek(0)
        said = complaints.read().strip()
    code = process.returncode
    if code == 0:
        return None
    if not began:
        return ""
    if code == _NO_ROOM:
        raise OSError(errno.ENOSPC, said)
    if code < 0:
        raise WorkerError(f"the process that draws was ended by signal {-code}: out of memory?")
    if code != _FAILED:
        raise RuntimeError(f"the process that draws ended with {code}:\n{said}")
    return said.splitlines()[-1]


def main(arguments: list[str]) -> int:
    """The process that draws: the part done, line by line, on standard output."""
    recording, out, camera, fps, speed = arguments
    options = Options(cast("Camera", camera), int(fps), float(speed))
    import mujoco

    mujoco.GLContext(16, 16).make_current()  # fails, here or on import, where a library is missing
    sys.stdout.write("0.0\n")
    sys.stdout.flush()
    try:
        for done in render(Path(recording), Path(out), options):
            sys.stdout.write(f"{done}\n")
            sys.stdout.flush()
    except MjmergeError as error:
        sys.stderr.write(" ".join(str(error).split()) + "\n")
        return _FAILED
    except OSError as error:
        if not no_room(error):
            raise
        sys.stderr.write(error.strerror or "no space left")
        return _NO_ROOM
    return 0


def render(recording: Path, out: Path, options: Options) -> Iterator[float]:
    """Draws and encodes, here and now; yields the part that is done after every picture."""
    import av

    from mjmerge.record.read import read
    from mjmerge.record.scene import Scene
    from mjmerge.review.captions import Panel, title
    from mjmerge.review.poses import header, poses, touched

    found = read(recording)
    about, trace = header(found), found.trace()
    scene = Scene(about.model, about.scenario.r_m)
    count = int(found.last_s * options.fps / options.speed) + 1
    wanted_ns = np.arange(count) * (NS_PER_S * options.speed / options.fps)
    rows = np.clip(np.searchsorted(found.time_ns, wanted_ns - 0.5e9 * found.step_s), 0, len(found.ticks) - 1)
    pos_m, quat = poses(found, about, scene, rows)
    marks, shades = touched(found, scene.r_m)
    strip = title(about.ran, found.verdict, found.summary or {}, _SIZE[0])
    height = _SIZE[1] - len(strip)
    panel = Panel(trace, marks, (_PANEL_PX, height))
    stage = Stage(about.model, scene, trace, options.camera, marks, (_SIZE[0] - _PANEL_PX, height))
    ticks = found.ticks[rows]
    with av.open(str(out), "w", format="mp4", options={"movflags": "faststart"}) as file:
        stream: Any = file.add_stream("libx264", rate=options.fps, options={"crf": _QUALITY})
        stream.width, stream.height, stream.pix_fmt = *_SIZE, "yuv420p"
        stream.time_base = Fraction(1, options.fps)
        for k, tick in enumerate(ticks.tolist()):
            drawn = stage.draw(tick, pos_m[k], quat[k], shades[rows[k]])
            picture = np.concatenate([strip, np.concatenate([drawn, panel.draw(tick)], axis=1)])
            frame = av.VideoFrame.from_ndarray(picture, format="rgb24")
            frame.pts = k
            file.mux(stream.encode(frame))
            yield (k + 1) / count
        file.mux(stream.encode(None))
    stage.close()


class Stage:
    """The cars on their road, drawn by MuJoCo from recorded poses."""

    def __init__(
        self,
        model: mujoco.MjModel,
        scene: Scene,
        trace: Trace,
        camera: Camera,
        marks: Sequence[Mark],
        size: tuple[int, int],
    ) -> None:
        """Args: the world; what moves in it; the run; where to look from; where bodies touch; pixels."""
        import mujoco

        width, height = size
        self._marks, self._label_m = marks, scene.label_m
        model.vis.global_.offwidth, model.vis.global_.offheight = width, height
        model.vis.quality.offsamples, model.vis.quality.shadowsize = (
            0,
            _SHADOW,
        )  # smoothing takes 3/4 of the time
        model.vis.headlight.specular[:] = model.light_specular[:] = 0.0  # no glare on the road
        if camera == "overhead":
            model.vis.headlight.diffuse[:] = 0.0
        self._model, self._data = model, mujoco.MjData(model)
        mujoco.mj_forward(model, self._data)
        self._lights_m = self._data.light_xpos[:, 0].copy()
        self._renderer = mujoco.Renderer(model, height, width)
        self._trace, self._r_m = trace, trace.scenario.r_m
        self._camera = mujoco.MjvCamera()
        self._camera.azimuth, self._camera.elevation, distance = _VIEWS[camera]
        self._camera.distance = distance * self._r_m
        names = {model.body(b).name or f"body_{b}": b for b in range(model.nbody)}
        self._bodies = [(f, names[frame.name]) for f, frame in enumerate(scene.frames) if frame.name in names]
        starts = trace.front_m[0, 0, :, 1]
        self._middle_m = (starts.max() + starts.min()) / 2

    def draw(self, tick: int, pos_m: Array, quat: Array, shades: NDArray[np.int64]) -> Picture:
        """One picture, (height, width, 3).

        Args:
            tick: of the run.
            pos_m: origins of the scene's frames, m, (F, 3).
            quat: their orientations, w x y z, (F, 4).
            shades: colours of the discs, (C-1,).
        """
        import mujoco

        data, turn = self._data, np.empty(9)
        for f, body in self._bodies:
            mujoco.mju_quat2Mat(turn, quat[f])
            first, count = int(self._model.body_geomadr[body]), int(self._model.body_geomnum[body])
            for g in range(first, first + count):
                local = np.empty(9)
                mujoco.mju_quat2Mat(local, self._model.geom_quat[g])
                frame = turn.reshape(3, 3)
                data.geom_xpos[g] = pos_m[f] + frame @ self._model.geom_pos[g]
                data.geom_xmat[g] = (frame @ local.reshape(3, 3)).ravel()
        along_m = self._trace.front_m[0, tick, 0, 0]
        data.light_xpos[:, 0] = self._lights_m + along_m  # shadows reach only so far
        self._camera.lookat[:] = (along_m, self._middle_m, 0.0)
        self._renderer.update_scene(data, self._camera)
        self._marks_and_discs(tick, shades)
        picture: Picture = self._renderer.render()
        return picture

    def _marks_and_discs(self, tick: int, shades: NDArray[np.int64]) -> None:
        """The safety discs around the neighbours' front axles, and pins where bodies touched."""
        import mujoco

        from mjmerge.record.contacts import DISC_RGBA, HEAD, MARK_RGB, PIN_RADIUS_R

        flat, ball = mujoco.mjtGeom.mjGEOM_CYLINDER, mujoco.mjtGeom.mjGEOM_SPHERE
        r_m, pin_m = self._r_m, PIN_RADIUS_R * self._r_m
        for j, shade in enumerate(shades.tolist()):
            at_m = (*self._trace.front_m[0, tick, 1 + j], 0.006 * r_m)
            self._add(flat, (r_m, 0.002 * r_m, 0.0), at_m, DISC_RGBA[shade])
        red = np.array([*MARK_RGB, 0.99])  # what is seen through has no shadow
        for mark in self._marks:
            if mark.collision.time_s <= self._trace.time_s[tick]:
                foot_m, head_m = mark.pin_m(r_m, self._label_m)
                self._add(ball, (HEAD * pin_m,) * 3, head_m, red)
                if (line := self._add(flat, (pin_m,) * 3, foot_m, red)) is not None:
                    mujoco.mjv_connector(line, flat, pin_m, foot_m, head_m)

    def _add(self, kind: int, size: Sequence[float], pos_m: Sequence[float], rgba: Array) -> Any:
        """Adds a shape to the picture, and returns it; ``None`` where there is no room for it."""
        import mujoco

        scene = self._renderer.scene
        if scene.ngeom == scene.maxgeom:
            return None
        geom, turn = scene.geoms[scene.ngeom], np.eye(3).ravel()
        mujoco.mjv_initGeom(geom, kind, np.array(size), np.array(pos_m), turn, rgba.astype(np.float32))
        scene.ngeom += 1
        return geom

    def close(self) -> None:
        """Gives back what draws."""
        self._renderer.close()


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))

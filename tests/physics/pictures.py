"""Makes what docs/cars.md shows, and the page with its tables, in a folder, for docs/pictures.py.

``MUJOCO_GL=egl python -m tests.physics.pictures FOLDER`` (or osmesa): cars rendered off-screen, plots and
tables of their identification, traces beside the published model's.
"""

from __future__ import annotations

import re
import sys
from pathlib import Path

import mujoco
import numpy as np
from PIL import Image

from mjmerge.config import shipped
from mjmerge.figures.style import head, save, sheet
from mjmerge.proving.identify import identify
from mjmerge.proving.report import cornering, handling, longitudinal, markdown, steering
from mjmerge.roster import roster
from mjmerge.world.checks.parts import STEERED
from mjmerge.world.compose import compose
from tests.physics.crossmodel import LOADED, MANOEUVRES, Comparison, compare

CARS = roster().cars

DOCS = Path(__file__).parents[2] / "docs"
VIEWS = {"front": (140.0, -24.0), "rear": (-40.0, -28.0)}
"""Azimuth and elevation of the camera, deg."""
WIDTH, HEIGHT = 800, 500
_ANGLE_RAD = 0.35


def render(model: str, role: str, view: str) -> Image.Image:
    """A standing car with its wheels turned, painted for a role."""
    world = compose({role: model})
    m, data = world.drawn, mujoco.MjData(world.drawn)
    m.vis.global_.offwidth, m.vis.global_.offheight, m.vis.quality.offsamples = 2 * WIDTH, 2 * HEIGHT, 8
    for wheel in STEERED:
        data.joint(f"{role}/steer_{wheel}").qpos[0] = _ANGLE_RAD
    mujoco.mj_forward(m, data)
    size = world.sheets[0].length_m
    camera = mujoco.MjvCamera()
    camera.azimuth, camera.elevation = VIEWS[view]
    camera.distance, camera.lookat[:] = 1.32 * size, data.geom(f"{role}/hull").xpos
    with mujoco.Renderer(m, 2 * HEIGHT, 2 * WIDTH) as renderer:
        renderer.update_scene(data, camera)
        picture = Image.fromarray(renderer.render())
    return picture.resize((WIDTH, HEIGHT), Image.Resampling.LANCZOS)


def traces(model: str, compared: dict[str, Comparison]):
    """Yaw rate and lateral acceleration of a car and of the published model, manoeuvre by manoeuvre."""
    figure, _ = sheet((1,), 5.5)
    figure.clear()
    panels = figure.subplots(2, len(MANOEUVRES) - 1, sharex="col", sharey="row")
    for column, name in zip(panels.T, MANOEUVRES[:-1], strict=True):
        found = compared[name]
        for panel, pair, scale in (
            (column[0], found.yaw_rate_radps, np.degrees(1.0)),
            (column[1], found.lateral_mps2, 1.0),
        ):
            panel.plot(
                found.time_s, scale * pair[1], color="#999999", linewidth=4, alpha=0.6, label="published"
            )
            panel.plot(found.time_s, scale * pair[0], color="#2c61bf", linewidth=1.2, label="ours")
            panel.grid(alpha=0.25)
        if name == MANOEUVRES[2]:
            loaded = compared[LOADED]
            for panel, pair, scale in (
                (column[0], loaded.yaw_rate_radps, np.degrees(1.0)),
                (column[1], loaded.lateral_mps2, 1.0),
            ):
                panel.plot(
                    loaded.time_s, scale * pair[1], ":", color="#d97321", label="published, load transfer"
                )
        column[0].set_title(name, fontsize=9)
        column[1].set_xlabel("time (s)")
    panels[0, 0].set_ylabel("yaw rate (deg/s)")
    panels[1, 0].set_ylabel("lateral acceleration (m/s²)")
    handles, names = panels[0, 2].get_legend_handles_labels()
    figure.legend(handles, names, loc="outside lower center", ncols=3, frameon=False)
    head(figure, f"{model} beside the published single-track model")
    return figure


def main(docs: Path) -> None:
    """Writes everything into a folder as it is in docs/, the page with its tables, too."""
    folder = docs / "cars"
    folder.mkdir(parents=True, exist_ok=True)
    page = (DOCS / "cars.md").read_text(encoding="utf-8")
    differences = []
    for model, role in zip(shipped.models(), CARS, strict=True):
        for view in VIEWS:
            render(model, role, view).save(folder / f"{model}_{view}.png", optimize=True)
        found = identify(model)
        for draw in (cornering, handling, longitudinal, steering):
            save(draw(found), folder / f"{model}_{draw.__name__}.png")
        compared = compare(model)
        save(traces(model, compared), folder / f"{model}_crossmodel.png")
        for name in MANOEUVRES:
            c = compared[name]
            parts = [p for pair in (c.yaw_rate_radps, c.lateral_mps2) for p in c.off(pair)]
            differences.append(f"| {model} | {name} | " + " | ".join(f"{p:.1%}" for p in parts) + " |\n")
        page = _put(page, model, markdown(found.table))
    head = "| car | manoeuvre | yaw rate: largest | r.m.s. | lateral acceleration: largest | r.m.s. |\n"
    page = _put(
        page, "crossmodel", head + "| --- | --- | ---: | ---: | ---: | ---: |\n" + "".join(differences)
    )
    (docs / "cars.md").write_text(page, encoding="utf-8")


def _put(page: str, name: str, text: str) -> str:
    """The page with what stands between a name's marks replaced."""
    begin, end = f"<!-- {name} -->\n", f"<!-- /{name} -->"
    pattern = re.escape(begin) + ".*?" + re.escape(end)
    return re.sub(pattern, lambda _: begin + text + end, page, flags=re.DOTALL)


if __name__ == "__main__":
    main(Path(sys.argv[1]))

"""How Foxglove shows a run: ``foxglove.json``, to be imported there; every MCAP carries its own."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from foxglove import layouts as fox

from mjmerge.record import plots
from mjmerge.record.plots import Plot
from mjmerge.scenario.schema import Scenario
from mjmerge.state import Array

FILE = Path(__file__).with_name("foxglove.json")
"""The layout as a file: that of the ``paper`` scenario."""


def text(scenario: Scenario, paint: Mapping[str, Array], plant: str = "mujoco") -> str:
    """The layout as JSON.

    Args:
        scenario: the run's; the cameras stand at distances that suit its safety margin.
        paint: colour of each car, 0 to 1.
        plant: what moved the cars.
    """
    r_m = scenario.r_m
    busy = [fox.TabItem(title=p.name, content=_plot(p)) for p in plots.actuation(scenario, paint, plant)]
    left = _split(
        "column",
        (5, _scene("Chase", r_m * 5.5, 62.0, -90.0)),
        (3, _scene("From above", r_m * 8, 0.0, -90.0)),
        (2, fox.LogPanel(title="Events", config=fox.LogConfig(topic_to_render="/log"))),
        (2, fox.LogPanel(title="Phases", config=fox.LogConfig(topic_to_render="/phases"))),
    )
    right = _split(
        "column",
        *((3, _plot(p)) for p in plots.main(scenario, paint, plant)),
        (4, fox.TabContainer(tabs=busy)),
    )
    layout: str = fox.Layout(content=_split("row", (3, left), (2, right))).to_json()
    return layout + "\n"


def _split(direction: str, *parts: tuple[float, object]) -> fox.SplitContainer:
    items = [fox.SplitItem(proportion=share, content=content) for share, content in parts]
    return fox.SplitContainer(direction=direction, items=items)


def _scene(title: str, distance_m: float, phi_deg: float, theta_deg: float) -> fox.ThreeDeePanel:
    """A 3D panel that goes along the road with the ego."""
    return fox.ThreeDeePanel(
        title=title,
        config=fox.ThreeDeeConfig(
            follow_tf="camera/ego",
            follow_mode="follow-position",
            scene=fox.BaseRendererSceneSettings(
                background_color="#181a1e", transforms=fox.BaseRendererTransforms(visible=False)
            ),
            topics={"/scene": fox.BaseRendererSceneUpdateTopicSettings(visible=True)},
            camera_state=fox.ThreeDeeCameraState(
                distance=distance_m, phi=phi_deg, theta_offset=theta_deg, perspective=True
            ),
        ),
    )


def _plot(plot: Plot) -> fox.PlotPanel:
    lines = [
        fox.PlotSeries(
            value=f"{line.topic}.{line.field}",
            label=line.label,
            color=_hex(line.color),
            timestamp_method="receiveTime",
            enabled=True,
        )
        for line in plot.lines
    ]
    levels = [
        fox.PlotSeries(
            value=f"{v.value:g}", label=v.label, color=_hex(v.color), line_style="dashed", enabled=True
        )
        for v in plot.levels
    ]
    config = fox.PlotConfig(paths=lines + levels, show_legend=True, legend_display="floating", is_synced=True)
    return fox.PlotPanel(title=plot.name, config=config)


def _hex(color: plots.Color) -> str:
    return "#" + "".join(f"{c:02x}" for c in color)

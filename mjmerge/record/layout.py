"""How the Rerun viewer shows a run: two 3D views, plots, the report and the events."""

from __future__ import annotations

import rerun as rr
import rerun.blueprint as rrb

from mjmerge.contract import HYPOTHESES
from mjmerge.phases import NAMES
from mjmerge.scenario import CARS, Scenario

LINE_COLORS = [[230, 230, 230], [140, 190, 255], [255, 190, 120], [170, 230, 150]]
"""Of lines that belong to no car."""
REFERENCE_COLORS = [[235, 80, 80], [150, 90, 90]]
COLORS = {
    "opinion": [[245, 245, 245]],
    "mu": [[190, 130, 255]],
    "weight": [[255, 210, 90]],
}
"""Of columns that share a plot."""
_TRAIL_S = 4.0
_DECISION_COLORS = [[110, 110, 120], [90, 130, 220], [80, 190, 120]]
_STATE_COLORS = [[60, 110, 75], [235, 140, 50], [220, 50, 50]]


def entity(frame: str) -> str:
    """Entity of a frame, ``ego/chassis`` to ``/world/ego/chassis``.

    Entities below each other would add up their motions, so what is below a car stays on one level.
    """
    group, _, rest = frame.partition("/")
    return rr.new_entity_path(["world", group, rest or "base"])


def phase_entity(subject: str) -> str:
    """Entity of what changes its state: ``/hypotheses/...`` for those, ``/phases/...`` otherwise."""
    return f"/{'hypotheses' if subject in HYPOTHESES else 'phases'}/{subject.replace(' ', '_')}"


def state_colors(subject: str) -> list[list[int]]:
    """Of the states of a subject, from the calmest on."""
    colors = _DECISION_COLORS if subject == "decision" else _STATE_COLORS
    return colors[: len(NAMES[subject])]


def blueprint(scenario: Scenario) -> rrb.Blueprint:
    """The layout; cameras stand at distances that suit the safety margin."""
    trail = rrb.VisibleTimeRange(
        "sim_time",
        start=rrb.TimeRangeBoundary.cursor_relative(seconds=-_TRAIL_S),
        end=rrb.TimeRangeBoundary.cursor_relative(),
    )
    r_m = scenario.law.r_m
    middle_m = (scenario.initial.ego.front_m[1] + scenario.initial.vehicle_1.front_m[1]) / 2

    def view(name: str, eye: tuple[float, float, float], up: tuple[float, float, float]) -> rrb.Spatial3DView:
        """From ``eye``, in safety margins from the ego's place along the road."""
        return rrb.Spatial3DView(
            name=name,
            origin=entity("camera/ego"),
            contents="/world/**",
            background=rrb.Background(color=[24, 26, 30]),
            line_grid=False,
            eye_controls=rrb.EyeControls3D(
                kind=rrb.Eye3DKind.Orbital,
                position=(eye[0] * r_m, middle_m + eye[1] * r_m, eye[2] * r_m),
                look_target=(0.0, middle_m, 0.0),
                eye_up=up,
            ),
            overrides={f"/world/trails/{car}": rrb.VisibleTimeRanges([trail]) for car in CARS},
        )

    def plot(name: str, *contents: str) -> rrb.TimeSeriesView:
        return rrb.TimeSeriesView(name=name, origin="/", contents=contents, plot_legend=rrb.Corner2D.RightTop)

    return rrb.Blueprint(
        rrb.Horizontal(
            rrb.Vertical(
                view("Chase", (-4.5, 0.0, 2.5), (0, 0, 1)),
                view("From above", (0.0, 0.0, 6.5), (0, 1, 0)),
                rrb.Tabs(
                    rrb.TextDocumentView(name="Report", origin="/run/report"),
                    rrb.TextLogView(name="Events", origin="/events"),
                    rrb.StateTimelineView(name="Phases", origin="/phases"),
                    rrb.StateTimelineView(name="Contract", origin="/hypotheses"),
                    rrb.TextDocumentView(name="Scenario", origin="/run/scenario"),
                ),
                row_shares=[5, 3, 3],
            ),
            rrb.Vertical(
                plot("Distance of the front axles less r, m", "/law/distance_m", "/reference/distance_m"),
                plot("Opinion z, mu, weight w of the merge", "/law/opinion", "/law/mu", "/law/weight"),
                plot("Lateral position, m", "/cars/front_m/y"),
                plot("Speed, m/s", "/cars/speed_mps"),
                rrb.Tabs(
                    plot("Steering, rad", "/cars/steer_rad"),
                    plot("Gap, m", "/law/gap_m", "/reference/gap_m"),
                    plot("Clearance, m", "/law/clearance_m"),
                    plot("Command along, m/s²", "/cars/u_mps2/x"),
                    plot("across", "/cars/u_mps2/y"),
                ),
            ),
            column_shares=[3, 2],
        ),
        rrb.TimePanel(timeline="sim_time", state="collapsed"),
        rrb.SelectionPanel(state="hidden"),
        rrb.BlueprintPanel(state="hidden"),
        auto_views=False,
    )

"""Which lines of a recording are plotted together, and their colours; the same for Rerun and Foxglove."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass

from mjmerge.config.acts import BODIES, EVERY
from mjmerge.config.acts import WHEELS as STEERING
from mjmerge.law import is_paper
from mjmerge.record.schema import LAW_TOPIC, SIGNAL_TOPIC, car_topic
from mjmerge.roster import WHEELS, Roster, along
from mjmerge.scenario.ramp import EDGE_DISTANCE
from mjmerge.scenario.schema import Scenario
from mjmerge.simulation.trace import signals_of
from mjmerge.state import Array

Color = tuple[int, int, int]

COMMANDS: dict[str, Color] = {"u_n": (110, 200, 255), "u_c": (255, 70, 150), "u": (255, 225, 80)}
"""Colour of each part of the ego's command: nominal, barrier, both; in plots and as arrows."""
_WHITE, _VIOLET, _GREY, _RED, _DARK_RED = (
    (245, 245, 245),
    (190, 130, 255),
    (150, 150, 150),
    (235, 80, 80),
    (165, 95, 95),
)
_SIGNALS: tuple[Color, ...] = (_WHITE, _VIOLET, (255, 210, 90), (110, 200, 255), (130, 220, 130))
_WHEEL_COLORS: tuple[Color, ...] = ((250, 170, 90), (250, 220, 120), (90, 170, 240), (130, 220, 240))


@dataclass(frozen=True)
class Line:
    """A field over time.

    Attributes:
        label: in the legend.
        color: red, green, blue, 0 to 255.
        topic: of the field's message.
        field: its dotted name in there.
    """

    label: str
    color: Color
    topic: str
    field: str


_EDGE = Line("to the edge", _WHITE, SIGNAL_TOPIC, EDGE_DISTANCE)
"""How far the ego's body is from the edge of the road where its lane ends."""


@dataclass(frozen=True)
class Level:
    """A constant to read a plot against.

    Attributes:
        label: in the legend.
        color: red, green, blue, 0 to 255.
        value: the constant, in the plot's unit.
    """

    label: str
    color: Color
    value: float


@dataclass(frozen=True)
class Plot:
    """Lines that share their axes.

    Attributes:
        name: above the plot, with the unit.
        lines: what is plotted.
        levels: what it is read against.
        on: plants that have it; on others it would be empty.
    """

    name: str
    lines: tuple[Line, ...]
    levels: tuple[Level, ...] = ()
    on: tuple[str, ...] = EVERY


def rgb(paint: Array) -> Color:
    """A colour, 0 to 1, as bytes."""
    r, g, b = (round(255 * float(c)) for c in paint[:3])
    return r, g, b


def main(scenario: Scenario, paint: Mapping[str, Array], plant: str = "mujoco") -> list[Plot]:
    """What is always in sight: distances, clearance, opinion, as far as the plant has them.

    Args:
        scenario: the run's.
        paint: colour of each car, 0 to 1.
        plant: what moved the cars.
    """
    floor = scenario.expect.min_distance_m.at_least
    levels = [Level("edge of the disc", _RED, 0.0)] + [Level("floor", _DARK_RED, floor)] * (floor != 0)
    around = [(j, car, rgb(paint[car])) for j, car in enumerate(scenario.roster.neighbours, start=1)]
    edge = [] if scenario.road.ends_m is None else [_EDGE]
    found = [
        Plot(
            "Distance d_j of the front axles less r, m",
            tuple(Line(f"d_{j}", color, LAW_TOPIC, f"distance_m.{car}") for j, car, color in around),
            tuple(levels),
        ),
        Plot(
            "Clearance of the bodies, m",
            (
                *(Line(f"to {_said(c)}", color, LAW_TOPIC, f"clearance_m.ego_{c}") for _, c, color in around),
                *edge,
            ),
            (Level("contact", _RED, 0.0),),
            EVERY if edge else BODIES,
        ),
        *_of_law(scenario, paint),
    ]
    return [plot for plot in found if plant in plot.on]


def _of_law(scenario: Scenario, paint: Mapping[str, Array]) -> Iterator[Plot]:
    """What the law has in mind: the paper's opinion, and the signals of any other."""
    if is_paper(scenario.law):
        z, mu = Line("z", _WHITE, LAW_TOPIC, "opinion"), Line("mu", _VIOLET, LAW_TOPIC, "mu")
        yield Plot("Opinion z and mu", (z, mu))
        yield Plot("Weight w of the merge", (Line("w", (255, 210, 90), LAW_TOPIC, "weight"),))
    lines: list[Line] = []
    for signal in signals_of(scenario):
        called = signal.symbol
        of = along(signal.axes, scenario.roster)
        if not of:
            lines.append(Line(called, _SIGNALS[len(lines) % len(_SIGNALS)], SIGNAL_TOPIC, signal.name))
        for part in of[0] if of else ():
            own = rgb(paint[part]) if part in paint else _SIGNALS[len(lines) % len(_SIGNALS)]
            lines.append(Line(f"{called} {_said(part)}", own, SIGNAL_TOPIC, f"{signal.name}.{part}"))
    if lines:
        yield Plot("Signals of the law", tuple(lines))


def actuation(scenario: Scenario, paint: Mapping[str, Array], plant: str = "mujoco") -> list[Plot]:
    """What the cars are told and do, a tab each, as far as the plant has it; see :func:`main`."""
    ego, there = car_topic("ego"), scenario.roster

    def command(axis: str) -> tuple[Line, ...]:
        where = {"u_n": LAW_TOPIC, "u_c": LAW_TOPIC, "u": ego}
        return tuple(Line(u, COMMANDS[u], where[u], f"{u}_mps2.{axis}") for u in COMMANDS)

    def cars(field: str) -> tuple[Line, ...]:
        return tuple(Line(_said(car), rgb(paint[car]), car_topic(car), field) for car in there.cars)

    wheels = zip(WHEELS, _WHEEL_COLORS, strict=True)
    found = [
        Plot("Command along, m/s²", command("x")),
        Plot("across", command("y")),
        Plot("Speed, m/s", cars("speed_mps")),
        Plot("Lateral, m", cars("front_m.y")),
        Plot(
            "Steering, rad",
            (
                Line("command", _GREY, ego, "steer_command_rad"),
                Line("angle", rgb(paint["ego"]), ego, "steer_rad"),
                Line("clipped", _RED, ego, "steer_clipped_rad"),
            ),
            on=STEERING,
        ),
        Plot(
            "Torque, N m",
            (
                *(Line(_said(wheel), color, ego, f"torque_n_m.{wheel}") for wheel, color in wheels),
                Line("clipped", _RED, ego, "torque_clipped_n_m"),
            ),
            on=STEERING,
        ),
        Plot(
            "Gap, m",
            (Line("dbar", _WHITE, LAW_TOPIC, "gap_m"),),
            (Level("2 r", _RED, 2 * scenario.r_m),),
        ),
        Plot(
            "Impact, N s",
            (
                *(
                    Line(f"ego, {_said(car)}", rgb(paint[car]), LAW_TOPIC, f"contact_impulse_n_s.ego_{car}")
                    for car in there.neighbours
                ),
                *(
                    Line(_among(there, pair), _GREY, LAW_TOPIC, f"contact_impulse_n_s.{pair}")
                    for pair in there.pair_names[there.others]
                ),
            ),
            on=BODIES,
        ),
    ]
    return [plot for plot in found if plant in plot.on]


def everything(scenario: Scenario, paint: Mapping[str, Array], plant: str = "mujoco") -> list[Plot]:
    """All plots of a run; see :func:`main`."""
    return [*main(scenario, paint, plant), *actuation(scenario, paint, plant)]


def levels(plots: Iterable[Plot]) -> dict[str, Level]:
    """Every level of some plots by the entity that Rerun knows it by."""
    return {f"/level/{entity(p.name)}/{entity(v.label)}": v for p in plots for v in p.levels}


def entity(name: str) -> str:
    """Letters and digits of a name, words joined by underscores."""
    return "_".join("".join(c if c.isalnum() else " " for c in name.lower()).split())


def _among(there: Roster, pair: str) -> str:
    """What a pair of neighbours is called in a legend."""
    return "the neighbours" if len(there.neighbours) == 2 else _said(pair)


def _said(name: str) -> str:
    return name.replace("_", " ")

"""Small files of traffic that tests make themselves: straight lanes, and cars whose motion is known."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

LANE_M = 3.5


@dataclass(frozen=True)
class Car:
    """A car on a road along x: lane 0 has its middle at y = 0, lane 1 is to its left."""

    id: str
    x_m: np.ndarray
    y_m: np.ndarray
    first: int = 0
    length_m: float = 4.7
    width_m: float = 1.8
    kind: str = "car"
    extra: dict = field(default_factory=dict)


def steady(id_, start_m, speed_mps, y_m=0.0, steps=80, **more):
    t = np.arange(steps) * 0.1
    return Car(id_, start_m + speed_mps * t, np.full(steps, float(y_m)), **more)


def changing(id_, start_m, speed_mps, from_y_m, to_y_m, begins=20, lasts=31, steps=80, **more):
    t = np.arange(steps) * 0.1
    s = np.clip((np.arange(steps) - begins) / lasts, 0, 1)
    y = from_y_m + (to_y_m - from_y_m) * s**3 * (10 - 15 * s + 6 * s**2)
    return Car(id_, start_m + speed_mps * t, y, **more)


def merging(steps=80):
    """A car that goes from lane 1 to lane 0, between two."""
    return [
        changing("7", 100.0, 15.0, LANE_M, 0.0, steps=steps),
        steady("8", 120.0, 15.0, steps=steps),
        steady("9", 80.0, 15.0, steps=steps),
    ]


def bound(side, points):
    inside = "".join(f"<point><x>{float(x)!r}</x><y>{float(y)!r}</y></point>\n" for x, y in points)
    return f"<{side}>\n{inside}</{side}>\n"


def lanelet(id_, left, right, after=(), before=()):
    links = "".join(f'<successor ref="{o}"/>\n' for o in after)
    links += "".join(f'<predecessor ref="{o}"/>\n' for o in before)
    return f'<lanelet id="{id_}">\n{bound("leftBound", left)}{bound("rightBound", right)}{links}</lanelet>\n'


def straight(lanes=2, length_m=400.0):
    """Lanes along x, called 100 and so on."""
    found = ""
    for k in range(lanes):
        y = (k - 0.5) * LANE_M
        ends = [[(x, y + up) for x in (-50.0, length_m)] for up in (LANE_M, 0.0)]
        found += lanelet(100 + k, *ends)
    return found


def state(name, step, x, y, speed):
    return (
        f"<{name}><position><point><x>{float(x)!r}</x><y>{float(y)!r}</y></point></position>"
        f"<orientation><exact>0.0</exact></orientation><time><exact>{step}</exact></time>"
        f"<velocity><exact>{float(speed)!r}</exact></velocity></{name}>\n"
    )


def obstacle(car, speed=None):
    v = np.hypot(np.gradient(car.x_m, 0.1), np.gradient(car.y_m, 0.1)) if speed is None else speed
    states = [(car.first + i, x, y, s) for i, (x, y, s) in enumerate(zip(car.x_m, car.y_m, v, strict=True))]
    return (
        f'<dynamicObstacle id="{car.id}">\n<type>{car.kind}</type>\n'
        f"<shape><rectangle><length>{car.length_m}</length><width>{car.width_m}</width></rectangle></shape>\n"
        + state("initialState", *states[0])
        + "<trajectory>\n"
        + "".join(state("state", *one) for one in states[1:])
        + "</trajectory>\n</dynamicObstacle>\n"
    )


def commonroad(cars, lanes=None, head='commonRoadVersion="2020a" timeStepSize="0.1"', declared="UTF-8"):
    body = "".join(one if isinstance(one, str) else obstacle(one) for one in cars)
    return (
        f'<?xml version="1.0" encoding="{declared}"?>\n<commonRoad {head} author="Jörg">\n'
        f"{straight() if lanes is None else lanes}{body}</commonRoad>\n"
    )


def rows(cars, step_s=0.1):
    """Of each car and time: id, frame, centre, length, width, lane, speed."""
    for car in cars:
        for i, (x, y) in enumerate(zip(car.x_m, car.y_m, strict=True)):
            v = float(np.gradient(car.x_m, step_s)[i])
            yield car, car.first + i, float(x), float(y), "1" if y < LANE_M / 2 else "2", v


def ngsim(cars):
    """Feet, x to the right, positions of the front centre."""
    foot = 0.3048
    lines = ["Vehicle_ID,Frame_ID,Local_X,Local_Y,v_Length,v_Width,v_Class,v_Vel,v_Acc,Lane_ID"]
    for car, frame, x, y, lane, v in rows(cars):
        values = (-y / foot, (x + car.length_m / 2) / foot, car.length_m / foot, car.width_m / foot)
        lines.append(f"{car.id},{frame}," + ",".join(map(repr, values)) + f",2,{v / foot!r},0.0,{lane}")
    return "\n".join(lines) + "\n"


def highd(cars, back=False):
    """Metres, y down, the box's upper left corner; ``back`` drives towards smaller x."""
    sign = -1 if back else 1
    lines = ["frame,id,x,y,width,height,xVelocity,yVelocity,xAcceleration,yAcceleration,laneId"]
    for car, frame, x, y, lane, v in rows(cars, 0.04):
        corner = sign * x - car.length_m / 2, -sign * y - car.width_m / 2
        size = (car.length_m, car.width_m)
        lines.append(
            f"{frame},{car.id}," + ",".join(map(repr, (*corner, *size))) + f",{sign * v!r},0,0,0,{lane}"
        )
    return "\n".join(lines) + "\n"

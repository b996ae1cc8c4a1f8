"""What is turned in the study of the map stream."""

from studies.accuracy_cost.study import Knob, Setting, Value

__all__ = ["KNOBS", "WHOLES"]

MARGIN = 0.1


def _turned(name: str, default: Value, *values: Value) -> tuple[Setting, ...]:
    return tuple(Setting(str(value), {} if value == default else {name: value}) for value in values)


KNOBS = (
    Knob(
        "step",
        "Step of the log-odds (stream.log_odds_step)",
        _turned("stream.log_odds_step", 0.25, 0.05, 0.1, 0.25, 0.5, 1.0, 2.0),
        None,
        MARGIN,
        "The first to turn up on a thin link: changes smaller than a step are not told.",
        quick=True,
    ),
    Knob(
        "level",
        "Cells that a client asks for: cubes of so many voxels along an edge",
        (
            Setting("1", {}),
            Setting("2", {"client.level": 1}),
            Setting("4", {"client.level": 2}),
            Setting("8", {"client.level": 3}),
        ),
        None,
        MARGIN,
        "A coarse map takes a fraction of the bytes, and thickens walls, as a cell tells the "
        "highest of its voxels.",
        quick=True,
    ),
    Knob(
        "detail",
        "What a client asks for of each cell",
        _turned("client.detail", "log_odds", "classes", "log_odds", "counts"),
        None,
        MARGIN,
        "Classes alone are enough for a picture or a planner that asks for obstacles alone.",
    ),
    Knob(
        "rate",
        "Looks for changes a second (stream.rate), of 5 pings a second",
        _turned("stream.rate", 5.0, 0.5, 1.0, 2.0, 5.0, 10.0),
        None,
        MARGIN,
        "Fewer looks tell a cell once that changed several times, and later.",
    ),
    Knob(
        "budget",
        "Bytes a second that a client is told at most (0: what the link carries)",
        _turned("stream.bytes_per_s", 0, 2000, 4000, 8000, 16000, 64000, 0),
        None,
        MARGIN,
        "What the link carries is found out by itself; a budget leaves room for others.",
    ),
    Knob(
        "near",
        "Radius that is told first, metres",
        _turned("study.near_m", 13.0, 3.0, 8.0, 13.0, 20.0, 40.0),
        None,
        MARGIN,
        "No setting: what is told first where a link is full.",
    ),
    Knob(
        "radius",
        "Radius that a client asks for, metres (0: the whole map)",
        _turned("client.radius_m", 0.0, 0.0, 5.0, 10.0, 15.0),
        None,
        MARGIN,
        "A client that steers asks for what is near alone.",
    ),
    Knob(
        "compression",
        "Level of zstd",
        _turned("study.compression", 9, 1, 3, 6, 9, 12, 19),
        None,
        MARGIN,
        "No setting: time of the daemon against bytes, once for all clients that keep up.",
    ),
)

WHOLES = (Setting("plain floats", {"study.plain": True}),)

"""Watch a daemon's map grow: `python examples/watch_map.py [ADDRESS [SECONDS]]`."""

import sys

from mapperd.client import LinkChanged, MapChanged, MapFollower

address = sys.argv[1] if len(sys.argv) > 1 else ""  # this computer's daemon
seconds = float(sys.argv[2]) if len(sys.argv) > 2 else None

with MapFollower(address, wants=("map", "pose"), name="watch_map") as daemon:
    for change in daemon.changes(seconds):
        if isinstance(change, LinkChanged):
            print(f"{change.link.state} {change.link.reason}")
        elif isinstance(change, MapChanged):
            walls = daemon.mirror.cells("occupied", keys=change.keys)
            print(f"{len(walls)} occupied cells in {len(change.keys)} blocks, {change.left} left")
            if daemon.pose is not None and len(walls):
                away_m = ((walls.centres_m - daemon.pose.position_m) ** 2).sum(axis=1) ** 0.5
                print(f"the nearest of them is {away_m.min():.1f} m away")
    if daemon.mirror is not None:
        daemon.mirror.to_map().save("watched.map")

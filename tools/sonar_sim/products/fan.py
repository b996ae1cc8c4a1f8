"""The ping as an operator sees it: the driver's own fan picture."""

import numpy as np
from numpy.typing import NDArray

from oculus_driver.errors import OculusError
from oculus_driver.ping import Ping, decode_ping
from oculus_driver.render import Painter, Style
from oculus_driver.stream import StreamParser
from sonar_sim.products.sounding import Sounding
from sonar_sim.wire import compass_heading_deg, ping_message


def ping_of(sounding: Sounding) -> Ping:
    """Send the ping through the sonar's protocol, and read it as the driver does."""
    image = sounding.image
    if image.dtype.kind == "f":
        image = np.rint(sounding.level * 65535.0).astype(np.uint16)
    message = ping_message(
        image,
        ping_id=sounding.ping_id,
        start_time_s=sounding.time_s,
        heading_deg=compass_heading_deg(sounding.map_T_sonar.rotation),
        sonar=sounding.sonar,
        water=sounding.scene.water,
    )
    parser = StreamParser()
    for found in (*parser.feed(message), *parser.finish()):
        ping = decode_ping(found)
        if isinstance(ping, Ping):
            return ping
    raise OculusError(f"ping {sounding.ping_id}: the driver cannot read it")


def fan_picture(sounding: Sounding, style: Style) -> NDArray[np.uint8]:
    """Draw with range rings, bearing spokes and captions; blue first."""
    return Painter(style).paint(ping_of(sounding))

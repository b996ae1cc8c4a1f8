"""A talker of NMEA 0183: sentences rendered by pynmea2, or by hand where it has none."""

from functools import reduce

import pynmea2


def sentence(body: str) -> bytes:
    """Return a sentence with checksum and line end."""
    check = reduce(lambda a, b: a ^ b, body.encode(), 0)
    return b"$%s*%02X\r\n" % (body.encode(), check)


class NmeaTalker:
    """One device; every method returns the bytes of one sentence.

    Args:
        time: hhmmss.ss; set it to let time pass.
        date: ddmmyy.
    """

    def __init__(self, time: str = "120000.50", date: str = "141123") -> None:
        self.time = time
        self.date = date

    def gga(
        self,
        lat: tuple[str, str] = ("4807.038", "N"),
        lon: tuple[str, str] = ("01131.000", "E"),
        quality: str = "1",
        altitude: str = "545.4",
    ) -> bytes:
        fields = (*lat, *lon, quality, "08", "0.9", altitude, "M", "46.9", "M", "", "")
        return self._rendered(pynmea2.GGA("GP", "GGA", (self.time, *fields)))

    def rmc(
        self, knots: str = "2.00", course: str = "90.0", status: str = "A", date: str | None = None
    ) -> bytes:
        fields = (status, "4807.038", "N", "01131.000", "E", knots, course)
        date = self.date if date is None else date
        return self._rendered(pynmea2.RMC("GP", "RMC", (self.time, *fields, date, "", "", "A")))

    def vtg(self, course: str = "90.0", knots: str = "2.00", kmh: str = "3.704") -> bytes:
        fields = (course, "T", "", "M", knots, "N", kmh, "K", "A")
        return self._rendered(pynmea2.VTG("GP", "VTG", fields))

    def hdt(self, heading: str = "90.0") -> bytes:
        return self._rendered(pynmea2.HDT("HE", "HDT", (heading, "T")))

    def zda(self, day: str = "14", month: str = "11", year: str = "2023") -> bytes:
        return self._rendered(pynmea2.ZDA("GP", "ZDA", (self.time, day, month, year, "00", "00")))

    def prdid(self, pitch: str, roll: str, heading: str) -> bytes:
        return sentence(f"PRDID,{pitch},{roll},{heading}")

    def pashr(self, heading: str, roll: str, pitch: str) -> bytes:
        return sentence(f"PASHR,{self.time},{heading},T,{roll},{pitch},+0.10,0.1,0.1,0.2,1,0")

    @staticmethod
    def _rendered(message: pynmea2.NMEASentence) -> bytes:
        return f"{message}\r\n".encode()

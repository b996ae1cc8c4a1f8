import io

from mapperd.cli.progress import ProgressBar
from tests.support.clocks import StandingClock


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


def test_terminal_gets_a_bar_with_rate_and_time_left() -> None:
    out, clock = Terminal(), StandingClock(100.0)
    bar = ProgressBar(out, clock)
    clock.now_s += 10
    bar.show(0.25, 200)
    assert "25.0 %" in out.getvalue()
    assert "20.0 pings/s" in out.getvalue()
    assert "0:30 left" in out.getvalue()
    assert "#######" in out.getvalue()
    bar.close(800)
    assert out.getvalue().endswith("\n")


def test_terminal_is_not_flooded() -> None:
    out, clock = Terminal(), StandingClock(100.0)
    bar = ProgressBar(out, clock)
    for step in range(1000):
        clock.now_s += 0.001
        bar.show(step / 1000, step)
    assert out.getvalue().count("\r") <= 10


def test_file_gets_a_line_every_few_seconds_only() -> None:
    out, clock = io.StringIO(), StandingClock(100.0)
    bar = ProgressBar(out, clock)
    for step in range(100):
        clock.now_s += 0.11
        bar.show(step / 100, step)
    bar.close(100)
    lines = out.getvalue().splitlines()
    assert len(lines) == 2
    assert all("\r" not in line and "left" in line for line in lines)


def test_strange_fractions_are_drawn_all_the_same() -> None:
    out, clock = Terminal(), StandingClock(100.0)
    bar = ProgressBar(out, clock)
    for fraction in (0.0, -1.0, 7.0):
        clock.now_s += 4000
        bar.show(fraction, 0)
    assert "? left" in out.getvalue()
    assert "0:00 left" in out.getvalue()


def test_output_that_fails_does_not_stop_the_work() -> None:
    class Full(Terminal):
        def write(self, _: str) -> int:
            raise OSError(28, "No space left on device")

    clock = StandingClock(100.0)
    bar = ProgressBar(Full(), clock)
    clock.now_s += 10
    bar.show(0.5, 1)
    bar.close(2)

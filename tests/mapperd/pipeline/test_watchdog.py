from mapperd.pipeline.watchdog import Watchdog, Worker


def test_idle_is_alive_for_ever() -> None:
    watchdog = Watchdog(10)
    for now_s in range(0, 1000, 5):
        assert watchdog.stuck([Worker("map", 0, 3)], now_s) == ()


def test_work_without_progress_is_not() -> None:
    watchdog = Watchdog(10)
    assert watchdog.stuck([Worker("map", 1, 3)], 0) == ()
    assert watchdog.stuck([Worker("map", 1, 3)], 10) == ()
    assert watchdog.stuck([Worker("map", 1, 3)], 10.1) == ("map",)
    assert watchdog.stuck([Worker("map", 9, 4)], 11) == ()  # it got on
    assert watchdog.stuck([Worker("map", 9, 4)], 21.5) == ("map",)


def test_time_counts_from_the_beginning_of_the_work() -> None:
    watchdog = Watchdog(10)
    watchdog.stuck([Worker("map", 0, 3)], 0)
    watchdog.stuck([Worker("map", 0, 3)], 100)
    assert watchdog.stuck([Worker("map", 1, 3)], 105) == ()
    assert watchdog.stuck([Worker("map", 1, 3)], 111) == ("map",)


def test_one_that_gets_on_does_not_hide_another() -> None:
    watchdog = Watchdog(10)
    for now_s in range(0, 20, 2):
        stuck = watchdog.stuck([Worker("map", 1, now_s), Worker("store", 1, 5)], now_s)
    assert stuck == ("store",)


def test_waiting_on_purpose_is_alive() -> None:
    watchdog = Watchdog(10)
    for now_s in range(0, 100, 5):
        held = Worker("recorder", 5, 1, held="no room on the disk")
        assert watchdog.stuck([held], now_s) == ()
    assert watchdog.stuck([Worker("recorder", 5, 1)], 104) == ()
    assert watchdog.stuck([Worker("recorder", 5, 1)], 106) == ("recorder",)

from mapperd.store.tiles import ResidentTiles


def tile(x: int) -> tuple[int, int, int]:
    return (x, 0, 0)


def test_the_least_recently_used_goes_first() -> None:
    tiles = ResidentTiles(3)
    tiles.use([tile(1), tile(2), tile(3)], 0)
    tiles.use([tile(1)], 1)
    assert tiles.missing([tile(1), tile(4)]) == [tile(4)]
    assert tiles.surplus(1, {tile(4)}) == [tile(2)]
    assert tiles.surplus(2, {tile(4), tile(5)}) == [tile(2), tile(3)]
    tiles.drop([tile(2)])
    assert tiles.all() == [tile(3), tile(1)]
    assert tiles.surplus(1, {tile(4)}) == []


def test_what_a_ping_needs_stays_even_where_it_is_too_much() -> None:
    tiles = ResidentTiles(2)
    needed = {tile(x) for x in range(5)}
    tiles.use([tile(x) for x in range(3)], 0)
    tiles.use([tile(9)], 0)
    assert tiles.surplus(2, needed) == [tile(9)]


def test_a_tile_may_have_changed_if_it_was_used_since_the_save() -> None:
    tiles = ResidentTiles(2)
    tiles.use([tile(1)], 4)  # the ping makes it revision 5
    tiles.use([tile(2)], 5)
    assert tiles.changed_since(5, tiles.all()) == {tile(2)}
    assert tiles.changed_since(4, tiles.all()) == {tile(1), tile(2)}
    assert tiles.changed_since(6, tiles.all()) == set()

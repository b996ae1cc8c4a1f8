"""The layouts, in both directions, against worked byte vectors."""

from __future__ import annotations

import math
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from oculus_driver.encode import (
    encode_dummy,
    encode_fire,
    encode_status,
    encode_user_config,
)
from oculus_driver.errors import EncodeError, ProtocolError
from oculus_driver.wire import (
    DUMMY,
    F64,
    FIRE_V1,
    FIRE_V2,
    HEADER,
    PING_RESULT_V1,
    PING_RESULT_V2,
    STATUS,
    U8,
    U16,
    U32,
    USER_CONFIG,
    Field,
    Layout,
    ping_result_layout,
)

LAYOUTS = (HEADER, FIRE_V1, FIRE_V2, PING_RESULT_V1, PING_RESULT_V2, STATUS, USER_CONFIG, DUMMY)

FIRE_1 = bytes.fromhex(
    "534f00000000150001002500000000000100ff7f4d0000000000003e40000000000000494000000000000000"
    "000000000000804140"
)
FIRE_2 = bytes.fromhex(
    "534f00000000150002004900000000000100ff7f4d0000000000003e40000000000000494000000000000000"
    "000000000000804140" + "00" * 36
)
FIRE_2_STANDBY = bytes.fromhex(
    "534f00000000150002004900000000000205ffff4f0000000000002440000000000000544000000000007097"
    "40000000000000000000020000" + "00" * 32
)
STATUS_DATAGRAM = bytes.fromhex(
    "534fd41effff010001007e0000000804d41e0000010008048300000003000201010423200300020101042320"
    "0200010001042320c0a80203ffffff00c0a8020a0050c2a1b2c3000000000000344000000000008034400000"
    "0000000035400000000000803540000000000000364000000000008036400000000000003740000000000080"
    "3740000000000000f43f"
)
USER_CONFIG_READ = bytes.fromhex("534f00000000550000000c0000000000000000000000000000000000")

RANGES: dict[str, st.SearchStrategy[Any]] = {
    U8: st.integers(0, 2**8 - 1),
    U16: st.integers(0, 2**16 - 1),
    U32: st.integers(0, 2**32 - 1),
    F64: st.floats(allow_nan=False),
}


def values_of(layout: Layout) -> st.SearchStrategy[dict[str, Any]]:
    def one(field: Field) -> st.SearchStrategy[Any]:
        if field.code.endswith("s"):
            size = int(field.code[:-1])
            return st.binary(min_size=size, max_size=size)
        value = RANGES[field.code]
        return value if field.count == 1 else st.tuples(*[value] * field.count)

    return st.fixed_dictionaries({field.name: one(field) for field in layout.fields})


def test_sizes_are_those_of_the_protocol() -> None:
    assert [layout.size for layout in LAYOUTS] == [16, 53, 89, 122, 202, 142, 28, 16]


@pytest.mark.parametrize("layout", LAYOUTS, ids=lambda layout: layout.name)
@given(data=st.data())
def test_unpacking_undoes_packing(layout: Layout, data: st.DataObject) -> None:
    values = data.draw(values_of(layout))
    packed = layout.pack(values)
    assert len(packed) == layout.size
    assert layout.unpack(packed) == values
    assert layout.unpack(b"x" + packed, 1) == values


def test_fire_version_1_is_the_worked_vector() -> None:
    made = encode_fire(version=1, mode=1, ping_rate=0, gamma=127, flags=0x4D, range_demand=30.0)
    assert made == FIRE_1
    fields = FIRE_V1.unpack(FIRE_1)
    assert fields["payload_size"] == 37
    assert (fields["mode"], fields["ping_rate"], fields["network_speed_mbps"]) == (1, 0, 255)
    assert (fields["gamma"], fields["flags"]) == (127, 0x4D)
    assert (fields["range_demand"], fields["gain_percent"]) == (30.0, 50.0)
    assert (fields["speed_of_sound_demand_mps"], fields["salinity_ppt"]) == (0.0, 35.0)


def test_fire_version_2_is_the_worked_vector() -> None:
    assert encode_fire(mode=1, ping_rate=0, gamma=127, flags=0x4D, range_demand=30.0) == FIRE_2
    assert FIRE_V2.unpack(FIRE_2)["extended_flags"] == 0


def test_fire_version_2_in_standby_is_the_worked_vector() -> None:
    made = encode_fire(
        mode=2,
        ping_rate=5,
        flags=0x4F,
        range_demand=10.0,
        gain_percent=80.0,
        speed_of_sound_demand_mps=1500.0,
        salinity_ppt=0.0,
        extended_flags=0x200,
    )
    assert made == FIRE_2_STANDBY
    fields = FIRE_V2.unpack(FIRE_2_STANDBY)
    assert (fields["ping_rate"], fields["extended_flags"]) == (5, 0x200)
    assert (fields["speed_of_sound_demand_mps"], fields["gain_percent"]) == (1500.0, 80.0)


def test_user_configuration_is_the_worked_vector() -> None:
    assert encode_user_config() == USER_CONFIG_READ
    assert USER_CONFIG.unpack(USER_CONFIG_READ)["address"] == 0


def test_user_configuration_writes_the_address_in_reverse() -> None:
    made = encode_user_config(address="192.168.2.3", netmask="255.255.255.0", dhcp=True)
    assert made[16:20] == bytes([3, 2, 168, 192])
    assert USER_CONFIG.unpack(made)["dhcp"] == 1


def test_status_is_the_worked_vector() -> None:
    made = encode_status(
        device_id=7892,
        part_number=1032,
        status_bits=0x83,
        arm0_version=0x01020003,
        arm0_date=0x20230401,
        arm1_version=0x01020003,
        arm1_date=0x20230401,
        fpga_version=0x00010002,
        fpga_date=0x20230401,
        address="192.168.2.3",
        client_address="192.168.2.10",
        mac=bytes.fromhex("0050c2a1b2c3"),
        temperatures_c=(20.0, 20.5, 21.0, 21.5, 22.0, 22.5, 23.0, 23.5),
        pressure_bar=1.25,
    )
    assert made == STATUS_DATAGRAM


def test_dummy_is_a_bare_header() -> None:
    assert encode_dummy() == bytes.fromhex("534f00000000ff000000000000000000")


def test_version_0_has_the_layout_of_version_1() -> None:
    assert ping_result_layout(0) is ping_result_layout(1) is PING_RESULT_V1
    assert ping_result_layout(2) is PING_RESULT_V2
    assert ping_result_layout(3) is None


def test_a_wrong_offset_is_found_when_the_layout_is_made() -> None:
    with pytest.raises(ProtocolError, match="declared at 5, is 4"):
        Layout("odd", 8, (Field("a", 0, U32), Field("b", 5, U32)))
    with pytest.raises(ProtocolError, match=r"\b9 bytes.*\b8\b"):
        Layout("odd", 9, (Field("a", 0, U32), Field("b", 4, U32)))
    with pytest.raises(ProtocolError, match="twice"):
        Layout("odd", 8, (Field("a", 0, U32), Field("a", 4, U32)))


def test_a_value_that_has_no_place_is_refused() -> None:
    with pytest.raises(EncodeError, match="has no field depth"):
        FIRE_V1.pack({"depth": 1})
    with pytest.raises(EncodeError):
        FIRE_V1.pack({"mode": 256})
    with pytest.raises(EncodeError, match="version 3"):
        encode_fire(version=3)
    with pytest.raises(EncodeError, match="extended_flags"):
        encode_fire(version=1, extended_flags=0x200)
    with pytest.raises(EncodeError):
        encode_status(device_id=1, temperatures_c=(1.0,))


def test_too_few_bytes_are_refused() -> None:
    with pytest.raises(ProtocolError, match="needs 53 bytes, 52 given"):
        FIRE_V1.unpack(FIRE_1[:52])
    with pytest.raises(ProtocolError):
        FIRE_V1.unpack(FIRE_1, -1)


def test_not_a_number_goes_over_the_wire() -> None:
    assert math.isnan(FIRE_V1.unpack(FIRE_V1.pack({"salinity_ppt": math.nan}))["salinity_ppt"])


def test_fields_are_found_by_name() -> None:
    assert PING_RESULT_V1.offset_of("image_offset") == 110
    assert PING_RESULT_V2.offset_of("image_offset") == 190

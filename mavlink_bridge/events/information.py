"""What systems say of themselves on request: versions, modes, places, missions, files, remote identification.

Fields as in `telemetry`.  Source: MAVLink common.xml.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from flightstack.types import Tuple3, Tuple4

_NAN = float("nan")
_EMPTY20 = bytes(20)


class CurrentMode(NamedTuple):
    """The mode in force and the one intended (they differ in a failsafe)."""

    standard_mode: int
    custom_mode: int
    intended_custom_mode: int


class AvailableModes(NamedTuple):
    """One mode of the list, `mode_index` from 1."""

    number_modes: int
    mode_index: int
    standard_mode: int
    custom_mode: int
    properties: int
    mode_name: str


class AvailableModesMonitor(NamedTuple):
    """Changes when the list of modes does."""

    seq: int


class AutopilotVersion(NamedTuple):
    """Who the autopilot is and what it can."""

    capabilities: int
    flight_sw_version: int
    """major << 24 | minor << 16 | patch << 8 | type."""
    middleware_sw_version: int = 0
    os_sw_version: int = 0
    board_version: int = 0
    flight_custom_version: bytes = bytes(8)
    middleware_custom_version: bytes = bytes(8)
    os_custom_version: bytes = bytes(8)
    vendor_id: int = 0
    product_id: int = 0
    uid: int = 0
    uid2: bytes = bytes(18)


class ProtocolVersion(NamedTuple):
    """MAVLink versions, times 100."""

    version: int
    min_version: int
    max_version: int
    spec_version_hash: bytes = bytes(8)
    library_version_hash: bytes = bytes(8)


class ComponentInformation(NamedTuple):
    """Where to find the component's general metadata (superseded by ComponentMetadata)."""

    t_boot_us: int
    general_metadata_file_crc: int
    general_metadata_uri: str
    peripherals_metadata_file_crc: int = 0
    peripherals_metadata_uri: str = ""


class ComponentMetadata(NamedTuple):
    """Where to find the component's general metadata."""

    t_boot_us: int
    file_crc: int
    uri: str


class FlightInformation(NamedTuple):
    """Times of this flight (UTC microseconds, 0 unknown)."""

    t_boot_us: int
    arming_utc_us: int
    takeoff_utc_us: int
    flight_uuid: int
    landing_us: int = 0
    """Since boot."""


class HomePosition(NamedTuple):
    """Where RTL goes."""

    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    pos_ned_m: Tuple3
    q_ned_frd: Tuple4
    approach_ned_m: Tuple3 = (0.0, 0.0, 0.0)
    t_us: int = 0


class GpsGlobalOrigin(NamedTuple):
    """The place of the local frame's origin."""

    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    t_us: int = 0


class SetGpsGlobalOrigin(NamedTuple):
    """A wish that the local frame begin elsewhere."""

    target_system: int
    lat_deg: float
    lon_deg: float
    alt_msl_m: float
    t_us: int = 0


class MissionCurrent(NamedTuple):
    """The mission item in force."""

    seq: int
    total: int = 0
    mission_state: int = 0
    mission_mode: int = 0
    mission_id: int = 0
    fence_id: int = 0
    rally_points_id: int = 0


class MissionRequestList(NamedTuple):
    """Ask for a mission's size; mission_type 0 mission, 1 fence, 2 rally points."""

    target_system: int
    target_component: int
    mission_type: int = 0


class MissionCount(NamedTuple):
    """A mission's size: the answer to a list request, or the start of an upload."""

    target_system: int
    target_component: int
    items: int
    mission_type: int = 0
    opaque_id: int = 0


class MissionClearAll(NamedTuple):
    """Delete a mission."""

    target_system: int
    target_component: int
    mission_type: int = 0


class MissionAck(NamedTuple):
    """End of a mission transfer (MAV_MISSION_RESULT)."""

    target_system: int
    target_component: int
    type: int
    mission_type: int = 0
    opaque_id: int = 0


class MissionRequestInt(NamedTuple):
    """Ask for one mission item."""

    target_system: int
    target_component: int
    seq: int
    mission_type: int = 0


class MissionRequest(NamedTuple):
    """The same, legacy."""

    target_system: int
    target_component: int
    seq: int
    mission_type: int = 0


class MissionSetCurrent(NamedTuple):
    """Jump to a mission item."""

    target_system: int
    target_component: int
    seq: int


class MissionItemInt(NamedTuple):
    """One mission item; params as in CommandInt."""

    target_system: int
    target_component: int
    seq: int
    frame: int
    command: int
    current: int
    autocontinue: int
    params: tuple[float, float, float, float, int, int, float]
    mission_type: int = 0


class MissionItem(NamedTuple):
    """The same, legacy: the place in degrees as floats."""

    target_system: int
    target_component: int
    seq: int
    frame: int
    command: int
    current: int
    autocontinue: int
    params: tuple[float, float, float, float, float, float, float]
    mission_type: int = 0


class MissionItemReached(NamedTuple):
    """A mission item has been reached, or what it asks for done."""

    seq: int


class FileTransferProtocol(NamedTuple):
    """MAVLink FTP, payload opaque here."""

    target_network: int
    target_system: int
    target_component: int
    payload: bytes


class OpenDroneIdLocation(NamedTuple):
    """Remote identification: where the aircraft is."""

    target_system: int
    target_component: int
    id_or_mac: bytes = _EMPTY20
    status: int = 0
    direction_deg: float = _NAN
    speed_horizontal_mps: float = _NAN
    speed_vertical_mps: float = _NAN
    """Up positive."""
    lat_deg: float = 0.0
    lon_deg: float = 0.0
    alt_barometric_m: float = -1000.0
    alt_geodetic_m: float = -1000.0
    height_reference: int = 0
    height_m: float = -1000.0
    horizontal_accuracy: int = 0
    vertical_accuracy: int = 0
    barometer_accuracy: int = 0
    speed_accuracy: int = 0
    timestamp_s: float = 0.0
    """Since the full hour."""
    timestamp_accuracy: int = 0


class OpenDroneIdSystem(NamedTuple):
    """Remote identification: who flies, from where."""

    target_system: int
    target_component: int
    id_or_mac: bytes = _EMPTY20
    operator_location_type: int = 0
    classification_type: int = 0
    operator_lat_deg: float = 0.0
    operator_lon_deg: float = 0.0
    area_count: int = 1
    area_radius_m: int = 0
    area_ceiling_m: float = -1000.0
    area_floor_m: float = -1000.0
    category_eu: int = 0
    class_eu: int = 0
    operator_alt_geo_m: float = -1000.0
    timestamp_s: int = 0
    """Since 2019-01-01 UTC."""

"""Other names of settings, former settings, and `amcl.restore_defaults`.

A setting has one name. What a file or a caller sets under another one (of other releases of
AMCL, and of Nav2's) is renamed before it is checked. Settings that were removed or
have no effect are ignored, and renamed values replaced, in files and in the settings of old
recordings and stores.
"""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any

import msgspec

from mapperd.config.catalog import parameters
from mapperd.config.tree import AmclConfig
from mapperd.errors import ConfigError

__all__ = [
    "ALIASES",
    "IGNORED",
    "RESTORE",
    "VALUE_ALIASES",
    "change_renamed",
    "restored_changes",
    "tree_renamed",
    "tree_updated",
]

FORMER = MappingProxyType(
    {
        "localization.rival_interval": "localization.alternative_interval",
        "localization.rival_tempering": "localization.alternative_tempering",
    }
)
"""Setting by its name in earlier versions."""

ALIASES = MappingProxyType(
    {
        **FORMER,
        "amcl.kld_err": "amcl.pf_err",
        "amcl.kld_z": "amcl.pf_z",
        "amcl.odom_model_type": "amcl.robot_model_type",
        **{f"amcl.alpha{k}": f"amcl.odom_alpha{k}" for k in range(1, 6)},
        "amcl.laser_max_beams": "amcl.max_beams",
        **{
            f"amcl.{name}": f"amcl.laser_{name}"
            for name in ("sigma_hit", "z_hit", "z_rand", "z_short", "lambda_short")
        },
        "amcl.initial_pose.x": "amcl.initial_pose_x",
        "amcl.initial_pose.y": "amcl.initial_pose_y",
        "amcl.initial_pose.yaw": "amcl.initial_pose_a",
        "amcl.initial_pose.covariance_x": "amcl.initial_cov_xx",
        "amcl.initial_pose.covariance_y": "amcl.initial_cov_yy",
        "amcl.initial_pose.covariance_yaw": "amcl.initial_cov_aa",
        "amcl.initial_pose.covariance_xy": "amcl.initial_cov_xy",
        "amcl.initial_pose.covariance_xyaw": "amcl.initial_cov_xa",
        "amcl.initial_pose.covariance_yyaw": "amcl.initial_cov_ya",
    }
)
"""Setting by its other name."""

VALUE_ALIASES = MappingProxyType(
    {
        "amcl.robot_model_type": MappingProxyType(
            {
                "diff-corrected": "differential_drive",
                "omni-corrected": "omnidirectional_drive",
                "nav2_amcl::DifferentialMotionModel": "differential_drive",
                "nav2_amcl::OmniMotionModel": "omnidirectional_drive",
            }
        )
    }
)
"""Value by its other name, by setting."""

REMOVED = ("mapping.error_bound", "behind.policy", "behind.error_bound")
"""Settings of earlier versions."""

NO_MAX_RANGE = "beams without a return do not count: smooth surfaces reflect sound away"

IGNORED = MappingProxyType(
    {
        "octree.dynamic_expansion": "the map always grows",
        "octree.use_cpp_backend": "the core is in C++",
        "amcl.scan_topic": "scans come from the sonar's pings",
        "amcl.map_service": "maps come from localization.map_path and `mapperctl set_map`",
        "amcl.laser_z_max": NO_MAX_RANGE,
        "amcl.z_max": NO_MAX_RANGE,
        "visualization.pointcloud_publish_rate": "set stream.rate",
        "visualization.show_opencv_visualization": "`mapperctl view` shows the sonar's image",
    }
)
"""Settings of the programs this one replaces that have no effect here, and why; any value loads."""

REPLACED = MappingProxyType({"mapping.integrator": ("projective", "evidence_grid")})
"""Value of an earlier version and the one that replaces it, by setting."""


MERGED = (
    (("address", "token_file", "tls_certificate", "tls_key"), "address", ("control", "stream")),
    (("socket", "mode"), "socket", ("control", "stream")),
    (("max_clients",), "max_clients", ("stream", "control")),
)
"""Settings of the former sections `control` and `stream` that `server` replaces.

By group: the fields that belong together, the field that decides which section has them, and the
sections in order of precedence.
"""


def change_renamed(changes: Mapping[str, Any]) -> dict[str, Any]:
    """Plain values by the settings' own names.

    Args:
        changes: by name or other name, `amcl.kld_err`.

    Raises:
        ConfigError: a setting is given under two names.
    """
    renamed: dict[str, Any] = {}
    for given, value in changes.items():
        name = ALIASES.get(given, given)
        if name in renamed:
            raise ConfigError(f"$.{given}: is an alias of {name}, which is also set", f"$.{given}")
        renamed[name] = _value(name, value)
    return renamed


def tree_renamed(tree: Mapping[str, Any]) -> dict[str, Any]:
    """A file's sections and values by the settings' own names; what is no section stays.

    Raises:
        ConfigError: a setting is given under two names.
    """
    section = tree.get("amcl")
    if not isinstance(section, dict):
        return dict(tree)
    flat: dict[Any, Any] = {}
    for field, value in section.items():
        inner = value if field == "initial_pose" and isinstance(value, dict) else None
        # Only aliases move; the rest stays in place, for messages.
        known = {k: v for k, v in (inner or {}).items() if f"amcl.initial_pose.{k}" in ALIASES}
        if inner is None or len(known) < len(inner):
            flat[field] = value
        else:
            flat |= {f"initial_pose.{key}": number for key, number in known.items()}
    named = {f"amcl.{key}": value for key, value in flat.items() if isinstance(key, str)}
    nameless = {key: value for key, value in flat.items() if not isinstance(key, str)}
    renamed = {name.removeprefix("amcl."): v for name, v in change_renamed(named).items()}
    return dict(tree) | {"amcl": nameless | renamed}


def tree_updated(tree: Mapping[str, Any]) -> tuple[dict[str, Any], tuple[str, ...]]:
    """Bring the settings of an earlier version up to date.

    Args:
        tree: sections and values; what is no section stays.

    Returns:
        the tree without ignored settings, and with settings and values under their present names;
        and what was changed: one phrase a setting, for people.
    """
    updated, phrases = _servers_merged(tree)
    _rename_former(updated, phrases)
    for name in (*REMOVED, *IGNORED, *REPLACED):
        section, field = name.split(".")
        fields = updated.get(section)
        if not isinstance(fields, dict) or field not in fields:
            continue
        if name not in REPLACED:
            updated[section] = {key: value for key, value in fields.items() if key != field}
            phrases.append(
                f"{name} was removed and is ignored"
                if name in REMOVED
                else f"{name} has no effect and is ignored ({IGNORED[name]})"
            )
        elif fields[field] == REPLACED[name][0]:
            updated[section] = fields | {field: REPLACED[name][1]}
            phrases.append("{}: {} is now {}".format(name, *REPLACED[name]))
    return updated, tuple(phrases)


def _rename_former(tree: dict[str, Any], phrases: list[str]) -> None:
    """Move settings to their present names; where both are set, the present name applies."""
    for name, present in FORMER.items():
        section, former = name.split(".")
        field = present.split(".")[1]
        fields = tree.get(section)
        if not isinstance(fields, dict) or former not in fields:
            continue
        rest = {key: value for key, value in fields.items() if key != former}
        ignored = field in rest
        tree[section] = rest if ignored else rest | {field: fields[former]}
        phrases.append(
            f"{name} is ignored: {present} applies" if ignored else f"{name} is now {present}"
        )


def _servers_merged(tree: Mapping[str, Any]) -> tuple[dict[str, Any], list[str]]:
    """Move what `control` and `stream` had for their own sockets to `server`."""
    names = ("server", "control", "stream")
    sections = {name: {} if tree.get(name) is None else tree[name] for name in names}
    if not all(isinstance(fields, dict) for fields in sections.values()):
        return dict(tree), []  # the check of the types reports it
    server, *rest_of = (dict(fields) for fields in sections.values())
    rest = dict(zip(("control", "stream"), rest_of, strict=True))
    phrases = []
    for fields, decisive, order in MERGED:
        source = next((name for name in order if sections[name].get(decisive)), order[0])
        for section in order:
            for field in fields:
                if field not in rest[section]:
                    continue
                value = rest[section].pop(field)
                if section == source and field not in server:
                    server[field] = value
                    phrases.append(f"{section}.{field} is now server.{field}")
                else:
                    phrases.append(
                        f"{section}.{field} is ignored: server.{field} applies to the map and to "
                        "requests"
                    )
    moved = {"server": server, **rest}
    kept = {name: value for name, value in tree.items() if name not in moved}
    return kept | {name: fields for name, fields in moved.items() if fields}, phrases


def _value(name: str, value: object) -> object:
    names = VALUE_ALIASES.get(name)
    return names.get(value, value) if names and isinstance(value, str) else value


RESTORE = "amcl.restore_defaults"


def restored_changes(changes: Mapping[str, Any], start: AmclConfig) -> dict[str, Any]:
    """The changes that a request means.

    Args:
        changes: plain values by name.
        start: the section at the program's start.

    Returns:
        The changes as they are; with `amcl.restore_defaults` true, all settings of `amcl` that may
        change while running at their values of the start, the request itself taken back.

    Raises:
        ConfigError: it is asked for together with another change of `amcl`.
    """
    if changes.get(RESTORE) is not True:
        return dict(changes)
    others = [name for name in changes if name.startswith("amcl.") and name != RESTORE]
    if others:
        raise ConfigError(
            f"$.{RESTORE}: undoes {', '.join(others)}; allowed: alone", f"$.{RESTORE}"
        )
    values = {f"amcl.{field}": value for field, value in msgspec.to_builtins(start).items()}
    live = {name: value for name, value in values.items() if parameters()[name].dynamic}
    return dict(changes) | live | {RESTORE: False}

"""Names of message types, which recorders spell in several ways."""

from __future__ import annotations

import re
from functools import cache

_SEPARATORS = re.compile(r"::|[/.]")
_INTERFACES = frozenset({"msg", "dds_"})  # between the package and the type in ROS 2 and in DDS


@cache
def type_name(schema_name: str) -> str:
    """Return the name of a message type as "package/Type", however the recorder spells it.

    sensor_msgs/msg/Image, sensor_msgs/Image, sensor_msgs::msg::Image and sensor_msgs::msg::dds_::Image_ are
    one type; so are foxglove.RawImage, foxglove::RawImage and foxglove_msgs/msg/RawImage.
    """
    package, *inner, name = (
        _SEPARATORS.split(schema_name) if _SEPARATORS.search(schema_name) else ("", schema_name)
    )
    middle = [part for part in inner if part not in _INTERFACES]
    if "dds_" in inner:
        name = name.removesuffix("_")
    return "/".join(["foxglove" if package == "foxglove_msgs" else package, *middle, name])

"""One kind of message that stands for what was found in a frame."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from inspect_pipeline.recording.types import Frame
    from lsnet.segments import Detections

ANNOTATIONS_SUFFIX = "/lsnet/annotations"
DETECTIONS_SUFFIX = "/lsnet/detections"


class AnnotationSchema(NamedTuple):
    """How a channel of annotations is declared and its messages are made.

    `data` is the schema as MCAP wants it; `encode` takes a frame and what was found in it, None when its
    image could not be decoded.
    """

    topic_suffix: str
    name: str
    encoding: str
    data: Callable[[], bytes]
    message_encoding: str
    encode: Callable[[Frame, Detections | None], bytes]
    channel_metadata: Mapping[str, str] = {}

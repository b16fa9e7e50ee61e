"""How a kind of annotation message is declared and encoded."""

from __future__ import annotations

from typing import TYPE_CHECKING, NamedTuple

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from inspect_pipeline.recording.types import Frame
    from lsnet.segments import Detections

ANNOTATIONS_SUFFIX = "/lsnet/annotations"
DETECTIONS_SUFFIX = "/lsnet/detections"


class AnnotationSchema(NamedTuple):
    """A channel of annotations.

    topic_suffix: what its topic adds to that of the images. data: returns the schema as it stands in the
    file. encode: makes a message of a frame, of its detections (None when its image could not be decoded),
    and of the least score of a detection.
    """

    topic_suffix: str
    name: str
    encoding: str
    data: Callable[[], bytes]
    message_encoding: str
    encode: Callable[[Frame, Detections | None, float], bytes]
    channel_metadata: Mapping[str, str] = {}

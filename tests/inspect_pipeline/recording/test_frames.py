from __future__ import annotations

from inspect_pipeline.recording.frames import FrameChecks
from inspect_pipeline.recording.types import Frame


def warnings(*stamps: tuple[str, int]) -> list[str]:
    check = FrameChecks()
    for i, (topic, stamp_ns) in enumerate(stamps):
        check.check(Frame(1, topic, i, i, i, stamp_ns, "cam", None, "no image"))
    return list(check.warnings())


def test_stamps_in_order_give_no_warning() -> None:
    assert warnings(("/a", 1), ("/b", 1), ("/a", 2), ("/b", 2)) == []
    assert warnings() == []


def test_ambiguous_stamps_give_a_warning() -> None:
    assert warnings(*[("/a", 0)] * 1200, ("/b", 5)) == ["/a: 1,200 images without a header stamp"]
    assert warnings(("/a", 5), ("/a", 5), ("/a", 5), ("/a", 6)) == [
        "/a: 2 images with the header stamp of the one before"
    ]
    assert warnings(("/b", 5), ("/b", 4), ("/a", 0), ("/b", 6)) == [
        "/a: 1 image without a header stamp",
        "/b: 1 image with a header stamp before that of the one before",
    ]

"""The network on the CPU by OpenVINO."""

from __future__ import annotations

import os
from collections import OrderedDict, deque
from queue import Empty, SimpleQueue
from threading import Lock
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from lsnet.runtime.choice import import_openvino, openvino_core
from lsnet.runtime.networks import convert_network, read_network

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from lsnet.arrays import ImageArray, Maps
    from lsnet.model import LSNet
    from lsnet.weights_file import WeightsFile

KEPT = 3  # times the pixels that run at once: of the compiled networks that are kept for further images


class _Compiled(NamedTuple):
    """A network for one image size: its idle requests, and the pixels that they run at once."""

    idle: SimpleQueue[Any]
    n_pixels: int


class _Running(NamedTuple):
    """A request, where it goes when it is done, and the image, which it reads."""

    request: Any
    idle: SimpleQueue[Any]
    image: ImageArray


class OpenVinoBackend:
    """OpenVINO on the CPU: an image per core, fewer if they are large; a compiled network per image size."""

    name = "openvino"
    n_images = 1

    def __init__(self, model: Any, precision: str, max_pixels: int, threads: int | None = None) -> None:
        """Take a network that was converted for OpenVINO.

        Args:
            model: The network.
            precision: f32, bf16 or int8.
            max_pixels: Pixels that run at once.
            threads: Default: one per core.
        """
        _prepare_tensors()
        self._model, self.precision, self._max_pixels = model, precision, max_pixels
        self.threads = self.n_calls = threads or len(os.sched_getaffinity(0))
        self._compiled: OrderedDict[tuple[int, int], _Compiled] = OrderedDict()
        self._lock = Lock()

    @classmethod
    def open(cls, weights: WeightsFile, precision: str, threads: int | None = None) -> OpenVinoBackend:
        """Read the converted network that is kept beside weights; without one, convert them.

        Raises:
            LSNetError: OpenVINO is not installed, or NNCF to convert to int8; the weights cannot be used.
        """
        model = read_network(weights, precision)
        if model is not None:
            return cls(model, precision, weights.card.network.pixels_at_once, threads)
        from lsnet.weights import load_network  # noqa: PLC0415 - imports torch

        return cls.convert(load_network(weights), precision, threads)

    @classmethod
    def convert(cls, net: LSNet, precision: str = "f32", threads: int | None = None) -> OpenVinoBackend:
        """Convert a network. Raises LSNetError without OpenVINO, or without NNCF for int8."""
        return cls(convert_network(net, precision), precision, net.config.pixels_at_once, threads)

    def run(self, images: Sequence[ImageArray]) -> Iterator[Maps]:
        """Yield the raw maps of each image, in order; the next ones run meanwhile."""
        running: deque[_Running] = deque()
        done: deque[Maps] = deque()
        try:
            for image in images:
                idle = self._compiled_for(*image.shape[:2]).idle
                while (request := _take(idle, is_awaited=not running)) is None:
                    done.append(_finish(running.popleft()))
                with self._lock:
                    request.start_async({0: image[None]}, share_inputs=True)
                running.append(_Running(request, idle, image))
                while done:
                    yield done.popleft()
            while running:
                yield _finish(running.popleft())
        finally:
            for each in running:  # the caller wants no more
                _finish(each)

    def _compiled_for(self, height: int, width: int) -> _Compiled:
        """Return the network for an image size; those not used for longest are dropped for memory."""
        with self._lock:
            size = (height, width)
            found = self._compiled.pop(size, None) or self._compile(height, width)
            self._compiled[size] = found
            while (
                len(self._compiled) > 1
                and sum(each.n_pixels for each in self._compiled.values()) > KEPT * self._max_pixels
            ):
                self._compiled.popitem(last=False)
            return found

    def _compile(self, height: int, width: int) -> _Compiled:
        model = self._model.clone()
        model.reshape([1, height, width, 3])
        streams = max(1, min(self.threads, self._max_pixels // (height * width)))
        options: dict[str, Any] = {
            "INFERENCE_PRECISION_HINT": "f32" if self.precision == "int8" else self.precision,
            "NUM_STREAMS": str(streams),
            "INFERENCE_NUM_THREADS": str(self.threads),
            "ENABLE_CPU_PINNING": False,  # else every process of one thread computes on the first core
        }
        compiled = openvino_core().compile_model(model, "CPU", options)
        idle: SimpleQueue[Any] = SimpleQueue()
        for _ in range(streams + 1):  # one waits, so that no stream does
            idle.put(compiled.create_infer_request())
        return _Compiled(idle, streams * height * width)


def _prepare_tensors() -> None:
    """Make a tensor of an array, and an array of it.

    OpenVINO initialises its use of NumPy at the first of each, and deadlocks when two threads do it at once:
    one waits for the lock of the interpreter, the other for the end of the initialisation.
    """
    _ = import_openvino().Tensor(np.zeros((1, 1, 1, 3), np.uint8), shared_memory=True).data


def _take(idle: SimpleQueue[Any], *, is_awaited: bool) -> Any | None:
    """Take an idle request; None if there is none. Whoever awaits one must keep none running."""
    try:
        return idle.get(block=is_awaited)
    except Empty:
        return None


def _finish(one: _Running) -> Maps:
    """Wait for a request, and return its maps."""
    try:
        one.request.wait()
        scores, endpoints = (one.request.get_output_tensor(k).data[0].copy() for k in (0, 1))
        return scores, endpoints
    finally:
        one.idle.put(one.request)

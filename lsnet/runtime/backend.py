"""What runs a network: torch, or OpenVINO if installed.

A backend takes uint8 RGB images (H, W, 3), H and W multiples of 16, and returns the raw maps of each: scores
(R, C) and endpoints (R, C, 4) in cell fractions, float32. On a CPU a stacked batch is slower than its images
one by one, so there the backends run one image per stream; on a GPU images of one size are stacked.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Protocol

from lsnet.runtime.choice import choose_backend, choose_device

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from lsnet.arrays import ImageArray, Maps
    from lsnet.weights_file import WeightsFile


class Backend(Protocol):
    """A network that is ready to run; several threads may use it at once.

    Attributes:
        name: torch or openvino.
        precision: f32, bf16, f16 or int8.
        threads: Of the CPU, for one image or several.
        n_calls: Calls of `run` at a time that keep it busy.
        n_images: Images in a call that run at a time.
    """

    name: str
    precision: str
    threads: int
    n_calls: int
    n_images: int

    def run(self, images: Sequence[ImageArray]) -> Iterable[Maps]:
        """Return the raw maps of each image, in order; later images may run while the first are looked at.

        A call is to end before the next one of the same thread begins: until then it keeps what it runs on.
        """
        ...


def open_backend(
    weights: WeightsFile, runtime: str, device: str | None = None, threads: int | None = None
) -> Backend:
    """Open a backend by the name of a runtime, see `choose_backend`.

    Networks that were converted for OpenVINO and kept beside the weights are used, so that torch need not be
    imported; without them the weights are converted.

    Raises:
        LSNetError: The runtime or the device is unknown or cannot be used, or the weights cannot.
    """
    device = choose_device(device)
    name, precision = choose_backend(runtime, has_gpu=device != "cpu")
    if name == "openvino":
        from lsnet.runtime.openvino import OpenVinoBackend  # noqa: PLC0415 - without OpenVINO torch will do

        return OpenVinoBackend.open(weights, precision, threads)
    from lsnet.runtime.torch import TorchBackend  # noqa: PLC0415 - takes seconds to import
    from lsnet.weights import load_network  # noqa: PLC0415

    return TorchBackend(load_network(weights), precision, device, threads)

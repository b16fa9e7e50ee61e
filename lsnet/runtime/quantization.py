"""8-bit quantization of the network by NNCF (extra `int8`)."""

from __future__ import annotations

import io
import logging
from contextlib import redirect_stdout
from importlib.util import find_spec
from typing import Any

from lsnet.errors import LSNetError

CALIBRATION_SCENES, CALIBRATION_PX = 32, 384


def quantize_int8(model: Any) -> Any:
    """Quantize an OpenVINO network to 8-bit integers, with ranges and biases measured on a few drawn scenes.

    The scenes are always the same, so the same network gives the same result. Each has a black and a white
    pixel: the input then has the range of pixels, which 8 bits hold exactly.

    Raises:
        LSNetError: NNCF is not installed.
    """
    if find_spec("nncf") is None:
        raise LSNetError("NNCF is not installed; pip install 'lsnet-pipe[int8]', or use the runtime openvino")
    import nncf  # noqa: PLC0415 - an extra

    # The only use of training code for inference, where no quantized network is kept beside the weights.
    from lsnet.synth.backgrounds import BackgroundPool  # noqa: PLC0415
    from lsnet.synth.dataset import SyntheticScenes  # noqa: PLC0415

    nncf.set_log_level(logging.ERROR)
    scenes = SyntheticScenes(BackgroundPool([]), CALIBRATION_PX)
    images = [scenes[i].image for i in range(CALIBRATION_SCENES)]
    for image in images:
        image[0, :2] = [[0], [255]]
    with redirect_stdout(io.StringIO()):  # NNCF prints progress bars
        return nncf.quantize(
            model,
            nncf.Dataset([image[None] for image in images]),
            preset=nncf.QuantizationPreset.MIXED,
            subset_size=CALIBRATION_SCENES,
            fast_bias_correction=False,  # the slower one leaves half of the error in scores
        )

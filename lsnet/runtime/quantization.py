"""8-bit quantization of the network by NNCF (extra `int8`)."""

from __future__ import annotations

import io
import logging
from contextlib import redirect_stdout
from importlib.util import find_spec
from typing import Any

from lsnet.errors import LSNetError

CALIBRATION_SCENES, CALIBRATION_PX = 16, 384


def quantize_int8(model: Any) -> Any:
    """Quantize an OpenVINO network to 8-bit integers, with ranges measured on a few drawn scenes.

    The scenes are always the same, so the same network gives the same result.

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
    images = nncf.Dataset([scenes[i].image[None] for i in range(CALIBRATION_SCENES)])
    with redirect_stdout(io.StringIO()):  # NNCF prints progress bars
        return nncf.quantize(
            model, images, preset=nncf.QuantizationPreset.MIXED, subset_size=CALIBRATION_SCENES
        )

"""LPIPS over a scene's test views: which networks are available, and which views each measures.

LPIPS-Alex is measured on every view. LPIPS-VGG costs 27 times as much: 21 s of one core and 1.8 GB for 1352 × 1014
pixels, nearly two hours for the 300 frames of a Plenoptic Video scene. It is measured on evenly spread views of
VGG_PIXELS in total.
"""

from __future__ import annotations

import numpy as np

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at, evenly_spaced
from pipeline.evaluation import lpips

NETS = ("alex", "vgg")
VGG_PIXELS = 50e6  # 36 views of 1352 × 1014; all views of D-NeRF at 400 × 400 and of the synthetic scenes
VGG_BYTES_PER_PIXEL = 1300  # memory in use


class Perceptual:
    """Measures LPIPS of single views."""

    def __init__(self, cfg: Config, scene: Scene) -> None:
        """Loads the networks whose weights are available. `note`: why others are missing, or which views a mean has."""
        self._networks: dict[str, lpips.Lpips | None] = dict.fromkeys(NETS)
        self.note: str | None = None
        camera = camera_at(scene.test[0].camera, cfg.train.resolution_scale)
        count, pixels = len(scene.test), camera.width * camera.height
        self._vgg_views = set(evenly_spaced(count, max(1, int(VGG_PIXELS / pixels))))
        if not cfg.evaluate.lpips:
            self.note = "not measured: evaluate.lpips=false"
        elif min(camera.width, camera.height) < lpips.SMALLEST_SIDE:
            self.note = f"LPIPS needs images of at least {lpips.SMALLEST_SIDE} px a side"
        else:
            for net in NETS:
                try:
                    self._networks[net] = lpips.load(net)
                except lpips.LpipsUnavailable as error:
                    self.note = self.note or str(error)
            if self._networks["vgg"] is not None and len(self._vgg_views) < count:
                self.note = self.note or f"LPIPS-VGG is of {len(self._vgg_views)} of the {count} test views"

    @property
    def bytes_per_pixel(self) -> int:
        """Memory that `measure` needs in addition to the other metrics."""
        return 0 if self._networks["vgg"] is None else VGG_BYTES_PER_PIXEL

    def measure(self, index: int, image: np.ndarray, truth: np.ndarray, net: str) -> float | None:
        """LPIPS of test view `index`, images (H, W, 3) in [0, 1]; None where a network is missing or skips the view."""
        network = self._networks[net]
        return network(image, truth) if network and (net != "vgg" or index in self._vgg_views) else None

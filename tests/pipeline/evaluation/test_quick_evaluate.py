"""The quick evaluation against the full one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from tiny import evaluation_config, tiny_config, tiny_scene
from tiny_film import tiny_film

from pipeline.evaluation import quick_evaluate as evaluation
from pipeline.evaluation.evaluate import evaluate
from pipeline.evaluation.moving_pixels import MovingPixels
from pipeline.evaluation.quick_evaluate import held_out_psnr, quick_evaluate
from pipeline.model.initialise import initialise
from pipeline.model.model import Model
from rasterizer import Rasterizer


@pytest.fixture(scope="module")
def model() -> Model:
    return initialise(tiny_scene(), tiny_config(), np.random.default_rng(0))


def test_psnr_equals_that_of_the_full_evaluation(model: Model) -> None:
    scene, cfg = tiny_scene(), evaluation_config()
    full = evaluate(model, scene, cfg, 1)
    quick = quick_evaluate(model, scene, cfg, Rasterizer(threads=1))
    # The same renders; float32 sums in another order.
    assert quick["psnr"] == pytest.approx(full.metrics["psnr"], abs=1e-4)
    assert 0 < quick["ssim"] < 1 and 0 < quick["test_loss"] < 1
    assert held_out_psnr(model, scene, cfg, 1).tolist() == [row["psnr"] for row in full.per_image]


def test_views_are_evenly_spread(model: Model, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, cfg = tiny_film(frames=5, held_out=("cam00",)), evaluation_config()
    monkeypatch.setattr(evaluation, "EVAL_VIEWS", 3)
    moving = MovingPixels(scene, 1.0)  # by the colours of all frames
    found = quick_evaluate(model, scene, cfg, Rasterizer(threads=1), moving)
    spread = replace(scene, test=scene.test[::2], train=tuple(scene.train[i] for i in (0, len(scene.train) // 2, -1)))
    assert found == quick_evaluate(model, spread, cfg, Rasterizer(threads=1), moving)
    monkeypatch.undo()
    assert found != quick_evaluate(model, scene, cfg, Rasterizer(threads=1))


def test_pixels_outside_a_mask_do_not_count_in_decisions(model: Model) -> None:
    """The half that the mask leaves out is white: the PSNR is that of the other. A mask that leaves none is ignored."""
    scene, cfg = tiny_scene(), evaluation_config()
    view = scene.test[0]
    left = np.zeros(view.image.shape[:2], bool)
    left[:, : left.shape[1] // 2] = True
    white = replace(view, image=np.where(left[..., None], view.image, 255).astype(np.uint8))

    def of(mask: np.ndarray | None) -> float:
        return float(held_out_psnr(model, replace(scene, test=(replace(white, mask=mask),)), cfg, 1)[0])

    counted = evaluate(model, replace(scene, test=(replace(view, mask=left),)), cfg, 1).metrics["psnr_masked"]
    assert of(left) == counted != of(None)
    masked = replace(scene, test=(replace(white, mask=left),))
    curve = quick_evaluate(model, masked, cfg, Rasterizer(threads=1))["psnr"]
    assert curve == pytest.approx(counted), "the best model is chosen by it"
    assert of(np.zeros_like(left)) == of(None)

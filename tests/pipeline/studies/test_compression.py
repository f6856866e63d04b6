"""Compression: pruning by sensitivity, storage in fewer bits, retraining, the choice of the smallest model."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from builders import generator, random_gaussians
from tiny import tiny_config, tiny_scene, train_tiny

from pipeline.evaluation.quick_evaluate import held_out_psnr
from pipeline.model.initialise import initialise
from pipeline.model.model import Model, ModelKind
from pipeline.studies.compression.__main__ import measure, smallest
from pipeline.studies.compression.pruning import prune_by_sensitivity, retrain
from pipeline.studies.compression.storage import LEVELS, PRECISIONS, load_compressed, save_compressed
from pipeline.training.density.sensitivity_pruning import image_sensitivity


@pytest.fixture
def trained(tmp_path):
    return train_tiny(tmp_path / "run", tiny_config(40)).model


def test_pruning_keeps_the_most_sensitive_in_their_order(trained):
    sensitivity = torch.randn(len(trained), generator=torch.Generator().manual_seed(0))
    small = prune_by_sensitivity(trained, sensitivity, 0.25)
    count = round(0.25 * len(trained))
    kept = sorted(sorted(range(len(trained)), key=lambda i: -float(sensitivity[i]))[:count])
    for name, tensor in small.parameters.items():
        assert torch.equal(tensor, trained.parameters[name][kept])


def test_float32_is_exact_except_for_quaternion_norms(trained, tmp_path):
    save_compressed(tmp_path / "m", trained, "float32")
    back = load_compressed(tmp_path / "m")
    for name, tensor in trained.parameters.items():
        if not name.startswith("quat"):
            assert torch.equal(back.parameters[name], tensor)
    # 3e-7: normalization in float32
    torch.testing.assert_close(
        back.parameters["quat_left"], torch.nn.functional.normalize(trained.parameters["quat_left"]), rtol=0, atol=3e-7
    )


def test_float16_halves_the_size_within_rounding(trained, tmp_path):
    whole, half = save_compressed(tmp_path / "w", trained, "float32"), save_compressed(tmp_path / "h", trained)
    values = sum(t.numel() for t in trained.parameters.values())
    assert whole - half == pytest.approx(2 * (values - trained.parameters["mean"].numel()), abs=64)  # the file's header
    back = load_compressed(tmp_path / "h")
    assert torch.equal(back.parameters["mean"], trained.parameters["mean"])
    for name in ("log_scale", "opacity_logit", "sh"):
        # float16 rounds to 2^-11 of a value; below 6e-5 its spacing is 6e-8.
        torch.testing.assert_close(back.parameters[name], trained.parameters[name], rtol=2**-11, atol=6e-8)


def test_int8_coefficients_are_within_half_a_step(trained, tmp_path):
    trained.parameters["sh"][3, 1:] = 0.0  # the largest coefficient is zero
    half, eight = save_compressed(tmp_path / "h", trained), save_compressed(tmp_path / "e", trained, "int8")
    others = trained.parameters["sh"][:, 1:]
    assert half - eight == pytest.approx(
        others.numel() - 4 * len(trained), abs=256
    )  # one step for each Gaussian; the file's header
    back = load_compressed(tmp_path / "e").parameters
    step = others.abs().amax(dim=(1, 2), keepdim=True) / LEVELS
    # Half a step, and float32 rounding of the quotient and the product.
    assert ((back["sh"][:, 1:] - others).abs() <= 0.5 * step * (1 + 1e-4)).all()
    assert (back["sh"][3, 1:] == 0).all()
    same = load_compressed(tmp_path / "h").parameters
    assert all(torch.equal(back[name], same[name]) for name in back if name != "sh")
    assert torch.equal(back["sh"][:, 0], same["sh"][:, 0])


def test_int8_of_a_model_with_one_coefficient(tmp_path):
    model = initialise(tiny_scene(static=True), tiny_config(), np.random.default_rng(0))
    bare = Model.restored(ModelKind("static", 0, 0), {**model.state(), "sh": model.parameters["sh"][:, :1]})
    save_compressed(tmp_path / "m", bare, "int8")
    assert torch.equal(load_compressed(tmp_path / "m").parameters["sh"], bare.parameters["sh"].half().float())


@pytest.mark.parametrize("content", [b"", b"not one", b"\x02\0\0\0\0\0\0\0{}"])
def test_foreign_file_is_an_error(tmp_path, content):
    (tmp_path / "m").write_bytes(content)
    with pytest.raises(ValueError, match="m: expected a compressed model, found"):
        load_compressed(tmp_path / "m")


def test_points_start_with_the_full_model_and_smallest_respects_max_loss(trained):
    scene, cfg = tiny_scene(), tiny_config()
    sensitivity = image_sensitivity(trained, scene.train, scene, cfg, 1.0, np.random.default_rng(0), threads=1)
    models = {1.0: trained, 0.5: prune_by_sensitivity(trained, sensitivity, 0.5)}
    points = measure(models, scene, cfg)
    assert [(p.fraction, p.precision) for p in points] == [(f, p) for p in PRECISIONS for f in (1.0, 0.5)]
    assert smallest(points, max_loss=100.0) is points[5]
    assert smallest(points, max_loss=0.0).psnr >= points[0].psnr


def test_retraining_recovers_psnr_at_a_fixed_number_of_gaussians(trained):
    scene, cfg = tiny_scene(), tiny_config(200)
    small = prune_by_sensitivity(trained, torch.rand(len(trained), generator=torch.Generator().manual_seed(0)), 0.3)
    before, full, evaluated = held_out_psnr(small, scene, cfg, threads=1).mean(), trained.copy(), []

    def evaluate_fn(model, progress):
        evaluated.append(progress.iteration)
        return {"psnr": 0.0}

    after = retrain(small, scene, cfg, 0.5, evaluate_fn)
    assert evaluated == [200] and len(after) == len(small)
    assert held_out_psnr(after, scene, cfg, threads=1).mean() > before + 1  # dB; 100 iterations gain 2 dB
    for name, tensor in full.parameters.items():
        assert torch.equal(trained.parameters[name], tensor)


def test_retraining_for_zero_share_changes_nothing(trained):
    before = trained.copy()
    after = retrain(trained, tiny_scene(), tiny_config(40), 0.0, lambda model, progress: {"psnr": 0.0})
    for name, tensor in before.parameters.items():
        assert torch.equal(after.parameters[name], tensor)


def test_retraining_begins_late_in_the_schedule():
    """From iteration 30 of 40: ten iterations, with the SH degree that the schedule has there."""
    scene, cfg = tiny_scene(), tiny_config(40)
    model, evaluated = initialise(scene, cfg, np.random.default_rng(0)), []

    def evaluate_fn(model, progress):
        evaluated.append(progress.iteration)
        return {"psnr": 0.0}

    after = retrain(model, scene, cfg, 0.25, evaluate_fn)
    assert evaluated == [40] and after.parameters["sh"][:, 4:16].any()  # degree 2, from iteration 30 on


def test_pruning_to_fraction_zero_keeps_one_gaussian(trained):
    sensitivity = torch.zeros(len(trained))
    sensitivity[7] = 1.0
    assert torch.equal(
        prune_by_sensitivity(trained, sensitivity, 0.0).parameters["mean"], trained.parameters["mean"][7:8]
    )


def test_retraining_keeps_the_number_of_gaussians(trained):
    cfg = tiny_config(60)
    rules = replace(
        cfg.train.densify, prune_sensitivity=0.1, prune_sensitivity_every=10,
        add_by_error=1.0, add_by_error_every=10,
    )  # fmt: skip
    cfg = replace(cfg, train=replace(cfg.train, densify=rules))
    after = retrain(trained.copy(), tiny_scene(), cfg, 0.8, lambda model, progress: {"psnr": 0.0})
    assert len(after) == len(trained)


@pytest.mark.parametrize("precision", PRECISIONS)
def test_shared_trajectories_are_kept(precision, tmp_path):
    gaussians = random_gaussians(30, "shared", generator(1)).to(torch.float32)
    model = Model.from_gaussians(gaussians)
    save_compressed(tmp_path / "m", model, precision)
    back = load_compressed(tmp_path / "m")
    assert back.kind == model.kind and back.trajectories.span == model.trajectories.span
    assert torch.equal(back.trajectories.control_points, model.trajectories.control_points)
    # float16 rounds to 2^-11 of a weight
    torch.testing.assert_close(back.parameters["weights"], model.parameters["weights"], rtol=2**-11, atol=6e-8)


def test_retraining_goes_on_with_the_trajectories(tmp_path):
    cfg = tiny_config(60, motion="trajectories")
    trained = train_tiny(tmp_path / "run", cfg).model
    assert trained.trajectories is not None and trained.parameters["weights"].any()
    small = prune_by_sensitivity(trained, torch.rand(len(trained), generator=torch.Generator().manual_seed(0)), 0.5)
    before = small.copy()
    after = retrain(small, tiny_scene(), cfg, 1 / 60, lambda model, progress: {"psnr": 0.0})
    # One step of Adam: the first moves a value by its learning rate at most, far less than a weight
    for name, old in (("weights", before.parameters["weights"]), ("trajectories", before.state()["trajectories"])):
        new = after.state()[name]
        assert not torch.equal(new, old)
        assert (new - old).abs().max() < 0.05 * old.abs().max(), name

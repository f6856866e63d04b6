"""What is left out of a model, and how it is stored: against the model itself."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from tiny import TinyRun, fake_evaluate, tiny_config, tiny_scene, train_tiny

from pipeline.evaluation.evaluate import held_out_psnr
from pipeline.model.initialise import initialise
from pipeline.model.model import Model, ModelKind
from pipeline.studies.compression.__main__ import main, measure, smaller, smallest
from pipeline.studies.compression.importance import keep_most_important
from pipeline.studies.compression.retrain import retrained
from pipeline.studies.compression.storage import LEVELS, PRECISIONS, load_compact, save_compact
from pipeline.training.density.sensitivity_pruning import image_sensitivity
from pipeline.training.loop import train


@pytest.fixture
def trained(tmp_path):
    return train_tiny(tmp_path / "run", tiny_config(40)).model


def test_the_most_important_stay_in_their_order(trained):
    worth = torch.randn(len(trained), generator=torch.Generator().manual_seed(0))
    small = keep_most_important(trained, worth, 0.25)
    count = round(0.25 * len(trained))
    kept = sorted(sorted(range(len(trained)), key=lambda i: -float(worth[i]))[:count])
    for name, tensor in small.parameters.items():
        assert torch.equal(tensor, trained.parameters[name][kept])


def test_single_precision_is_exact_but_for_the_quaternions_length(trained, tmp_path):
    save_compact(tmp_path / "m", trained, "float32")
    back = load_compact(tmp_path / "m")
    for name, tensor in trained.parameters.items():
        if not name.startswith("quat"):
            assert torch.equal(back.parameters[name], tensor)
    # 3e-7: a normalisation in float32.
    torch.testing.assert_close(
        back.parameters["quat_left"], torch.nn.functional.normalize(trained.parameters["quat_left"]), rtol=0, atol=3e-7
    )


def test_half_precision_is_half_as_large_and_nearly_the_same(trained, tmp_path):
    whole, half = save_compact(tmp_path / "w", trained, "float32"), save_compact(tmp_path / "h", trained)
    values = sum(t.numel() for t in trained.parameters.values())
    assert whole - half == pytest.approx(
        2 * (values - trained.parameters["mean"].numel()), abs=64
    )  # the header's words
    back = load_compact(tmp_path / "h")
    assert torch.equal(back.parameters["mean"], trained.parameters["mean"])
    for name in ("log_scale", "opacity_logit", "sh"):
        # Half precision rounds to 2^-11 of a value; below 6e-5 its steps are 6e-8.
        torch.testing.assert_close(back.parameters[name], trained.parameters[name], rtol=2**-11, atol=6e-8)


def test_eight_bits_are_a_quarter_of_the_coefficients_and_err_by_half_a_step(trained, tmp_path):
    trained.parameters["sh"][3, 1:] = 0.0  # no largest to divide by
    half, eight = save_compact(tmp_path / "h", trained), save_compact(tmp_path / "e", trained, "int8")
    others = trained.parameters["sh"][:, 1:]
    assert half - eight == pytest.approx(others.numel() - 4 * len(trained), abs=256)  # a step each; the header's words
    back = load_compact(tmp_path / "e").parameters
    step = others.abs().amax(dim=(1, 2), keepdim=True) / LEVELS
    # Half a step, and a rounding of the quotient and of the product in float32.
    assert ((back["sh"][:, 1:] - others).abs() <= 0.5 * step * (1 + 1e-4)).all()
    assert (back["sh"][3, 1:] == 0).all()
    same = load_compact(tmp_path / "h").parameters
    assert all(torch.equal(back[name], same[name]) for name in back if name != "sh")
    assert torch.equal(back["sh"][:, 0], same["sh"][:, 0])


def test_a_model_of_one_coefficient_has_no_others_to_store(tmp_path):
    model = initialise(tiny_scene(static=True), tiny_config(), np.random.default_rng(0))
    bare = Model.restored(ModelKind("static", 0, 0), {**model.state(), "sh": model.parameters["sh"][:, :1]})
    save_compact(tmp_path / "m", bare, "int8")
    assert torch.equal(load_compact(tmp_path / "m").parameters["sh"], bare.parameters["sh"].half().float())


@pytest.mark.parametrize("content", [b"", b"not one", b"\x02\0\0\0\0\0\0\0{}"])
def test_another_file_is_refused(tmp_path, content):
    (tmp_path / "m").write_bytes(content)
    with pytest.raises(ValueError, match="m: expected a compact model, found"):
        load_compact(tmp_path / "m")


def test_the_whole_model_comes_first_and_the_smallest_is_within_the_loss(trained):
    scene, cfg = tiny_scene(), tiny_config()
    worth = image_sensitivity(trained, scene.train, scene, cfg, 1.0, np.random.default_rng(0), threads=1)
    models = {fraction: smaller(trained, worth, scene, cfg, fraction, 0.0) for fraction in (1.0, 0.5)}
    points = measure(models, scene, cfg)
    assert [(p.fraction, p.precision) for p in points] == [(f, p) for p in PRECISIONS for f in (1.0, 0.5)]
    assert smallest(points, loss=100.0) is points[5]
    assert smallest(points, loss=0.0).psnr >= points[0].psnr


def test_training_again_makes_up_for_what_was_left_out_and_neither_adds_nor_prunes(trained):
    scene, cfg = tiny_scene(), tiny_config(200)
    small = keep_most_important(trained, torch.rand(len(trained), generator=torch.Generator().manual_seed(0)), 0.3)
    before, whole, asked = held_out_psnr(small, scene, cfg, threads=1).mean(), trained.copy(), []

    def look(model, progress):
        asked.append(progress.iteration)
        return {"psnr": 0.0}

    after = retrained(small, scene, cfg, 0.5, look)
    assert asked == [200] and len(after) == len(small)
    assert held_out_psnr(after, scene, cfg, threads=1).mean() > before + 1  # dB; a hundred iterations bring two
    for name, tensor in whole.parameters.items():
        assert torch.equal(trained.parameters[name], tensor)


def test_training_again_for_none_of_the_schedule_changes_nothing(trained):
    before = trained.copy()
    after = retrained(trained, tiny_scene(), tiny_config(40), 0.0, lambda model, progress: {"psnr": 0.0})
    for name, tensor in before.parameters.items():
        assert torch.equal(after.parameters[name], tensor)


def test_the_schedule_begins_where_training_is_said_to_have_come_to(tmp_path):
    """From iteration 30 of 40 on: ten steps, with all degrees and orders that the schedule has there."""
    scene, cfg = tiny_scene(), tiny_config(40)
    model = initialise(scene, cfg, np.random.default_rng(0))
    run = TinyRun(tmp_path / "late")
    done = train(model, scene, cfg, run, fake_evaluate, begin=30)
    assert done.iteration == 40 and [row["iteration"] for row in run.rows("error_vs_time.jsonl")] == [40]
    assert done.model.parameters["sh"][:, 4:16].any()  # degree 2, from iteration 30 on


def test_a_fraction_of_nothing_keeps_one(trained):
    worth = torch.zeros(len(trained))
    worth[7] = 1.0
    assert torch.equal(keep_most_important(trained, worth, 0.0).parameters["mean"], trained.parameters["mean"][7:8])


@pytest.mark.parametrize(
    "asked, found",
    [
        (["--fractions", "0.5", "1"], "--fractions: expected parts of the Gaussians, above 0 and below 1, found 1"),
        (["--retrain", "1.5"], "--retrain: expected a share of the schedule, 0 to 1, found 1.5"),
    ],
)
def test_a_number_out_of_range_is_one_line(capsys, tmp_path, asked, found):
    assert main([str(tmp_path), *asked]) == 1
    assert capsys.readouterr().err == found + "\n"

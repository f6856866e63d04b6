"""What is left out of a model, and how it is stored: against the model itself."""

from __future__ import annotations

import pytest
import torch
from tiny import tiny_config, tiny_scene, train_tiny

from pipeline.compact.__main__ import measure, smallest
from pipeline.compact.importance import keep_most_important
from pipeline.compact.storage import load_compact, save_compact
from pipeline.evidence import evidence


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
    save_compact(tmp_path / "m", trained, half=False)
    back = load_compact(tmp_path / "m")
    for name, tensor in trained.parameters.items():
        if not name.startswith("quat"):
            assert torch.equal(back.parameters[name], tensor)
    # 3e-7: a normalisation in float32.
    torch.testing.assert_close(back.parameters["quat_left"],
                               torch.nn.functional.normalize(trained.parameters["quat_left"]), rtol=0, atol=3e-7)


def test_half_precision_is_half_as_large_and_nearly_the_same(trained, tmp_path):
    whole, half = save_compact(tmp_path / "w", trained, half=False), save_compact(tmp_path / "h", trained)
    values = sum(t.numel() for t in trained.parameters.values())
    assert whole - half == pytest.approx(2 * (values - trained.parameters["mean"].numel()), abs=64)  # the header's words
    back = load_compact(tmp_path / "h")
    assert torch.equal(back.parameters["mean"], trained.parameters["mean"])
    for name in ("log_scale", "opacity_logit", "sh"):
        # Half precision rounds to 2^-11 of a value; below 6e-5 its steps are 6e-8.
        torch.testing.assert_close(back.parameters[name], trained.parameters[name], rtol=2**-11, atol=6e-8)


@pytest.mark.parametrize("content", [b"", b"not one", b"\x02\0\0\0\0\0\0\0{}"])
def test_another_file_is_refused(tmp_path, content):
    (tmp_path / "m").write_bytes(content)
    with pytest.raises(ValueError, match="m: expected a compact model, found"):
        load_compact(tmp_path / "m")


def test_the_whole_model_comes_first_and_the_smallest_is_within_the_loss(trained):
    scene, cfg = tiny_scene(), tiny_config()
    worth = evidence(trained, scene.train, scene, cfg, 1.0, threads=1).weight
    points = measure(trained, worth, scene, cfg, fractions=(1.0, 0.5))
    assert [(p.fraction, p.half) for p in points] == [(1.0, False), (0.5, False), (1.0, True), (0.5, True)]
    assert smallest(points, loss=100.0) is points[3]
    assert smallest(points, loss=0.0).psnr >= points[0].psnr


def test_a_fraction_of_nothing_keeps_one(trained):
    worth = torch.zeros(len(trained))
    worth[7] = 1.0
    assert torch.equal(keep_most_important(trained, worth, 0.0).parameters["mean"], trained.parameters["mean"][7:8])

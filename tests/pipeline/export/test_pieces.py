"""Gaussians on shared trajectories as pieces on lines: near the path as stated, and rendered as the model."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from builders import generator, make_request, random_gaussians
from export_readers import in_time, read_fourdgs, read_ftgs, read_splatv, static_at

from datasets.canonical import Canonical
from pipeline.evaluation.image_metrics import psnr
from pipeline.export import pieces
from pipeline.export.formats import FORMATS, write_files
from pipeline.export.pieces import film_of, pixel_size
from pipeline.export.source import Source, Timeline
from pipeline.model.model import Model
from pipeline.model.ply import save_ply
from rasterizer import Gaussians, Rasterizer
from rasterizer.covariance import rotation_3d
from rasterizer.reference.render import moved
from rasterizer.trajectories import Trajectories

COUNT, START, DURATION = 80, 0.1, 0.8
LINE = Timeline(START, DURATION, seconds=4.0, camera=make_request().camera)


def shared(sigma: float = 100.0, step: float = 0.0, fourier_order: int = 0) -> Gaussians:
    """Float64; colours of degree 0 within [0, 1]. sigma: in time. step: of red from a Gaussian to the next."""
    g = random_gaussians(COUNT, "shared", generator(4), sh_degree=1, fourier_order=fourier_order)
    red = 0.7 * g.sh.clamp(-1, 1)
    if step:
        red[:, 0, 0] = step * torch.arange(COUNT)
    log_scale = g.log_scale.clone()
    log_scale[:, 3] = np.log(sigma)
    return replace(g, log_scale=log_scale, sh=red)


def model_of(gaussians: Gaussians) -> Model:
    return Model.from_gaussians(gaussians.to(torch.float32))


def image(model: Model, time: float = 0.0) -> np.ndarray:
    return Rasterizer(threads=1).render(model.gaussians(), make_request(time=time)).color.numpy()


@pytest.mark.parametrize("windows", [True, False])
@pytest.mark.parametrize("most", [64, 4])
def test_pieces_are_off_by_what_is_stated(windows: bool, most: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "MAX_PIECES", most)
    gaussians = shared(step=1.0)
    model = model_of(gaussians)
    found = film_of(model, LINE, windows)
    stated = re.search(r"became ([\d,]+) .* at most ([\d.]+) px \(([^)]*)\), by turning ([\d.]+) px", found.note)
    assert stated is not None and int(stated[1].replace(",", "")) == len(found)
    px, units, turned = (float(stated[i]) for i in (2, 3, 4))
    pixel = pixel_size(moved(gaussians, 0.5)[0].mean[:, :3], LINE)
    assert (max(px, turned) <= 0.5) == (most == 64), "within the tolerance unless there are too few pieces"
    owner = found.sh[:, 0, 0].round().long()
    assert owner.unique().numel() == COUNT
    largest, axis_off, covered = 0.0, 0.0, torch.zeros(COUNT)
    times = np.linspace(START, START + DURATION, 301)
    for time in times:
        place, _ = moved(gaussians, float(time))  # the float64 reference
        mean = place.mean[:, :3] + gaussians.velocity * (time - gaussians.mean[:, 3:])
        elapsed = time - found.time
        assert found.window is not None
        now = (found.window[:, 0] <= time) & (time < found.window[:, 1])
        if not windows:
            now &= elapsed.abs() <= np.sqrt(2 * np.log(2)) * found.sigma  # the half of its opacity, or more
        who = owner[now]
        covered += torch.bincount(who, minlength=COUNT) > 0
        off = (found.mean + found.velocity * elapsed[:, None])[now] - mean[who]
        largest = max(largest, float(off.norm(dim=1).max()))
        widest = place.log_scale[:, :3].argmax(dim=1)[who]
        there = rotation_3d(place.quat_left)[who].gather(2, widest[:, None, None].expand(-1, 3, 1))[..., 0]
        # The piece's largest axis, whose sign is free
        own = found.log_scale[now].argmax(dim=1)[:, None, None].expand(-1, 3, 1)
        here = rotation_3d(found.quat[now]).gather(2, own)[..., 0]
        apart = torch.minimum((here - there).norm(dim=1), (here + there).norm(dim=1))
        axis_off = max(axis_off, float((apart * place.log_scale[who, :3].amax(dim=1).exp()).max()))
    assert (covered == len(times)).all(), "a piece of each at every time"
    # The note has two digits; float32 parameters of size 1; errors are sampled 8 times a piece: curves differ between
    # samples by (1/8)² of the largest.
    assert 0.85 * units < largest <= 1.06 * units + 1e-5
    assert px == pytest.approx(units / pixel, rel=0.05), "a median depth without the Gaussians' own velocities"
    assert axis_off <= 1.06 * (turned + 0.005) * pixel, "a chord is shorter than its angle"


def test_opacities_of_overlapping_pieces_sum_to_about_one() -> None:
    found = film_of(model_of(shared(step=1.0)), LINE, False)
    owner, alpha = found.sh[:, 0, 0].round().long(), torch.sigmoid(shared().opacity_logit)
    alone = torch.bincount(owner, minlength=COUNT) == 1
    for time in np.linspace(START, START + DURATION, 50):
        seen = found.opacity * torch.exp(-0.5 * ((time - found.time) / found.sigma) ** 2)
        total = torch.zeros(COUNT, dtype=torch.float64).index_add(0, owner, seen) / alpha
        # 0.45 √(2π) (1 ± 2 exp(-2π² 0.45²)); pieces fainter than 1/255 are left out, which is 4 % of an opacity of 0.1
        assert (total[~alone] > 1.04).all() and (total[~alone] < 1.18).all()
        assert torch.allclose(total[alone], torch.ones(int(alone.sum()), dtype=torch.float64), atol=1e-4)


@pytest.mark.parametrize("sigma", [100.0, 0.15])
def test_pieces_render_as_the_model(sigma: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where Gaussians fade themselves."""
    monkeypatch.setattr(pieces, "TOLERANCE", 0.02)
    model = model_of(shared(sigma))
    found = {windows: film_of(model, LINE, windows) for windows in (True, False)}
    for time in (START, 0.317, 0.5, START + DURATION):
        truth = image(model, time)
        # 0.02 px of splats with edges of 2 px: 1/100 of their contrast at most
        assert psnr(image(static_at(found[True], time)), truth) > 60
        # Few splats cover each other here: an opacity that is off by a tenth, at a fifth of the pixels' depth
        assert psnr(image(static_at(found[False], time)), truth) > 28


@pytest.mark.parametrize("name, decibels", [("ftgs.ply", 70), ("splatv", 35), ("4dgs", 38)])
def test_files_hold_the_pieces(name: str, decibels: float, tmp_path: Path) -> None:
    """As exactly as other models (test_formats.py); .splatv, without directions, with half precision of short times."""
    model = model_of(shared())
    if name == "splatv":
        model.parameters["sh"][:, 1:] = 0.0
    source, said = Source(model, LINE, Canonical(), "scene", tmp_path), []
    (path,) = write_files(name, source, [], tmp_path, False, said.append)
    assert len(said) == 1 and said[0].startswith(f"{name}: 80 Gaussians on shared trajectories became ")
    content, expected = path.read_bytes(), film_of(model, LINE, FORMATS[name].windows)
    readers = {"ftgs.ply": read_ftgs, "splatv": read_splatv, "4dgs": lambda content: read_fourdgs(content, 4.0)}
    read = in_time(readers[name](content), LINE)
    assert len(read) == len(expected)
    for time in (START, 0.5, START + DURATION):
        whole = replace(expected, window=None if read.window is None else expected.window)
        assert psnr(image(static_at(read, time)), image(static_at(whole, time))) > decibels


def test_lengths_of_the_files_change_nothing_else(tmp_path: Path) -> None:
    """In the coordinates of the data's files there are as many pieces, as far off in pixels."""
    source, said = Source(model_of(shared()), LINE, Canonical((1.0, 2.0, 3.0), 0.1, 5.0, 0.01), "scene", tmp_path), []
    for world in (False, True):
        list(write_files("4dgs", source, [], tmp_path, world, said.append))
    (here, there) = (re.sub(r" \([^)]*\)", "", line) for line in said)
    assert here == there and "(" in said[0]


def test_a_frame_of_pieces_has_the_colours_of_its_time(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pieces, "TOLERANCE", 0.0)  # all in 64 pieces
    model = model_of(shared(fourier_order=2))
    found = film_of(model, LINE, True)
    middle = START + DURATION * 20.5 / 64
    # The mean over a 64th of the period, of coefficients up to 1.2: (2π 2/64)² / 24 = 0.0016 of them
    assert np.abs(image(static_at(found, middle)) - image(model, middle)).max() < 0.005


def test_formats_of_whole_models_refuse_them(tmp_path: Path) -> None:
    source = Source(model_of(shared()), LINE, Canonical(), "scene", tmp_path)
    with pytest.raises(ValueError, match="pth: expected a model without shared trajectories"):
        list(write_files("pth", source, [], tmp_path, False, print))
    assert not list(tmp_path.iterdir())
    with pytest.raises(ValueError, match="expected a model without shared trajectories, which .ply lacks"):
        save_ply(tmp_path / "model.ply", source.model)


def test_a_model_whose_trajectories_are_still_is_not_cut() -> None:
    gaussians = shared()
    still = replace(gaussians, trajectories=Trajectories(torch.zeros(12, 5, 6, dtype=torch.float64), gaussians.span))
    found = film_of(model_of(still), LINE, False)
    assert len(found) <= COUNT and "off by at most 0.00 px" in found.note

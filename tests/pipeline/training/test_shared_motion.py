"""Shared motion in training: its start, what it learns, its regularization, and interruptions."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial.transform import Rotation
from test_loop import assert_same_state, batch_losses, interrupted_in
from tiny import TinyRun, random_model, tiny_config, tiny_scene, train_tiny

from pipeline.config.schema import AblationConfig
from pipeline.config.train_schema import RegularizationConfig
from pipeline.data.training_views import target_of
from pipeline.model.initialise import initialise
from pipeline.model.model import Model, ModelKind
from pipeline.model.shared_motion import TRAJECTORIES, with_trajectories
from pipeline.model.transformed import in_velocities
from pipeline.training import checkpoint
from pipeline.training.density.trajectory_start import anchor_weights, farthest_points, opaque_points
from pipeline.training.objective.neighbours import Neighbours, find_neighbours
from pipeline.training.objective.rigid_neighbours import RigidNeighbours, rigid_losses
from pipeline.training.objective.terms import DrawnView
from pipeline.training.optimiser import Adam
from pipeline.training.schedule import phase
from rasterizer import Gradients
from rasterizer.trajectories import Trajectories

SCENE = tiny_scene()
CFG = tiny_config(
    120, eval_every=60, checkpoint_every=30, motion="trajectories", init_time_scale=1000,
    regularization=RegularizationConfig(rigid=0.02),
)  # fmt: skip


def shared_model(seed: int = 0) -> Model:
    """Of random weights and trajectories."""
    rng = torch.Generator().manual_seed(seed)
    plain = random_model(ModelKind("velocity", 2, 3), 40)
    weights, points = torch.randn(40, 3, generator=rng), torch.randn(12, 3, 6, generator=rng)
    kind = replace(plain.kind, trajectories=3)
    return Model(kind, plain.parameters | {"weights": weights}, trajectories=Trajectories(points, (0.0, 1.0)))


@pytest.mark.parametrize(("views", "control_points"), [(8, 5), (45, 19), (200, 59)])
def test_the_number_of_control_points_follows_from_the_times(views: int, control_points: int) -> None:
    """Intervals of nine times: 2 at least, 2 + 3 + 5 of 45, 2 + 3 + 6 + 11 + 22 of 200; 3 points more a level."""
    scene = tiny_scene(views)
    model = with_trajectories(in_velocities(initialise(scene, CFG, np.random.default_rng(0))), scene)
    assert model.trajectories is not None
    assert model.trajectories.control_points.shape == (control_points, TRAJECTORIES, 6)
    assert not model.trajectories.control_points.any() and not model.parameters["weights"].any()
    assert model.trajectories.span == (scene.time_start, scene.time_end)


def test_training_follows_what_moves_and_resumes_to_the_bit(tmp_path, monkeypatch) -> None:
    """The disc moves to the right by 12 pixels, 1.2 units at its depth of 4 with a focal length of 40. Gaussians that
    do not fade must move with it: by half of that at least, after so few iterations."""
    first, last = batch_losses(tmp_path / "whole", SCENE, CFG)
    assert last < 0.5 * first, "noise between batches is much less than half"
    interrupted_in(75, tmp_path / "parts", monkeypatch, CFG)
    model = train_tiny(tmp_path / "parts", CFG).model
    assert_same_state(tmp_path / "whole", tmp_path / "parts")
    rows = TinyRun(tmp_path / "parts").rows("log.jsonl")
    assert [row["anchors"] for row in rows if "anchors" in row] == [TRAJECTORIES]
    assert model.trajectories is not None and model.kind.motion == "velocity"
    ends = [model.parameters["weights"] @ model.trajectories.values(time) for time in (0.0, 1.0)]
    opaque = torch.sigmoid(model.parameters["opacity_logit"]) > 0.3
    assert (ends[1] - ends[0])[opaque, 0].median() > 0.6


def test_trajectories_are_a_part_of_checkpoints(tmp_path) -> None:
    train_tiny(tmp_path, tiny_config(20, motion="trajectories"))
    path = tmp_path / checkpoint.FILE_NAME
    saved, model = checkpoint.load(path), checkpoint.load_model(path)
    assert saved.shared_moments.keys() == {"trajectories"} and saved.model.kind.trajectories == TRAJECTORIES
    assert model.kind == saved.model.kind, "there are no 4D rotations with trajectories"
    state = saved.model.state()
    assert all(torch.equal(tensor, state[name]) for name, tensor in model.state().items())
    assert {"weights", "trajectories", "span"} <= state.keys()


def test_trajectories_are_stepped_by_adam() -> None:
    """Against torch.optim.Adam in float64. Tolerance: five float32 updates of values up to 3, 2e-7 each."""
    model, rng = shared_model(), torch.Generator().manual_seed(0)
    assert model.trajectories is not None
    reference = model.trajectories.control_points.double().requires_grad_()
    optimiser, reference_adam = Adam(model), torch.optim.Adam([reference], lr=0.01, eps=1e-15)
    rates = dict.fromkeys((*model.parameters, "trajectories"), 0.01) | {"sh": (0.01,) * 4, "mean": (0.01,) * 4}
    for _ in range(5):
        gradients = Gradients.zeros_like(model.gaussians())
        gradients.trajectories.copy_(torch.randn(reference.shape, generator=rng))
        optimiser.step(gradients, rates)
        reference.grad = gradients.trajectories.double()
        reference_adam.step()
    torch.testing.assert_close(model.trajectories.control_points.double(), reference.detach(), rtol=0, atol=2e-6)


def test_anchors_lie_apart_on_what_is_opaque() -> None:
    """Two opaque clusters far apart, and a transparent one: one anchor in each opaque cluster, whose Gaussians follow
    it alone."""
    rng = np.random.default_rng(0)
    centres = np.repeat([[0.0, 0, 0], [5, 0, 0], [0, 5, 0]], 1500, axis=0)
    model = random_model(ModelKind("velocity", 0, 0), len(centres))
    model.parameters["mean"][:, :3] = torch.from_numpy(centres + 0.1 * rng.standard_normal(centres.shape)).float()
    model.parameters["opacity_logit"] = torch.from_numpy(np.where(centres[:, 1] > 0, -9.0, 3.0)).float()
    points = opaque_points(model, rng)
    anchors = points[farthest_points(points, 2, rng)]
    assert sorted(np.rint(anchors[:, 0] / 5)) == [0, 1] and abs(anchors[:, 1]).max() < 1
    weights = anchor_weights(centres, anchors)
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)  # float32
    followed = weights[np.arange(3000), np.argmin(np.abs(centres[:3000, :1] - anchors[:, 0]), axis=1)]
    assert followed.min() > 0.6  # the anchors' spacing is their distance: exp(-1/2) of the weight goes to the other


@pytest.mark.parametrize("count", [1, 2, 40])
def test_few_or_coincident_gaussians_have_anchors(count: int) -> None:
    """Fewer than there are trajectories, all in one place: the same anchor for all of these."""
    rng, model = np.random.default_rng(0), random_model(ModelKind("velocity", 0, 0), count)
    model.parameters["mean"].fill_(0.5)
    points = opaque_points(model, rng)
    anchors = points[farthest_points(points, 5, rng)]
    assert (anchors == 0.5).all() and anchors.shape == (5, 3)
    np.testing.assert_allclose(anchor_weights(points, anchors), 0.2, rtol=1e-6)  # float32


def test_a_single_trajectory_is_followed_by_all() -> None:
    assert (anchor_weights(np.random.default_rng(0).standard_normal((9, 3)), np.zeros((1, 3))) == 1).all()


def test_models_without_trajectories_keep_their_times(tmp_path) -> None:
    """Those of an ablation without 4D rotation, whatever the schedule says of trajectories."""
    cfg = replace(CFG, ablation=AblationConfig(rotation_4d=False))
    model = train_tiny(tmp_path, cfg).model
    assert model.trajectories is None
    assert model.parameters["log_scale"][:, 3].unique().numel() > 1, "lifetimes are trained"


def test_farthest_points_are_the_farthest() -> None:
    """A naive loop."""
    points = np.random.default_rng(1).standard_normal((40, 3))
    chosen = farthest_points(points, 6, np.random.default_rng(2)).tolist()
    for count in range(1, 6):
        distances = [min(np.linalg.norm(p - points[c]) for c in chosen[:count]) for p in points]
        assert chosen[count] == int(np.argmax(distances))


def test_rigid_motion_of_pairs_has_no_loss() -> None:
    """Any rotation and translation of a body, by SciPy in float64; other motion has its squared error."""
    rng = np.random.default_rng(3)
    first, second, moved, softening = *rng.standard_normal((2, 30, 3)), rng.standard_normal(3), 0.1
    vector = np.array([0.4, -2.9, 1.7])
    rotation = Rotation.from_rotvec(vector)
    motion = [
        torch.from_numpy(np.hstack([rotation.apply(x) + moved - x, np.broadcast_to(vector, (30, 3))]))
        for x in (first, second)
    ]
    apart = torch.from_numpy(second - first)
    assert rigid_losses(apart, torch.cat(motion), softening)[0].max() < 1e-24
    motion[1][:, 0] += 0.3
    expected = 0.09 / (((second - first) ** 2).sum(axis=1) + softening)
    np.testing.assert_allclose(rigid_losses(apart, torch.cat(motion), softening)[0], expected, rtol=1e-9)


@pytest.mark.parametrize("size", [1.0, 0.0], ids=["turned", "not turned"])
def test_the_gradient_of_rigid_losses_is_that_of_their_formula(size: float) -> None:
    """Autograd of the formula with PyTorch's matrix exponential as the rotation, in float64."""
    rng = np.random.default_rng(5)
    apart, first, second = (torch.from_numpy(rng.standard_normal((20, n))) for n in (3, 6, 6))
    first[:, 3:] *= size

    def formula(first: torch.Tensor, second: torch.Tensor) -> torch.Tensor:
        x, y, z = first[:, 3:].unbind(1)
        none = torch.zeros_like(x)
        generator = torch.stack([none, -z, y, z, none, -x, -y, x, none], dim=1).view(-1, 3, 3)
        rotated = (torch.linalg.matrix_exp(generator) @ apart[:, :, None])[:, :, 0]
        error = apart + second[:, :3] - first[:, :3] - rotated
        return error.square().sum(dim=1) / (apart.square().sum(dim=1) + 0.1)

    leaves = first.clone().requires_grad_(), second.clone().requires_grad_()
    expected = torch.autograd.grad(formula(*leaves).sum(), leaves)
    losses, gradient = rigid_losses(apart, torch.cat([first, second]), 0.1)
    torch.testing.assert_close(losses, formula(first, second))
    torch.testing.assert_close(gradient, torch.cat(expected), rtol=1e-9, atol=1e-9)


def test_neighbours_are_the_nearest_others() -> None:
    """Against all distances, for any number of threads; none for a model without weights or with as many Gaussians."""
    model = shared_model()
    means = model.parameters["mean"][:, :3].double()
    apart = torch.linalg.norm(means[:, None] - means, dim=2)
    order = apart.argsort(dim=1)[:, 1:9]
    for threads in (1, 2):
        found = find_neighbours(model, threads)
        assert found is not None and torch.equal(found.index.long(), order)
        assert found.spacing == pytest.approx(np.median(apart.sort(dim=1).values[:, 4]))  # both in float64
    assert find_neighbours(random_model(ModelKind("velocity", 2, 3), 40), 1) is None
    eight = {name: rows[:8] for name, rows in model.parameters.items()}
    few = Model(model.kind, eight, trajectories=model.trajectories)
    assert find_neighbours(few, 1) is None


@pytest.mark.parametrize("index", [torch.zeros(3, 7, dtype=torch.int32), torch.full((3, 8), 3, dtype=torch.int32)])
def test_neighbours_are_rows_of_the_model(index: torch.Tensor) -> None:
    with pytest.raises(ValueError, match="neighbours"):
        Neighbours(index, 0.1)


def test_the_rigid_gradient_is_that_of_finite_differences() -> None:
    """Central differences of the term's own loss, in float32: steps of 1e-2 of a smooth loss of about 1, so that
    rounding (1e-5) and truncation (1e-4) stay below the tolerance of 2 % of the largest gradient."""
    model, scene = shared_model(), SCENE
    term, near = RigidNeighbours(1.0, scene, seed=4), find_neighbours(model, threads=1)
    view = DrawnView(target_of(scene.train[0], 1.0), phase(1.0, CFG.train, scene.extent, 3, 2), neighbours=near)
    gradients = Gradients.zeros_like(model.gaussians())
    term.add(gradients, model, view)
    assert model.trajectories is not None
    tensors = {"weights": model.parameters["weights"], "trajectories": model.trajectories.control_points}
    for name, tensor in tensors.items():
        tensor, gradient = tensor.view(-1), getattr(gradients, name).view(-1)
        largest = gradient.abs().max().item()
        for index in torch.argsort(gradient.abs(), descending=True)[:5].tolist():
            values = []
            for step in (1e-2, -1e-2):
                tensor[index] += step
                values.append(term.add(Gradients.zeros_like(model.gaussians()), model, view))
                tensor[index] -= step
            assert (values[0] - values[1]) / 2e-2 == pytest.approx(gradient[index].item(), abs=0.02 * largest)

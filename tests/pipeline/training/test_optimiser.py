"""Adam against its formula, and adding and removing rows of parameters and moments."""

from __future__ import annotations

import pytest
import torch
from tiny import random_model

from pipeline.model.environment_map import EnvironmentMap
from pipeline.model.model import Model, ModelKind
from pipeline.training.optimiser import Adam
from rasterizer import Gradients

KIND = ModelKind("full", 2, 3)
RATES = {
    "mean": (1e-3, 1e-3, 1e-3, 2e-3),
    "log_scale": 5e-3,
    "quat_left": 1e-3,
    "quat_right": 1e-3,
    "velocity": 4e-3,
    "opacity_logit": 5e-2,
    "sh": (2.5e-3, 1.25e-4, 5e-4, 6e-5),
    "environment": 0.02,
}
FIELDS = RATES.keys() - {"sh", "environment", "velocity"}  # of KIND


def random_gradients(model: Model, rng: torch.Generator) -> Gradients:
    """Of every field except sh, whose gradient only a rendered view has."""
    gradients = Gradients.zeros_like(model.gaussians())
    for tensor in gradients.dense().values():
        tensor.copy_(torch.randn(tensor.shape, generator=rng))
    return gradients


def marked_optimiser(count: int = 6) -> Adam:
    """Row i of every parameter is i, of the moments i + 100 and i + 200."""
    model = random_model(KIND, count)
    optimiser = Adam(model)
    for offset, tensors in zip((0, 100, 200), (model.parameters, optimiser.first, optimiser.second)):
        for tensor in tensors.values():
            tensor.copy_((torch.arange(count) + offset).reshape(-1, *[1] * (tensor.dim() - 1)).expand_as(tensor))
    return optimiser


def test_steps_match_the_formula() -> None:
    """Kingma & Ba 2015, algorithm 1, in float64."""
    model, rng = random_model(KIND, 20), torch.Generator().manual_seed(0)
    names = FIELDS - {"mean"}
    expected = {name: model.parameters[name].double() for name in names}
    first, second = ({name: torch.zeros_like(expected[name]) for name in names} for _ in range(2))
    optimiser = Adam(model)
    for step in range(1, 11):
        gradients = random_gradients(model, rng)
        optimiser.step(gradients, RATES)
        for name in names:
            gradient = getattr(gradients, name).double()
            first[name] = 0.9 * first[name] + 0.1 * gradient
            second[name] = 0.999 * second[name] + 0.001 * gradient**2
            corrected = first[name] / (1 - 0.9**step), second[name] / (1 - 0.999**step)
            expected[name] = expected[name] - RATES[name] * corrected[0] / (corrected[1].sqrt() + 1e-15)
    for name in names:
        # ten float32 updates of values near 1: rounding of 6e-8 each, and about 1e-6 of a rate of at most 0.05
        assert torch.allclose(model.parameters[name].double(), expected[name], atol=3e-6), name
    assert optimiser.step_count == 10


def test_the_columns_of_the_mean_have_their_own_rates() -> None:
    model = random_model(KIND, 5)
    before = model.parameters["mean"].clone()
    gradients = Gradients.zeros_like(model.gaussians())
    gradients.mean.fill_(3.0)
    Adam(model).step(gradients, RATES)
    # The first step of Adam is the rate, for any gradient; 1e-6: float32 rounding of values below 4
    moved = before - model.parameters["mean"]
    assert torch.allclose(moved, torch.tensor(RATES["mean"]).expand(5, 4), atol=1e-6)


def test_the_rate_of_velocities_is_that_of_the_displacement_in_a_lifetime() -> None:
    """Against torch.optim.Adam, float64, whose steps are divided by st."""
    model, rng = random_model(ModelKind("velocity", 2, 3), 20), torch.Generator().manual_seed(0)
    lifetime = model.parameters["log_scale"][:, 3:].double().exp()
    expected = model.parameters["velocity"].double()
    displacement = torch.zeros_like(expected).requires_grad_()
    reference, optimiser = torch.optim.Adam([displacement], lr=RATES["velocity"], eps=1e-15), Adam(model)
    for _ in range(5):
        gradients = random_gradients(model, rng)
        optimiser.step(gradients, RATES | {"log_scale": 0.0})
        displacement.grad = gradients.velocity.double()
        reference.step()
    expected = expected + displacement.detach() / lifetime
    # five float32 updates of values near 1: rounding of 6e-8 each, and about 1e-6 of the rate, over lifetimes above 0.1
    torch.testing.assert_close(model.parameters["velocity"].double(), expected, rtol=0, atol=1e-6)


@pytest.mark.parametrize("motion", ["full", "velocity"])
def test_excluded_rows_keep_their_values_and_moments(motion: str) -> None:
    model, rng = random_model(ModelKind(motion, 2, 3), 6), torch.Generator().manual_seed(0)
    optimiser = Adam(model)
    rows = torch.tensor([1, 0, 1, 0, 0, 1], dtype=torch.uint8)
    before = model.copy()
    for _ in range(2):  # the first steps of Adam are all as long as the rate, and may cancel
        optimiser.step(random_gradients(model, rng), RATES, rows)
    for name in model.parameters.keys() - {"sh"}:
        changed = (model.parameters[name] != before.parameters[name]).reshape(6, -1).any(dim=1)
        assert torch.equal(changed, rows.bool()), name
        assert not optimiser.first[name][~rows.bool()].any(), name


def test_a_field_of_rate_0_keeps_its_values_and_moments() -> None:
    model, rng = random_model(ModelKind("velocity", 2, 3), 6), torch.Generator().manual_seed(0)
    optimiser, before = Adam(model), model.copy()
    optimiser.step(random_gradients(model, rng), RATES | {"velocity": 0.0})
    assert torch.equal(model.parameters["velocity"], before.parameters["velocity"])
    assert not optimiser.first["velocity"].any() and not optimiser.second["velocity"].any()
    assert not torch.equal(model.parameters["mean"], before.parameters["mean"])


def test_the_environment_map_is_updated_only_with_a_gradient() -> None:
    """Against torch.optim.Adam in float64; without a gradient the map and its moments are unchanged."""
    model, rng = random_model(KIND, 5), torch.Generator().manual_seed(0)
    model.environment_map = EnvironmentMap(torch.rand(3, 4, 8, generator=rng))
    reference = model.environment_map.image.double().requires_grad_()
    optimiser, reference_adam = Adam(model), torch.optim.Adam([reference], lr=RATES["environment"], eps=1e-15)
    for _ in range(5):
        d_environment_map = torch.randn(3, 4, 8, generator=rng)
        optimiser.step(random_gradients(model, rng), RATES, d_environment_map=d_environment_map)
        reference.grad = d_environment_map.double()
        reference_adam.step()
    # five float32 updates of values up to 1: rounding of 6e-8 each, and about 1e-6 of the rate
    torch.testing.assert_close(model.environment_map.image.double(), reference.detach(), rtol=0, atol=1e-6)
    before = [
        model.environment_map.image.clone(),
        *(moment.clone() for moment in optimiser.shared_moments["environment"]),
    ]
    optimiser.step(random_gradients(model, rng), RATES)
    assert all(map(torch.equal, before, (model.environment_map.image, *optimiser.shared_moments["environment"])))
    assert optimiser.bytes == 2 * model.bytes


def test_keep_selects_rows_and_their_moments_in_order() -> None:
    optimiser = marked_optimiser()
    optimiser.keep(torch.tensor([True, False, True, True, False, True]))
    for offset, tensors in zip((0, 100, 200), (optimiser.model.parameters, optimiser.first, optimiser.second)):
        for name, tensor in tensors.items():
            rows = tensor.reshape(len(tensor), -1)[:, 0]
            assert rows.tolist() == [offset + i for i in (0, 2, 3, 5)], name
            assert tensor.is_contiguous(), name


def test_append_adds_rows_with_zero_moments_at_the_end() -> None:
    optimiser = marked_optimiser()
    rows = {name: tensor[:2] + 50 for name, tensor in optimiser.model.parameters.items()}
    optimiser.append(rows)
    for name, tensor in optimiser.model.parameters.items():
        assert len(tensor) == 8
        assert torch.equal(tensor[6:], rows[name]), name
        for moments in (optimiser.first, optimiser.second):
            assert not moments[name][6:].any() and moments[name][:6].all(), name
    optimiser.model.gaussians()  # shapes are consistent


def test_keep_and_append_update_the_sphere_label() -> None:
    optimiser = marked_optimiser()
    optimiser.keep(torch.ones(6, dtype=torch.bool))
    assert optimiser.model.sphere is None
    optimiser.model.sphere = torch.tensor([False, True, True, False, False, True])
    optimiser.keep(torch.tensor([True, False, True, True, False, True]))
    optimiser.append({name: tensor[:2] for name, tensor in optimiser.model.parameters.items()})
    assert optimiser.model.sphere.tolist() == [False, True, False, True, False, False], (
        "new Gaussians are not of the sphere"
    )


def test_append_refuses_other_fields() -> None:
    with pytest.raises(ValueError, match="append: expected fields"):
        marked_optimiser().append({"mean": torch.zeros(1, 4)})


def test_zero_moments_of_one_field_only() -> None:
    optimiser = marked_optimiser()
    rows = torch.tensor([True, False, False, True, False, False])
    optimiser.zero_moments("opacity_logit", rows)
    assert optimiser.first["opacity_logit"].tolist() == [0, 101, 102, 0, 104, 105]
    optimiser.zero_moments("opacity_logit")
    assert not optimiser.first["opacity_logit"].any() and not optimiser.second["opacity_logit"].any()
    assert optimiser.first["mean"].all()

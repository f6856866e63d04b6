"""LPIPS with random weights, because tests download none: the networks' architecture, and errors of the download."""

from __future__ import annotations

import hashlib
import threading
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import numpy as np
import pytest
import torch
import torch.nn.functional as F
from torch import Tensor

from pipeline.evaluation import lpips

# Index in torchvision's `features` -> (out channels, in channels, kernel) of the convolution.
ALEX = {0: (64, 3, 11), 3: (192, 64, 5), 6: (384, 192, 3), 8: (256, 384, 3), 10: (256, 256, 3)}
VGG = {
    0: (64, 3, 3), 2: (64, 64, 3),
    5: (128, 64, 3), 7: (128, 128, 3),
    10: (256, 128, 3), 12: (256, 256, 3), 14: (256, 256, 3),
    17: (512, 256, 3), 19: (512, 512, 3), 21: (512, 512, 3),
    24: (512, 512, 3), 26: (512, 512, 3), 28: (512, 512, 3),
}  # fmt: skip


def random_weights(convolutions: dict[int, tuple[int, int, int]], heads: list[int]) -> tuple[dict, dict]:
    rng = torch.Generator().manual_seed(0)
    backbone = {}
    for index, (out, inner, kernel) in convolutions.items():
        bound = (inner * kernel**2) ** -0.5
        backbone[f"features.{index}.weight"] = bound * torch.randn(out, inner, kernel, kernel, generator=rng)
        backbone[f"features.{index}.bias"] = 0.1 * torch.randn(out, generator=rng)
    return backbone, {f"lin{k}.model.1.weight": torch.rand(1, c, 1, 1, generator=rng) for k, c in enumerate(heads)}


def images(size: int = 48) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(1)
    return tuple(rng.random((size, size, 3)).astype(np.float32) for _ in range(2))


def naive_alex(image: np.ndarray, backbone: dict[str, Tensor]) -> list[Tensor]:
    """Features after each ReLU of torchvision's AlexNet."""
    mean, deviation = (torch.tensor(c)[:, None, None] for c in ([-0.030, -0.088, -0.188], [0.458, 0.448, 0.450]))
    x = (torch.from_numpy(image).permute(2, 0, 1)[None] * 2 - 1 - mean) / deviation

    def conv(x: Tensor, i: int, **keys) -> Tensor:
        return F.relu(F.conv2d(x, backbone[f"features.{i}.weight"], backbone[f"features.{i}.bias"], **keys))

    first = conv(x, 0, stride=4, padding=2)
    second = conv(F.max_pool2d(first, 3, 2), 3, padding=2)
    third = conv(F.max_pool2d(second, 3, 2), 6, padding=1)
    fourth = conv(third, 8, padding=1)
    return [first, second, third, fourth, conv(fourth, 10, padding=1)]


def test_alex_equals_its_definition() -> None:
    backbone, heads = random_weights(ALEX, [64, 192, 384, 256, 256])
    a, b = images()
    expected = 0.0
    for k, (u, v) in enumerate(zip(naive_alex(a, backbone), naive_alex(b, backbone))):
        difference = (F.normalize(u, dim=1) - F.normalize(v, dim=1)) ** 2
        expected += F.conv2d(difference, heads[f"lin{k}.model.1.weight"]).mean().item()
    assert lpips.Lpips("alex", backbone, heads)(a, b) == pytest.approx(expected, rel=1e-5)  # float32


def test_vgg_has_thirteen_convolutions_and_is_symmetric() -> None:
    backbone, heads = random_weights(VGG, [64, 128, 256, 512, 512])
    network = lpips.Lpips("vgg", backbone, heads)
    a, b = images()
    assert network(a, a) == 0.0
    assert network(a, b) == pytest.approx(network(b, a), rel=1e-6) and network(a, b) > 0
    assert sum(isinstance(layer, torch.nn.Conv2d) for layer in network.modules()) == 13


@pytest.fixture
def empty_cache(tmp_path: Path, monkeypatch) -> Path:
    monkeypatch.setattr(torch.hub, "get_dir", lambda: str(tmp_path))
    (tmp_path / "checkpoints").mkdir()
    return tmp_path / "checkpoints"


def test_missing_weights_are_one_line_with_the_reason(empty_cache: Path, monkeypatch) -> None:
    monkeypatch.setattr(lpips, "_unreachable", lambda url: "no route to host")
    with pytest.raises(
        lpips.LpipsUnavailable,
        match=r"alexnet-owt-7be5be79.pth .* \(no route to host\); put .* only=evaluate, or set evaluate.lpips=false",
    ):
        lpips.load("alex")


def test_weights_with_another_checksum_are_refused(empty_cache: Path) -> None:
    (empty_cache / "vgg16-397923af.pth").write_bytes(b"something else")
    with pytest.raises(lpips.LpipsUnavailable, match="expected SHA-256 397923af…, found "):
        lpips.load("vgg")


def test_the_reason_is_from_the_operating_system_or_the_server() -> None:
    """A closed port (9, discard), and a local server without the page."""
    assert lpips._unreachable("http://127.0.0.1:9/weights") == "Connection refused"
    with ThreadingHTTPServer(("127.0.0.1", 0), SimpleHTTPRequestHandler) as server:
        threading.Thread(target=server.serve_forever, daemon=True).start()
        reason = lpips._unreachable(f"http://127.0.0.1:{server.server_port}/not/there")
        server.shutdown()
    assert reason == "the server answers 404 File not found"


def test_a_folder_of_weights_is_checked_and_its_hashes_are_kept(tmp_path: Path, monkeypatch) -> None:
    """Random weights under the published names, whose hashes are exchanged for those of the files."""
    alex, vgg = random_weights(ALEX, [64, 192, 384, 256, 256]), random_weights(VGG, [64, 128, 256, 512, 512])
    files = {}
    for net, weights in (("alex", alex), ("vgg", vgg)):
        for content, (name, _, url) in zip(weights, lpips._FILES[net]):
            torch.save(content, tmp_path / name)
            digest = hashlib.sha256((tmp_path / name).read_bytes()).hexdigest()
            files.setdefault(net, []).append((name, digest[:8], url))
    with pytest.raises(ValueError, match=r"alexnet.*: expected SHA-256 7be5be79…, found"):
        lpips.refuse_wrong_weights(str(tmp_path))
    monkeypatch.setattr(lpips, "_FILES", files)
    lpips.refuse_wrong_weights(str(tmp_path))
    network = lpips.load("alex", str(tmp_path))
    assert network(*images()) == lpips.Lpips("alex", *alex)(*images())
    assert {name: digest[:8] for name, digest in network.weights.items()} == {f[0]: f[1] for f in files["alex"]}
    (tmp_path / "vgg16-397923af.pth").unlink()
    with pytest.raises(ValueError, match=r"evaluate.lpips_weights: expected .*, found no vgg16-397923af.pth"):
        lpips.refuse_wrong_weights(str(tmp_path))

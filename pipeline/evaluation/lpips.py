"""LPIPS (Zhang et al. 2018, version 0.1) without torchvision: the weighted distance between deep features.

A network has two sets of weights: the convolutions of torchvision's ImageNet model (233 MB AlexNet, 528 MB VGG16) and
the 6 kB linear heads of the LPIPS authors. They are read from the folder `evaluate.lpips_weights`, without one from
torch.hub's cache (`torch.hub.get_dir()`, set by TORCH_HOME), or downloaded to it, and checked by SHA-256. A folder that
lacks a file is refused; where cache and download fail, LpipsUnavailable has the reason.

LPIPS-Alex is measured on every view. LPIPS-VGG costs 27 times as much: 21 s of one core and 1.8 GB for 1352 × 1014
pixels, nearly two hours for the 300 frames of a Plenoptic Video scene. It is measured on evenly spread views of
VGG_PIXELS in total.
"""

from __future__ import annotations

import hashlib
import threading
import urllib.error
import urllib.request
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from datasets.scene import Scene
from pipeline.config.schema import Config
from pipeline.data.training_views import camera_at, evenly_spaced

VGG_PIXELS = 50e6  # 36 views of 1352 × 1014; all views of D-NeRF at 400 × 400 and of the synthetic scenes
VGG_BYTES_PER_PIXEL = 1300  # memory in use
CONNECT_SECONDS = 4.0  # timeout of the first request

_HEADS_AT = (
    "https://raw.githubusercontent.com/richzhang/PerceptualSimilarity/"
    "082bb24f84c091ea94de2867d34c4544f68e0963/lpips/weights/v0.1/"
)
_BACKBONES_AT = "https://download.pytorch.org/models/"

# file, prefix of its SHA-256, URL
_FILES = {
    "alex": (
        ("alexnet-owt-7be5be79.pth", "7be5be79", _BACKBONES_AT + "alexnet-owt-7be5be79.pth"),
        ("lpips-v0.1-alex.pth", "df73285e", _HEADS_AT + "alex.pth"),
    ),
    "vgg": (
        ("vgg16-397923af.pth", "397923af", _BACKBONES_AT + "vgg16-397923af.pth"),
        ("lpips-v0.1-vgg.pth", "a78928a0", _HEADS_AT + "vgg.pth"),
    ),
}

# Layers of torchvision's `features`, as (kind, out channels, kernel, stride, padding). "compare" is not a layer: there
# the features of the two images are compared.
_ALEX = (
    ("conv", 64, 11, 4, 2), ("relu",), ("compare",), ("pool", 3),
    ("conv", 192, 5, 1, 2), ("relu",), ("compare",), ("pool", 3),
    ("conv", 384, 3, 1, 1), ("relu",), ("compare",),
    ("conv", 256, 3, 1, 1), ("relu",), ("compare",),
    ("conv", 256, 3, 1, 1), ("relu",), ("compare",),
)  # fmt: skip


def _vgg_layers() -> tuple[tuple, ...]:
    layers: list[tuple] = []
    for block, (channels, convolutions) in enumerate(((64, 2), (128, 2), (256, 3), (512, 3), (512, 3))):
        if block > 0:
            layers.append(("pool", 2))
        layers += [("conv", channels, 3, 1, 1), ("relu",)] * convolutions + [("compare",)]
    return tuple(layers)


_LAYERS = {"alex": _ALEX, "vgg": _vgg_layers()}

# ImageNet's channel means and standard deviations, for images in [-1, 1].
_SHIFT = torch.tensor([-0.030, -0.088, -0.188]).reshape(1, 3, 1, 1)
_SCALE = torch.tensor([0.458, 0.448, 0.450]).reshape(1, 3, 1, 1)

# Below this AlexNet's last feature maps are empty; the limit is used for both networks.
SMALLEST_SIDE = 32


def refuse_wrong_weights(folder: str | None) -> None:
    """ValueError, one line, where a folder of weights lacks a file or has another. None: no folder is given."""
    if folder is None:
        return
    for name, digest, _ in (file for files in _FILES.values() for file in files):
        path = Path(folder).expanduser() / name
        if not path.is_file():
            names = ", ".join(file[0] for files in _FILES.values() for file in files)
            raise ValueError(f"evaluate.lpips_weights: expected {names} in {folder}, found no {name}")
        if not (found := _sha256(path)).startswith(digest):
            raise ValueError(f"{path}: expected SHA-256 {digest}…, found {found[:8]}…")


class LpipsUnavailable(RuntimeError):
    """The weights are neither cached nor downloadable; the message is one line."""


class Lpips(nn.Module):
    """LPIPS of one network. Called with two images (H, W, 3) in [0, 1], it returns their distance.

    weights: SHA-256 of its files by name; empty for weights that are from no file.
    """

    weights: dict[str, str]

    def __init__(
        self, net: str, backbone: dict[str, Tensor], heads: dict[str, Tensor], weights: dict[str, str] | None = None
    ) -> None:
        """net: alex or vgg. backbone: torchvision's state dict, "features.<i>.weight" and ".bias". heads: the state
        dict of the linear heads, "lin<k>.model.1.weight" (1, C, 1, 1)."""
        super().__init__()
        self.weights = weights or {}
        self.slices = nn.ModuleList()
        self.heads: list[Tensor] = []
        layers: list[nn.Module] = []
        channels, index = 3, 0
        for kind, *shape in _LAYERS[net]:
            if kind == "compare":
                self.slices.append(nn.Sequential(*layers))
                self.heads.append(heads[f"lin{len(self.heads)}.model.1.weight"].reshape(1, channels, 1, 1))
                layers = []
                continue
            if kind == "conv":
                out, kernel, stride, padding = shape
                layer = nn.Conv2d(channels, out, kernel, stride, padding)
                layer.load_state_dict({name: backbone[f"features.{index}.{name}"] for name in ("weight", "bias")})
                layers.append(layer)
                channels = out
            elif kind == "relu":
                layers.append(nn.ReLU())
            else:
                layers.append(nn.MaxPool2d(shape[0], stride=2))
            index += 1
        self.requires_grad_(False).eval()

    @torch.inference_mode()
    def forward(self, image: np.ndarray, truth: np.ndarray) -> float:
        a, b = (_prepared(x) for x in (image, truth))
        distance = 0.0
        for layers, head in zip(self.slices, self.heads):
            a, b = layers(a), layers(b)
            difference = (_unit(a) - _unit(b)).square()
            distance += float((head * difference).sum(dim=1).mean())
        return distance


class Perceptual:
    """LPIPS over a scene's test views: which networks are available, and which views each measures."""

    def __init__(self, cfg: Config, scene: Scene) -> None:
        """Loads the networks whose weights are available. `note`: why others are missing, or which views a mean has."""
        self._networks: dict[str, Lpips | None] = dict.fromkeys(_FILES)
        self.note: str | None = None
        self.weights: dict[str, str] = {}  # SHA-256 of the files in use, by name
        camera = camera_at(scene.test[0].camera, cfg.train.resolution_scale)
        count, pixels = len(scene.test), camera.width * camera.height
        self._vgg_views = set(evenly_spaced(count, max(1, int(VGG_PIXELS / pixels))))
        if not cfg.evaluate.lpips:
            self.note = "not measured: evaluate.lpips=false"
        elif min(camera.width, camera.height) < SMALLEST_SIDE:
            self.note = f"LPIPS needs images of at least {SMALLEST_SIDE} px a side"
        else:
            for net in _FILES:
                try:
                    network = load(net, cfg.evaluate.lpips_weights)
                except LpipsUnavailable as error:
                    self.note = self.note or str(error)
                    continue
                self._networks[net] = network
                self.weights |= network.weights
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


def load(net: str, folder: str | None = None) -> Lpips:
    """LPIPS with its published weights, from `folder`; None: the cache or the network. Raises LpipsUnavailable."""
    loaded: list[dict[str, Tensor]] = []
    weights: dict[str, str] = {}
    for name, digest, url in _FILES[net]:
        path = Path(folder).expanduser() if folder else Path(torch.hub.get_dir()) / "checkpoints"
        path /= name
        if not path.exists():
            _download(url, path, digest)
        weights[name] = _sha256(path)
        if not weights[name].startswith(digest):
            raise LpipsUnavailable(f"{path}: expected SHA-256 {digest}…, found {weights[name][:8]}…; delete it")
        loaded.append(torch.load(path, map_location="cpu", weights_only=True))
    return Lpips(net, loaded[0], loaded[1], weights)


def _download(url: str, path: Path, digest: str) -> None:
    problem = _unreachable(url)
    if problem is None:
        try:
            path.parent.mkdir(parents=True, exist_ok=True)
            torch.hub.download_url_to_file(url, str(path), hash_prefix=digest, progress=False)
            return
        except (OSError, RuntimeError) as error:
            problem = _reason(error)
    folder = str(path.parent).replace(str(Path.home()), "~")
    raise LpipsUnavailable(
        " ".join(
            f"LPIPS weights {path.name} are neither in {folder} nor available from "
            f"{url.split('/')[2]} ({problem}); put the file there or give its folder by evaluate.lpips_weights, "
            "and repeat the command with only=evaluate, or set evaluate.lpips=false".split()
        )
    )


def _reason(error: BaseException) -> str:
    """The cause of an error of urllib, as reported by the operating system or the server."""
    if isinstance(error, urllib.error.HTTPError):
        return f"the server answers {error.code} {error.reason}"
    reason = getattr(error, "reason", None)
    if isinstance(reason, BaseException):
        return _reason(reason)
    return getattr(error, "strerror", None) or str(reason or error)


def _unreachable(url: str) -> str | None:
    """Why a HEAD request for `url` fails within CONNECT_SECONDS; None if it succeeds.

    It runs in its own thread, because name resolution has no timeout.
    """
    outcome: list[str | None] = []

    def request() -> None:
        try:
            urllib.request.urlopen(urllib.request.Request(url, method="HEAD"), timeout=CONNECT_SECONDS).close()
            outcome.append(None)
        except (OSError, ValueError) as error:
            outcome.append(_reason(error))

    thread = threading.Thread(target=request, daemon=True)
    thread.start()
    thread.join(CONNECT_SECONDS)
    return outcome[0] if outcome else f"no answer in {CONNECT_SECONDS:g} s"


def _sha256(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def _prepared(image: np.ndarray) -> Tensor:
    """(H, W, 3) in [0, 1] -> (1, 3, H, W), normalised as the backbones' training images."""
    x = torch.from_numpy(np.ascontiguousarray(image.transpose(2, 0, 1), dtype=np.float32))[None]
    return (2.0 * x - 1.0 - _SHIFT) / _SCALE


def _unit(features: Tensor) -> Tensor:
    """Each pixel's feature vector normalised to length 1."""
    return features / (features.square().sum(dim=1, keepdim=True).sqrt() + 1e-10)

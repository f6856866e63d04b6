"""Measures anyone's images of a scene's test views, by the protocol that the keys of the scene name.

IMAGES is a folder of PNG files, named after the test views, or a zip of `python -m pipeline.pack`. Keys are those of
`python -m pipeline`: scene=dnerf/lego scene.path=DIR. Writes what a run writes of its evaluation: metrics.json,
per_image.csv and renders/; `python -m pipeline.report` has it as a row "given". Of a zip the true images are compared
with those that were packed, and the numbers with the packed ones.
"""

from __future__ import annotations

import json
import re
import shlex
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from datasets.files.atomic_write import write_json, write_text
from datasets.manifest import recorded
from pipeline.config.compose import command_of
from pipeline.config.schema import Config
from pipeline.data.prepare import Prepared, prepare
from pipeline.evaluation.evaluate import Evaluation, Render, measure_images, refuse_small_images
from pipeline.evaluation.given_images import BITS, files_of_views, given_images, refuse_other_sizes
from pipeline.evaluation.packed_images import Pack, differing, equal, opened
from pipeline.evaluation.pictures.view_pictures import picture_saver
from pipeline.evaluation.protocol import DECISIVE, measured_by
from pipeline.runs.provenance import provenance
from pipeline.runs.run_folder import config_text, now, write_csv
from pipeline.runs.run_identity import FILES, refuse_foreign
from pipeline.stages.settle import changes, for_scene
from pipeline.terminal.command_line import CommandParser, command, log
from rasterizer.cores import thread_count

NO_POINTS = "init.source=random"  # none are needed: structure from motion runs for poses alone


@command
def main(arguments: list[str]) -> int:
    parser = CommandParser("score", __doc__)
    parser.add_argument("images", type=Path, metavar="IMAGES", help="a folder of PNG files, or a pack")
    parser.add_argument("keys", nargs="+", metavar="KEY=VALUE", help="scene=…, and any other key")
    parser.add_argument("--method", metavar="NAME", help="what made the images (default: the name of IMAGES)")
    parser.add_argument("--names", type=Path, metavar="FILE", help="JSON object {view: file} where names do not match")
    parser.add_argument(
        "--in-order", action="store_true", help="files in order of their numbers are the views in order"
    )
    parser.add_argument("--out", type=Path, metavar="DIR", help="default: results/runs/SCENE/given/NAME/seedN")
    options = parser.parse_intermixed_args(arguments)
    method = options.method or options.images.resolve().stem
    named = re.fullmatch(r"[\w+-][\w.+-]*", method) is not None
    parser.require(named, "--method", "letters, digits and _ . + -", repr(method))
    parser.require(not (options.names and options.in_order), "--in-order", "no --names beside it", options.names)
    typed = shlex.join(["python", "-m", "pipeline.score", *arguments])
    if options.images.is_file():
        ordered = options.names or options.in_order
        parser.require(not ordered, "--names or --in-order", "a folder of images", f"the pack {options.images}")
        with opened(options.images) as pack:
            _score_pack(pack, options.keys, method, options.out, typed)
        return 0
    if not options.images.is_dir():
        raise ValueError(f"{options.images}: expected a folder of PNG files or a zip of pipeline.pack, found nothing")
    cfg, data, changed = _scene(options.keys)
    views = [view.name for view in data.scene.test]
    files = files_of_views(options.images, views, options.names, options.in_order)
    log(f"{files[views[0]]} is taken for {views[0]}, …, {files[views[-1]]} for {views[-1]}")
    found = {"recipe": method, "model": "given", "image_bits": BITS}
    declared = _declared(cfg, data, changed) | found
    refuse_other_sizes(data.scene, cfg.train.resolution_scale, files, declared["protocol"])
    out = _folder(options.out, cfg, method)
    measured = _measure(cfg, data, given_images(data.scene, files), out)
    _write(out, cfg, typed, declared | _found(cfg, data, measured), measured)
    return 0


def _score_pack(pack: Pack, keys: list[str], method: str, out: Path | None, typed: str) -> None:
    """ValueError, one line, where truth, protocol or numbers are not those of the pack."""
    cfg, data, _ = _scene([*_keys_of(pack), *keys])
    pack.refuse_other_truth(data.scene)
    if (protocol := _declared(cfg, data, {})["protocol"]) != pack.protocol:
        raise ValueError(f"{pack.path}: expected the protocol of the keys, {protocol}, found {pack.protocol}")
    out = _folder(out, cfg, method)
    measured = _measure(cfg, data, pack.render, out)
    if wrong := differing(pack.final, measured.metrics):
        raise ValueError(f"{pack.path}: expected the packed numbers of the packed images, found {'; '.join(wrong[:3])}")
    same = equal(pack.final, measured.metrics)
    unseen = [key for key in pack.final if key not in measured.metrics]
    log(f"to the digit as packed: {', '.join(same)}")
    log(f"as the pack says, not measured: {', '.join(unseen)}, and costs; best_on_test is left out")
    final = {key: measured.metrics.get(key, value) for key, value in pack.final.items()}
    own = {"images": "given", "final": final, "best_on_test": None}
    _write(out, cfg, typed, pack.metrics | own, measured)


def _keys_of(pack: Pack) -> list[str]:
    """The keys that make the packed conditions; the user's come after them."""
    found = pack.conditions
    keys = {f"scene.{key}": found[key] for key in DECISIVE if key in found}
    keys |= {"scene.background": found.get("background"), "train.resolution_scale": found.get("resolution_scale")}
    keys["evaluate.lpips"] = pack.final.get("lpips_alex") is not None
    return [f"{key}={json.dumps(value)}" for key, value in keys.items() if value is not None]


def _scene(keys: list[str]) -> tuple[Config, Prepared, dict[str, Any]]:
    """The configuration, the data, and which keys of the scene were changed."""
    order, cfg = command_of([NO_POINTS, *keys])
    torch.set_num_threads(1)  # as in a run: views are measured side by side
    data = prepare(cfg, log)
    cfg = for_scene(order, data)
    refuse_small_images(data.scene, cfg.train.resolution_scale)
    return cfg, data, {key: value for key, value in changes(order, data.scene).items() if key.startswith("scene.")}


def _folder(out: Path | None, cfg: Config, method: str) -> Path:
    """Where the results go. ValueError, one line, where another program's files or a trained run are there."""
    out = out or Path("results") / "runs" / cfg.scene.name / "given" / method / f"seed{cfg.seed}"
    refuse_foreign(out)
    if (out / FILES["stages"]).exists():
        raise ValueError(f"{out}: expected nothing or an earlier score, found a trained run; give another --out")
    return out


def _measure(cfg: Config, data: Prepared, render: Render, out: Path) -> Evaluation:
    log(f"score: {len(data.scene.test)} test views of {cfg.scene.name}")
    (out / FILES["renders"]).mkdir(parents=True, exist_ok=True)
    save = picture_saver(out / FILES["renders"], data.scene)
    return measure_images(data.scene, cfg, thread_count(cfg.threads), render, save)


def _declared(cfg: Config, data: Prepared, changed: dict[str, Any]) -> dict[str, Any]:
    """What metrics.json says before anything is measured."""
    return {
        "scene": cfg.scene.name, "changes": changed, "seed": cfg.seed, "capture": data.scene.capture, "date": now(),
        **measured_by(cfg, data.scene, {}), "images": "given", "best_on_test": None,
        "data": recorded(cfg.scene.name, data.scene.source),
        **({} if data.scene.test_split is None else {"test_split": data.scene.test_split}),
    }  # fmt: skip


def _found(cfg: Config, data: Prepared, found: Evaluation) -> dict[str, Any]:
    return {
        **measured_by(cfg, data.scene, found.lpips_weights), "final": found.metrics, "note": found.note(),
        "n_test_views": len(found.per_image),
    }  # fmt: skip


def _write(out: Path, cfg: Config, typed: str, metrics: dict[str, Any], found: Evaluation) -> None:
    write_text(out / FILES["config"], config_text(asdict(cfg)))
    write_json(out / FILES["provenance"], provenance(typed))
    write_csv(out / FILES["per_image"], [{"model": "final", **row} for row in found.per_image])
    write_json(out / FILES["metrics"], metrics)
    final = metrics["final"]
    log(f"{metrics['protocol']}: PSNR {final['psnr']:.2f} dB, SSIM {final['ssim']:.4f}; written to {out}")


if __name__ == "__main__":
    sys.exit(main())

"""Result files that NerfBaselines reads: values a view as it unpacks them, and its hash of them."""

from __future__ import annotations

import base64
import hashlib
import json
import struct
from pathlib import Path

from report_runs import write_run

from pipeline.report.__main__ import main


def test_values_are_unpacked_as_nerfbaselines_does(tmp_path: Path) -> None:
    write_run(tmp_path / "runs", "dnerf/hook", psnr=30.0, images=3)  # 30, 31 and 32 dB
    assert main([str(tmp_path / "runs"), "--out", str(tmp_path / "out"), "--nerfbaselines"]) == 0
    (file,) = (tmp_path / "out/nerfbaselines").glob("*.json")
    found = json.loads(file.read_text())
    data = base64.b64decode(found["metrics_raw"]["psnr"])
    assert list(struct.unpack(f"<{len(data) // 4}f", data)) == [30.0, 31.0, 32.0]
    assert found["metrics"] == {"psnr": 31.0} and found["evaluation_protocol"] == "dnerf-400-black-v1"
    metadata = found["nb_info"]["dataset_metadata"]
    assert (metadata["id"], metadata["scene"]) == ("dnerf", "hook")
    assert found["nb_info"]["method"] == "gaussians-4d:fast:full" and found["nb_info"]["total_train_time"] == 60.0
    packed = base64.b64encode(b"".join(struct.pack("<f", value) for value in (30.0, 31.0, 32.0)))
    assert found["metrics_sha256"] == hashlib.sha256(b"psnr" + packed + b"\n").hexdigest()

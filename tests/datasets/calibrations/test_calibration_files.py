"""Every format of one rig, written by hand: `a` at (0, 0, -4) looks along +z, `b` at (4, 0, 0) along -x, y down.

Values in the files have at least nine digits, so that 1e-7 is their rounding.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import scipy.io

from datasets.calibrations.read import read_calibration
from datasets.calibrations.rig import Rig
from datasets.files.errors import SceneError

POSE_A = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 4], [0, 0, 0, 1]]
POSE_B = [[0, 0, 1, 0], [0, 1, 0, 0], [-1, 0, 0, 4], [0, 0, 0, 1]]  # a quarter turn about y
BENT = (-0.2, 0.05, 0.001, -0.002, 0.01)
QUARTER = "1.5707963267948966"

ANIPOSE = f"""[cam_0]
name = "a"
size = [ 640, 480,]
matrix = [ [ 500.0, 0.0, 310.0,], [ 0.0, 510.0, 230.0,], [ 0.0, 0.0, 1.0,],]
distortions = [ -0.2, 0.05, 0.001, -0.002, 0.01,]
rotation = [ 0.0, 0.0, 0.0,]
translation = [ 0.0, 0.0, 4.0,]

[cam_1]
name = "b"
size = [ 640, 480,]
matrix = [ [ 500.0, 0.0, 310.0,], [ 0.0, 510.0, 230.0,], [ 0.0, 0.0, 1.0,],]
distortions = [ -0.2, 0.05, 0.001, -0.002, 0.01,]
rotation = [ 0.0, {QUARTER}, 0.0,]
translation = [ 0.0, 0.0, 4.0,]

[metadata]
adjusted = false
error = 0.0
"""

CALISCOPE = """[cameras.0]
cam_id = 0
ignore = true
size = [640, 480]

[cameras.1]
cam_id = 1
size = [640, 480]
matrix = [[500.0, 0.0, 310.0], [0.0, 510.0, 230.0], [0.0, 0.0, 1.0]]
distortions = [-0.2, 0.05, 0.001, -0.002, 0.01]
translation = [0.0, 0.0, 4.0]
rotation = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]

[cameras.2]
cam_id = 2
size = [640, 480]
matrix = [[500.0, 0.0, 310.0], [0.0, 510.0, 230.0], [0.0, 0.0, 1.0]]
distortions = [-0.2, 0.05, 0.001, -0.002, 0.01]
translation = [0.0, 0.0, 4.0]
rotation = [[0.0, 0.0, 1.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]]
"""

QUALISYS = """<?xml version='1.0' encoding='ASCII'?>
<calibration><cameras>
<camera model="Miqus Video" serial="a"><fov_video left="0" right="639" top="0" bottom="479"/>
<transform r11="1" r12="0" r13="0" r21="0" r22="-1" r23="0" r31="0" r32="0" r33="-1" x="0" y="0" z="-4000"/>
<intrinsic focalLengthU="32000" focalLengthV="32640" centerPointU="19840" centerPointV="14720" radialDistortion1="-0.2"
 radialDistortion2="0.05" tangentalDistortion1="0.001" tangentalDistortion2="-0.002"/></camera>
<camera model="Miqus M3" serial="markers"/>
<camera model="Miqus Video" serial="b"><fov_video left="0" right="639" top="0" bottom="479"/>
<transform r11="0" r12="0" r13="1" r21="0" r22="-1" r23="0" r31="1" r32="0" r33="0" x="4000" y="0" z="0"/>
<intrinsic focalLengthU="32000" focalLengthV="32640" centerPointU="19840" centerPointV="14720" radialDistortion1="-0.2"
 radialDistortion2="0.05" tangentalDistortion1="0.001" tangentalDistortion2="-0.002"/></camera>
</cameras></calibration>
"""

NUMBERED = """%YAML:1.0
---
image_width: 640
image_height: 480
"""


def matrix(key: str, rows: int, columns: int, data: str) -> str:
    """As OpenCV's FileStorage writes it."""
    return f"{key}: !!opencv-matrix\n   rows: {rows}\n   cols: {columns}\n   dt: d\n   data: [ {data} ]\n"


K = "500., 0., 310., 0., 510., 230., 0., 0., 1."
D = "-2.0000000000000001e-01, 5.0000000000000003e-02, 1.0000000000000000e-03,\n       -2e-03, 1.0e-02"
EYE, TURNED = "1., 0., 0., 0., 1., 0., 0., 0., 1.", "0., 0., 1., 0., 1., 0., -1., 0., 0."


def of_camera(name: str, turned: str) -> str:
    rotation = matrix(f"Rot_{name}", 3, 3, turned) if "," in turned[:3] or turned.count(",") == 8 else ""
    return (
        matrix(f"K_{name}", 3, 3, K) + matrix(f"dist_{name}", 1, 5, D) + rotation + matrix(f"T_{name}", 3, 1, "0, 0, 4")
    )


def ros(name: str, rectification: str, x: float) -> str:
    return f"""image_width: 640
image_height: 480
camera_name: {name}
camera_matrix:
  rows: 3
  cols: 3
  data: [500, 0, 309.5, 0, 510, 229.5, 0, 0, 1]
distortion_model: plumb_bob
distortion_coefficients:
  rows: 1
  cols: 5
  data: [-0.2, 0.05, 0.001, -0.002, 0.01]
rectification_matrix: {{rows: 3, cols: 3, data: [{rectification}]}}
projection_matrix: {{rows: 3, cols: 4, data: [400, 0, 320, {-400 * x}, 0, 400, 240, 0, 0, 0, 1, 0]}}
"""


def check(rig: Rig, principal: tuple[float, float] = (310.5, 230.5), names: str = "ab", bent: tuple = BENT) -> None:
    """The cameras above; principal: in pixels of which the first is centred at 0.5."""
    assert [camera.name for camera in rig.cameras] == list(names)
    for camera, pose in zip(rig.cameras, (POSE_A, POSE_B)):
        assert camera.intrinsics == pytest.approx((500, 510, *principal))
        assert camera.bent == pytest.approx(bent)
        np.testing.assert_allclose(camera.pose, pose, atol=1e-7)


def test_anipose_toml(tmp_path: Path) -> None:
    (tmp_path / "calibration.toml").write_text(ANIPOSE)
    rig = read_calibration(tmp_path / "calibration.toml")
    check(rig)
    assert {camera.size for camera in rig.cameras} == {(640, 480)} and rig.says_direction


def test_caliscope_toml_without_the_camera_to_ignore(tmp_path: Path) -> None:
    (tmp_path / "camera_array.toml").write_text(CALISCOPE)
    rig = read_calibration(tmp_path / "camera_array.toml")
    check(rig, names="12")
    assert "0 without" in rig.notes[0]


def test_pose2sim_toml_of_a_fisheye_lens(tmp_path: Path) -> None:
    text = ANIPOSE.replace(", 0.01,]", "]").replace("[cam_1]", "fisheye = true\n[cam_1]")
    (tmp_path / "Calib.toml").write_text(text)
    rig = read_calibration(tmp_path / "Calib.toml")
    check(rig, bent=BENT[:4])
    assert [camera.fisheye for camera in rig.cameras] == [True, False]


def test_qualisys_without_the_camera_of_markers(tmp_path: Path) -> None:
    (tmp_path / "room.qca.txt").write_text(QUALISYS)
    rig = read_calibration(tmp_path / "room.qca.txt")
    check(rig, bent=BENT[:4])
    assert rig.cameras[0].size == (640, 480) and "1 cameras" in rig.notes[0]


def test_opencv_yaml_with_named_keys(tmp_path: Path) -> None:
    (tmp_path / "rig.yml").write_text(NUMBERED + of_camera("a", EYE) + of_camera("b", TURNED))
    rig = read_calibration(tmp_path / "rig.yml")
    check(rig)
    assert rig.cameras[0].size == (640, 480) and not rig.says_direction


def test_easymocaps_two_files_with_a_vector_beside_the_matrix(tmp_path: Path) -> None:
    intrinsics = "".join(matrix(f"K_{n}", 3, 3, K) + matrix(f"dist_{n}", 1, 5, D) for n in ("01", "02"))
    (tmp_path / "intri.yml").write_text(f'%YAML:1.0\n---\nnames:\n   - "01"\n   - "02"\n{intrinsics}')
    extrinsics = "".join(
        matrix(f"R_{name}", 3, 1, "9., 9., 9.")
        + matrix(f"Rot_{name}", 3, 3, turned)
        + matrix(f"T_{name}", 3, 1, "0,0,4")
        for name, turned in (("01", EYE), ("02", TURNED))
    )
    (tmp_path / "extri.yml").write_text(f"%YAML:1.0\n---\n{extrinsics}")
    for file in ("intri.yml", "extri.yml"):
        rig = read_calibration(tmp_path / file)
        assert [camera.name for camera in rig.cameras] == ["01", "02"]
        np.testing.assert_allclose(rig.cameras[1].pose, POSE_B)


def test_opencvs_stereo_pair(tmp_path: Path) -> None:
    text = NUMBERED + "".join(matrix(f"M{n}", 3, 3, K) + matrix(f"D{n}", 1, 5, D) for n in (1, 2))
    text += matrix("R", 3, 3, TURNED) + matrix("T", 3, 1, "0, 0, 4") + matrix("R1", 3, 3, EYE) + matrix("R2", 3, 3, EYE)
    (tmp_path / "stereo.yaml").write_text(text)
    first, second = read_calibration(tmp_path / "stereo.yaml").cameras
    np.testing.assert_array_equal(first.pose, np.eye(4))
    np.testing.assert_allclose(second.pose, POSE_B)


def test_a_folder_of_opencv_files_called_after_their_cameras(tmp_path: Path) -> None:
    for name, turn in (("a", "0., 0., 0."), ("b", f"0., {QUARTER}, 0.")):
        text = matrix("camera_matrix", 3, 3, K) + matrix("distortion_coefficients", 1, 5, D)
        text += matrix("rvec", 3, 1, turn) + matrix("tvec", 3, 1, "0, 0, 4")
        (tmp_path / f"{name}.yaml").write_text(NUMBERED + text)
    check(read_calibration(tmp_path))


def test_a_mapping_for_each_camera(tmp_path: Path) -> None:
    text = "".join(
        f"{name}:\n  K: [[500, 0, 310], [0, 510, 230], [0, 0, 1]]\n  dist: [-0.2, 0.05, 1e-3, -2e-3, 1e-2]\n"
        f"  w2c: {pose[:3]}\n"
        for name, pose in (("a", POSE_A), ("b", POSE_B))
    )
    (tmp_path / "rig.yaml").write_text(text)
    check(read_calibration(tmp_path / "rig.yaml"))


def test_ros_camera_info_of_a_rectified_pair(tmp_path: Path) -> None:
    """The right camera is turned by its rectification, and its place is in its projection."""
    (tmp_path / "left.yaml").write_text(ros("left", "1, 0, 0, 0, 1, 0, 0, 0, 1", 0.0))
    (tmp_path / "right.yaml").write_text(ros("right", "0, 0, -1, 0, 1, 0, 1, 0, 0", 0.25))
    left, right = read_calibration(tmp_path).cameras
    np.testing.assert_array_equal(left.pose, np.eye(4))
    assert left.intrinsics == (500, 510, 310, 230)
    np.testing.assert_allclose(right.pose[:3, :3], np.array(POSE_B)[:3, :3])
    np.testing.assert_allclose(-right.pose[:3, :3].T @ right.pose[:3, 3], [0.25, 0, 0], atol=1e-12)


def test_ros_camera_info_of_single_calibrations_has_no_poses(tmp_path: Path) -> None:
    for name in ("left", "right"):
        (tmp_path / f"{name}.yaml").write_text(ros(name, "1, 0, 0, 0, 1, 0, 0, 0, 1", 0.0))
    with pytest.raises(SceneError, match="camera_info of single calibrations has no poses"):
        read_calibration(tmp_path)


MATLAB_K = [[500.0, 0, 0], [0, 510, 0], [310, 230, 1]]


def test_matlab_struct_of_dannce(tmp_path: Path) -> None:
    """K is transposed, pixels count from 1, and rotations multiply from the right: r is the transposed one."""
    params = np.empty((2, 1), dtype=object)
    for row, pose in enumerate((POSE_A, POSE_B)):
        turned = np.array(pose, float)[:3, :3].T
        params[row, 0] = {
            "K": MATLAB_K, "RDistort": [-0.2, 0.05, 0.01], "TDistort": [0.001, -0.002], "r": turned, "t": [0.0, 0, 4],
        }  # fmt: skip
    names = np.array([["a"], ["b"]], dtype=object)
    scipy.io.savemat(tmp_path / "label3d_dannce.mat", {"params": params, "camnames": names})
    check(read_calibration(tmp_path / "label3d_dannce.mat"), principal=(309.5, 229.5))


def test_matlab_of_version_7_3_is_refused_with_the_way_out(tmp_path: Path) -> None:
    """By its header: text, the version 0x0200 in little endian, and the mark of the byte order."""
    path = tmp_path / "new.mat"
    path.write_bytes(b"MATLAB 7.3 MAT-file".ljust(124) + b"\x00\x02IM" + bytes(512))
    with pytest.raises(SceneError, match=r"new.mat: expected a .mat of version 7 or older, found version 7.3; .*-v7"):
        read_calibration(path)


def test_matlab_struct_of_a_stereo_calibration(tmp_path: Path) -> None:
    one = {
        "IntrinsicMatrix": MATLAB_K, "RadialDistortion": [-0.2, 0.05], "TangentialDistortion": [0.0, 0.0],
        "ImageSize": [480.0, 640.0],
    }  # fmt: skip
    other = {**one, "K": np.transpose(MATLAB_K)}  # as newer versions have it
    stereo = {
        "CameraParameters1": one, "CameraParameters2": other,
        "RotationOfCamera2": np.array(POSE_B, float)[:3, :3].T, "TranslationOfCamera2": [0.0, 0.0, 4.0],
    }  # fmt: skip
    scipy.io.savemat(tmp_path / "stereo.mat", {"stereo": stereo})
    first, second = read_calibration(tmp_path / "stereo.mat").cameras
    np.testing.assert_allclose(second.pose, POSE_B)
    assert first.intrinsics == second.intrinsics == (500, 510, 309.5, 229.5)
    assert first.size == (640, 480) and first.bent == (-0.2, 0.05, 0, 0, 0)


def test_colmap_model(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 OPENCV 640 480 500 510 310.5 230.5 -0.2 0.05 0.001 -0.002\n")
    half = np.sqrt(0.5)
    (tmp_path / "images.txt").write_text(f"1 1 0 0 0 0 0 4 1 a/001.png\n\n2 {half} 0 {half} 0 0 0 4 1 b/001.png\n\n")
    check(read_calibration(tmp_path), bent=BENT[:4])


@pytest.mark.parametrize(
    ("name", "text", "complaint"),
    [
        ("a.toml", "[cam_0]\nsize = [1, 2]\n", "a table for each camera"),
        ("a.toml", "no toml", "expected TOML"),
        ("a.toml", ANIPOSE.replace("translation", "moved"), "the key translation"),
        ("a.toml", ANIPOSE.replace('"b"', '"a"'), "several called a"),
        ("a.toml", ANIPOSE.replace("500.0, 0.0, 310", "500.0, 90.0, 310"), "pixels without skew"),
        ("a.yaml", "%YAML:1.0\n---\n" + matrix("K_1", 3, 3, K), "a pose .R and T."),
        ("a.yaml", "threshold: 3\n", "cameras as K_1, D_1"),
        ("a.qca.txt", "<calibration/>", "cameras/camera of a video model"),
        ("a.npz", "", "a calibration: .toml"),
    ],
)
def test_a_file_that_is_no_calibration(tmp_path: Path, name: str, text: str, complaint: str) -> None:
    (tmp_path / name).write_text(text)
    with pytest.raises(SceneError, match=complaint):
        read_calibration(tmp_path / name)

"""Reading and writing frames: what is written is read, and every bad input gets one clear line."""

import json
import subprocess
import sys
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from mapping import DataError, FrameError
from perception import Frame, load_frame, load_images, save_frame

NAMES = ("depth.png", "rgb.png", "labels.png", "camera.json")


@pytest.fixture
def folder(tabletop_frame: Frame, tmp_path: Path) -> Path:
    target = tmp_path / "frame"
    save_frame(tabletop_frame, target)
    return target


def change_json(path: Path, **changes: object) -> None:
    """Set keys of a JSON file; None removes the key."""
    content = json.loads(path.read_text())
    for key, value in changes.items():
        content.pop(key, None)
        if value is not None:
            content[key] = value
    path.write_text(json.dumps(content))


def refusal(path: Path) -> str:
    """The one line with which loading the path is refused."""
    with pytest.raises(FrameError) as caught:
        load_frame(path)
    message = str(caught.value)
    assert "\n" not in message
    assert str(path) in message
    return message


@pytest.mark.parametrize("depth_scale", [0.001, 0.0001])
def test_a_saved_frame_is_read_back(tabletop_frame: Frame, tmp_path: Path, depth_scale: float) -> None:
    save_frame(tabletop_frame, tmp_path / "frame", depth_scale)
    loaded = load_frame(tmp_path / "frame")
    np.testing.assert_allclose(loaded.depth, tabletop_frame.depth, atol=0.51 * depth_scale)
    np.testing.assert_array_equal(loaded.labels, tabletop_frame.labels)
    np.testing.assert_array_equal(loaded.rgb, tabletop_frame.rgb)
    np.testing.assert_array_equal(loaded.camera.K, tabletop_frame.camera.K)
    np.testing.assert_array_equal(loaded.camera.T_world_camera, tabletop_frame.camera.T_world_camera)
    assert loaded.names == tabletop_frame.names
    assert not list((tmp_path / "frame").glob("*.part"))


def test_saving_again_leaves_nothing_of_the_frame_before(tabletop_frame: Frame, folder: Path) -> None:
    np.save(folder / "depth.npy", np.ones((240, 320), np.float32))
    save_frame(Frame(tabletop_frame.depth, tabletop_frame.camera), folder)
    loaded = load_frame(folder)
    assert loaded.labels is None
    assert loaded.rgb is None
    np.testing.assert_allclose(loaded.depth, tabletop_frame.depth, atol=0.00051)


def test_depth_out_of_range_is_written_as_missing(tabletop_frame: Frame, tmp_path: Path) -> None:
    depth = tabletop_frame.depth.copy()
    depth[0, 0] = 8.0
    save_frame(Frame(depth, tabletop_frame.camera), tmp_path / "frame", 0.0001)
    assert np.isnan(load_frame(tmp_path / "frame").depth[0, 0])


def test_float_depth_is_read(tabletop_frame: Frame, folder: Path) -> None:
    (folder / "depth.png").unlink()
    np.save(folder / "depth.npy", tabletop_frame.depth)
    change_json(folder / "camera.json", depth_scale=None)
    np.testing.assert_array_equal(load_frame(folder).depth, tabletop_frame.depth)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_labels_of_8_and_16_bit_are_read(tabletop_frame: Frame, folder: Path, dtype: type) -> None:
    Image.fromarray(tabletop_frame.labels.astype(dtype)).save(folder / "labels.png")
    np.testing.assert_array_equal(load_frame(folder).labels, tabletop_frame.labels)


@pytest.mark.parametrize("key", ["segmap", "seg"])
def test_npz_is_read(tabletop_frame: Frame, tmp_path: Path, key: str) -> None:
    path = tmp_path / "frame.npz"
    arrays = {"depth": tabletop_frame.depth, "K": tabletop_frame.camera.K, key: tabletop_frame.labels}
    np.savez(path, rgb=tabletop_frame.rgb, **arrays)
    loaded = load_frame(path)
    np.testing.assert_array_equal(loaded.depth, tabletop_frame.depth)
    np.testing.assert_array_equal(loaded.labels, tabletop_frame.labels)


def test_separate_images_are_read(tabletop_frame: Frame, folder: Path) -> None:
    K = tabletop_frame.camera.K
    numbers = [K[0, 0], K[1, 1], K[0, 2], K[1, 2]]
    loaded = load_images(folder / "rgb.png", folder / "depth.png", folder / "labels.png", numbers, 0.001)
    np.testing.assert_array_equal(loaded.camera.K, K)
    np.testing.assert_array_equal(loaded.labels, tabletop_frame.labels)
    bare = load_images(None, folder / "depth.png", None, K, 0.001)
    assert bare.rgb is None
    assert bare.labels is None


@pytest.mark.parametrize("numbers", [[500, 500, 160], [500, 0, 160, 120], [500, 500, float("nan"), 120]])
def test_bad_intrinsics_are_refused(folder: Path, numbers: list[float]) -> None:
    with pytest.raises(FrameError):
        load_images(None, folder / "depth.png", None, numbers, 0.001)


@pytest.mark.parametrize("name", NAMES)
def test_unreadable_files_are_named(folder: Path, name: str) -> None:
    (folder / name).write_bytes(b"not what it says")
    assert name in refusal(folder)


@pytest.mark.parametrize("name", ["depth.png", "rgb.png", "labels.png"])
def test_truncated_images_are_named(folder: Path, name: str) -> None:
    content = (folder / name).read_bytes()
    (folder / name).write_bytes(content[: len(content) * 2 // 3])
    assert f"{name}: damaged" in refusal(folder)


@pytest.mark.parametrize("name", ["depth.png", "camera.json"])
def test_missing_files_are_named(folder: Path, name: str) -> None:
    (folder / name).unlink()
    assert name in refusal(folder)


@pytest.mark.parametrize("name", ["depth.png", "rgb.png", "labels.png"])
def test_other_sizes_are_refused(folder: Path, name: str) -> None:
    image = Image.open(folder / name)
    image.crop((0, 0, 160, 100)).save(folder / name)
    message = refusal(folder)
    assert name in message
    assert "160x100" in message


def test_other_paths_are_refused(tmp_path: Path) -> None:
    assert "no such frame" in refusal(tmp_path / "nowhere")
    (tmp_path / "frame.bin").write_bytes(b"")
    assert "not a frame" in refusal(tmp_path / "frame.bin")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"K": None}, "lacks K"),
        ({"width": None, "height": None}, "lacks width, height"),
        ({"depth_scale": None}, "lacks depth_scale"),
        ({"depth_scale": 0}, "depth_scale"),
        ({"depth_scale": "furlong"}, "depth_scale"),
        ({"depth_scale": float("nan")}, "depth_scale"),
        ({"width": 320.5}, "width"),
        ({"K": [[float("nan"), 0, 1], [0, 1, 1], [0, 0, 1]]}, "NaN"),
        ({"K": [[300, 0, 5000], [0, 300, 100], [0, 0, 1]]}, "principal point"),
        ({"K": [[-300, 0, 100], [0, 300, 100], [0, 0, 1]]}, "focal lengths"),
        ({"T_world_camera": (2 * np.eye(4)).tolist()}, "rigid"),
        ({"T_world_camera": [1, 2]}, "T_world_camera"),
        ({"depth_scale": 1.0}, "millimetres read as metres"),
        ({"depth_scale": 1e-6}, "depth_scale"),
    ],
)
def test_bad_camera_files_are_refused(folder: Path, changes: dict, message: str) -> None:
    change_json(folder / "camera.json", **changes)
    assert message in refusal(folder)


def test_8_bit_and_coloured_depth_are_refused(folder: Path) -> None:
    depth = np.array(Image.open(folder / "depth.png"))
    Image.fromarray((depth // 256).astype(np.uint8)).save(folder / "depth.png")
    assert "16-bit" in refusal(folder)
    Image.fromarray(np.zeros((240, 320, 3), np.uint8)).save(folder / "depth.png")
    assert "one channel" in refusal(folder)


@pytest.mark.parametrize("value", [0, np.nan])
def test_empty_depth_is_refused(folder: Path, value: float) -> None:
    np.save(folder / "depth.npy", np.full((240, 320), value, np.float32))
    assert "empty" in refusal(folder)


def test_depth_arrays_of_other_types_are_refused(folder: Path) -> None:
    np.save(folder / "depth.npy", np.full((240, 320), 70, np.uint8))
    assert "metres" in refusal(folder)
    np.save(folder / "depth.npy", np.array([{}], dtype=object), allow_pickle=True)
    assert "pickled" in refusal(folder)


def test_wrong_labels_are_refused(tabletop_frame: Frame, folder: Path) -> None:
    coloured = np.repeat(tabletop_frame.labels[..., None], 3, 2).astype(np.uint8)
    coloured[..., 0] *= 2
    Image.fromarray(coloured).save(folder / "labels.png")
    assert "one channel" in refusal(folder)
    Image.fromarray(tabletop_frame.labels.astype(np.float32) / 2).save(folder / "labels.tiff")
    (folder / "labels.tiff").rename(folder / "labels.png")
    assert "whole numbers" in refusal(folder)
    Image.fromarray(np.zeros((240, 320), np.uint8)).save(folder / "labels.png")
    assert "no labelled pixel" in refusal(folder)


@pytest.mark.parametrize("content", ["[1]", '{"one": "mug"}', '{"1": 5}', "{"])
def test_wrong_names_are_refused(folder: Path, content: str) -> None:
    (folder / "names.json").write_text(content)
    assert "names.json" in refusal(folder)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"K": None}, "lacks the array 'K'"),
        ({"depth": None}, "lacks the array 'depth'"),
        ({"depth": np.ones((240, 320), np.uint16)}, "metres"),
        ({"depth": np.ones((240, 320, 2), np.float32)}, "2D"),
        ({"segmap": np.full((240, 320), 0.5, np.float32)}, "integers"),
        ({"segmap": np.ones((24, 32), np.uint8)}, "size"),
        ({"segmap": np.array([{}], dtype=object)}, "pickled"),
        ({"rgb": np.ones((240, 320), np.uint8)}, "rgb"),
        ({"K": np.full((3, 3), np.nan)}, "NaN"),
        ({"K": np.eye(4)}, "shape"),
    ],
)
def test_bad_npz_files_are_refused(
    tabletop_frame: Frame, tmp_path: Path, changes: dict, message: str
) -> None:
    path = tmp_path / "frame.npz"
    arrays = {"depth": tabletop_frame.depth, "K": tabletop_frame.camera.K, **changes}
    np.savez(path, **{key: value for key, value in arrays.items() if value is not None})
    assert message in refusal(path)


def test_damaged_npz_and_members_outside_are_refused(tabletop_frame: Frame, tmp_path: Path) -> None:
    path = tmp_path / "frame.npz"
    np.savez(path, depth=tabletop_frame.depth, K=tabletop_frame.camera.K)
    whole = path.read_bytes()
    with zipfile.ZipFile(path, "a") as archive:
        archive.writestr("../outside.npy", b"")
    assert "outside the archive" in refusal(path)
    path.write_bytes(whole[: len(whole) // 2])
    assert "not a readable .npz" in refusal(path)


def test_a_full_disk_leaves_no_frame(
    tabletop_frame: Frame, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    # Only the system call fails; everything of ours runs.
    monkeypatch.setattr("os.replace", full)
    with pytest.raises(DataError, match="No space left"):
        save_frame(tabletop_frame, tmp_path / "frame")
    assert list((tmp_path / "frame").iterdir()) == []


def test_importing_perception_is_light() -> None:
    code = (
        "import sys, perception; print([m for m in ('open3d', 'torch', 'cv2', 'scipy') if m in sys.modules])"
    )
    result = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert result.stdout.strip() == "[]"

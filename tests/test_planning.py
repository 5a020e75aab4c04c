"""What is refused, and what follows from a job, before any picture is decoded."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from interpolation_samples import CHAIN, job_of, listing
from omnisyn_cli.errors import ImageError, InputError, OutputPathError, PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation.plan import InterpolationPlan, plan_interpolation, with_preset
from omnisyn_cli.io import write_image
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.poses.file import PosedPanorama, write_poses
from synthesis_samples import as_bytes, hall_image, posed, write_hall


def test_depth_comes_from_files_where_all_have_one(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    assert plan_interpolation(job_of(tmp_path, images)).recipe.depth.kind == "file"
    assert plan_interpolation(job_of(tmp_path, images, depth="matching")).recipe.depth.kind == "matching"
    entries = {path.name: PosedPanorama(pose) for path, pose in zip(images, CHAIN, strict=False)}
    write_poses(tmp_path / "poses.json", entries)
    plan = plan_interpolation(job_of(tmp_path, images))
    assert plan.recipe == replace(PRESETS[DEFAULT_PRESET].recipe, adaptive=False)  # too few frames for it
    with pytest.raises(PoseError, match=r"'depth' file for every panorama, got none for p0\.png, p1\.png"):
        plan_interpolation(job_of(tmp_path, images, depth="file"))


@pytest.mark.parametrize(
    ("asked", "fusion"),
    [
        ({"preset": "fast", "depth": "refined"}, "geometric"),
        ({"preset": "balanced", "depth": "refined"}, "network"),
        ({"preset": "balanced", "depth": "matching"}, "geometric"),  # nothing learned
        ({"preset": "balanced", "depth": "matching", "fusion": "network"}, "network"),
        ({"preset": "balanced"}, "geometric"),  # depth comes from files
        ({"preset": "balanced", "fusion": "network"}, "network"),
        ({"preset": "balanced", "depth": "refined", "fusion": "geometric"}, "geometric"),
    ],
)
def test_the_preset_says_how_renderings_of_estimated_depth_are_fused(
    tmp_path: Path, asked: dict[str, str], fusion: str
) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    plan = plan_interpolation(job_of(tmp_path, images, **asked))
    assert plan.recipe.fusion == plan.describe()["fusion"] == fusion
    other = with_preset(plan, "fast")
    assert other.recipe.fusion == asked.get("fusion", "geometric")


def test_a_missing_depth_or_mask_file_is_found_before_any_work(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    (tmp_path / "p1_depth.exr").unlink()
    with pytest.raises(ImageError, match=r"p1_depth\.exr"):
        plan_interpolation(job_of(tmp_path, images))
    assert plan_interpolation(job_of(tmp_path, images, depth="matching")).recipe.depth.kind == "matching"


def test_the_size_is_that_of_the_largest_panorama_unless_asked_for(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2], (33, 66))
    assert plan_interpolation(job_of(tmp_path, images)).size == (34, 68)
    assert plan_interpolation(job_of(tmp_path, images, size=(16, 32))).size == (16, 32)
    with pytest.raises(InputError, match="try 32x16"):
        plan_interpolation(job_of(tmp_path, images, size=(16, 30)))
    write_image(images[1], as_bytes(hall_image(CHAIN[1], (64, 128))))
    assert plan_interpolation(job_of(tmp_path, images)).size == (64, 128)


def test_frames_follow_from_duration_and_rate(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN)
    assert len(plan_interpolation(job_of(tmp_path, images, frames=None)).path) == 180
    assert len(plan_interpolation(job_of(tmp_path, images, frames=None, duration=2.0, fps=12.5)).path) == 25


REFUSED = {
    "one image": ({"images": 1}, InputError, "two or more panoramas, got 1"),
    "too few frames": ({"frames": 2, "images": 3}, InputError, "at least 3 frames"),
    "too short": ({"frames": None, "duration": 0.01}, InputError, "at least 2 frames"),
    "endless": ({"frames": None, "duration": float("inf")}, InputError, "at most 1,000,000 frames, got inf"),
    "undefined": ({"frames": None, "fps": float("nan")}, InputError, "at most 1,000,000 frames, got nan"),
    "frames as a video": ({"save_frames": "b.mp4"}, OutputPathError, "folder or a pattern"),
    "frames where frames go": ({"save_frames": "out"}, OutputPathError, "place of its own"),
    "confidence where frames go": ({"save_confidence": "out/%06d.png"}, OutputPathError, "place of its own"),
    "confidence where frames are kept": (
        {"save_frames": "kept", "save_confidence": "kept"},
        OutputPathError,
        "place of its own",
    ),
    "confidence as the video": (
        {"output": "a.mp4", "save_confidence": "./a.mp4"},
        OutputPathError,
        "place of its own",
    ),
    "no folder for depth": ({"save_depth": "none/depth"}, OutputPathError, "create it first"),
    "depth into a file": ({"save_depth": "poses.json"}, OutputPathError, "got a file"),
    "odd size for video": ({"output": "a.mp4", "size": (17, 34)}, InputError, "even width and height"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_work_is_refused_before_any_work(tmp_path: Path, case: str) -> None:
    changes, error, words = REFUSED[case]
    images = write_hall(tmp_path, CHAIN)[: changes.get("images", 2)]
    before = listing(tmp_path)
    paths = {key: tmp_path / value for key, value in changes.items() if isinstance(value, str)}
    others = {key: value for key, value in changes.items() if key not in paths and key != "images"}
    with pytest.raises(error, match=words):
        plan_interpolation(job_of(tmp_path, images, **paths, **others))
    assert listing(tmp_path) == before


def test_overwriting_never_reaches_the_inputs(tmp_path: Path) -> None:
    """A folder of numbered panoramas as the output would be emptied of its former frames: of the inputs."""
    images = write_hall(tmp_path, CHAIN[:2])
    numbered = [image.rename(tmp_path / f"{index:06d}.png") for index, image in enumerate(images)]
    entries = {path.name: PosedPanorama(pose, tmp_path / f"p{index}_depth.exr")
               for index, (path, pose) in enumerate(zip(numbered, CHAIN, strict=False))}  # fmt: skip
    write_poses(tmp_path / "poses.json", entries)
    for place in ({"output": tmp_path}, {"save_frames": tmp_path, "output": tmp_path / "a.mp4"}):
        with pytest.raises(OutputPathError, match=r"000000\.png: expected inputs that are not overwritten"):
            plan_interpolation(job_of(tmp_path, numbered, overwrite=True, **place))
    assert plan_interpolation(job_of(tmp_path, numbered, output=tmp_path / "f_%03d.png", overwrite=True))


def test_a_model_without_a_network_and_unknown_choices_are_refused(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    with pytest.raises(InputError, match="found none"):
        plan_interpolation(job_of(tmp_path, images, model="some.onnx"))
    with pytest.raises(InputError, match="only for depth refined or network"):
        plan_interpolation(job_of(tmp_path, images, depth="matching", model="some.onnx"))
    with pytest.raises(InputError, match="name one"):
        plan_interpolation(job_of(tmp_path, images, depth="network"))
    for wrong in (
        {"preset": "hasty"},
        {"depth": "nonsense"},
        {"renderer": "wires"},
        {"heading": "north"},
        {"ease": "fast"},
    ):
        with pytest.raises(InputError, match="expected one of"):
            plan_interpolation(job_of(tmp_path, images, **wrong))


@pytest.mark.parametrize("more", [[], ["--budget", "60"]])
def test_a_plan_is_made_without_kernels(tmp_path: Path, more: list[str]) -> None:
    images = [str(path) for path in write_hall(tmp_path, CHAIN[:2], with_depth=not more)]
    arguments = ["interpolate", *images, "--poses", str(tmp_path / "poses.json"), "-o", str(tmp_path / "a.mp4"), *more]
    code = (
        "import sys; from omnisyn_cli.cli import cli; "
        f"cli.main({[*arguments, '--dry-run', '-q']!r}, standalone_mode=False); "
        "print([name for name in ('numba', 'torch', 'onnxruntime', 'cv2') if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.splitlines()[-1] == "[]"


def test_the_encoder_is_named_after_the_pattern(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    plan = plan_interpolation(job_of(tmp_path, images, output=tmp_path / "frame_%05d.jpg"))
    assert plan.describe()["encoder"] == "jpg images"


def test_what_headers_tell_is_refused_before_anything_is_decoded(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    with pytest.raises(InputError, match="either frames or a duration"):
        plan_interpolation(job_of(tmp_path, images, duration=2.0))
    with pytest.raises(InputError, match="at most"):
        plan_interpolation(job_of(tmp_path, images, size=(50_000, 100_000)))
    write_image(tmp_path / "p0_depth.png", as_bytes(hall_image(CHAIN[0])))
    text = (tmp_path / "poses.json").read_text().replace("p0_depth.exr", "p0_depth.png")
    (tmp_path / "poses.json").write_text(text)
    with pytest.raises(ImageError, match="expected depth as EXR"):
        plan_interpolation(job_of(tmp_path, images))
    write_image(images[0], np.zeros((1, 2, 3), np.uint8))
    with pytest.raises(ImageError, match="at least 4×2"):
        plan_interpolation(job_of(tmp_path, images))


def test_depth_of_some_panoramas_only_is_said_not_to_be_used(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    text = (tmp_path / "poses.json").read_text()
    entries = json.loads(text)
    del entries["panoramas"][images[1].name]["depth"]
    (tmp_path / "poses.json").write_text(json.dumps(entries))
    (note,) = plan_interpolation(job_of(tmp_path, images)).notes
    assert f"for {images[0].name} only" in note


def test_depth_beside_a_model_is_said_not_to_be_used(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    (note,) = plan_interpolation(job_of(tmp_path, images, model="completion-balanced")).notes
    assert "unused with --model" in note


def test_a_mask_of_another_size_is_refused_wherever_it_is_in_a_chain(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN)
    masks = []
    for k, image in enumerate(images):
        mask = np.full_like(as_bytes(hall_image(CHAIN[k])), 255)
        write_image(tmp_path / f"m{k}.png", mask[:4, :8] if k == 2 else mask)
        masks.append(image.with_name(f"m{k}.png"))
    with pytest.raises(InputError, match=r"m2\.png: expected a mask of 128×64 pixels, got 8×4"):
        plan_interpolation(job_of(tmp_path, images, masks=tuple(masks)))


def test_two_pictures_of_one_name_are_refused_and_the_same_one_again_is_not(tmp_path: Path) -> None:
    """A pose file could not tell them apart, nor could names of depth files."""
    images = write_hall(tmp_path, CHAIN)
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / images[0].name
    other.write_bytes(images[1].read_bytes())
    with pytest.raises(PoseError, match=r"other.*expected a name of its own, got that of"):
        plan_interpolation(job_of(tmp_path, [images[0], images[1], other]))
    other.unlink()
    other.symlink_to(images[0])
    assert len(plan_interpolation(job_of(tmp_path, [images[0], images[1], other])).entries) == 3


def test_a_tour_says_how_many_panoramas_have_depth_from_both_neighbours(tmp_path: Path) -> None:
    """None of those at one place with a neighbour, none where depth is known; and the memory of one pair ahead."""

    def plan(poses: list[Pose], **options: object) -> InterpolationPlan:
        images = write_hall(tmp_path, poses, **options)
        return plan_interpolation(job_of(tmp_path, images, frames=9))

    ahead = [posed((0, 0, -0.4 * k)) for k in range(5)]
    assert plan(ahead, with_depth=False).describe()["joined_depths"] == 3
    assert plan([*ahead, ahead[4]], with_depth=False).describe()["joined_depths"] == 3
    assert plan([ahead[0], *ahead[:2]], with_depth=False).describe()["joined_depths"] == 0
    assert plan(ahead[:2], with_depth=False).describe()["joined_depths"] == 0
    assert plan(ahead).describe()["joined_depths"] == 0
    two, three, five = (plan(ahead[:count], with_depth=False).memory for count in (2, 3, 5))
    assert two < three == five

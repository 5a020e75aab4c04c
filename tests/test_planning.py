"""What is refused and what follows from a job before any picture is decoded; the surfaces of a tour."""

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import OpenImageIO
import pytest

from interpolation_samples import CHAIN, Hall, edit_poses, job_of, listing, write_entries
from omnisyn_cli.errors import ImageError, InputError, OutputPathError, PoseError
from omnisyn_cli.fusion.confidence import PairConfidence
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.interpolation import loading
from omnisyn_cli.interpolation import plan as planning
from omnisyn_cli.interpolation.loading import PanoramaSurface, panorama_surfaces, tour_surfaces
from omnisyn_cli.interpolation.plan import InterpolationPlan, TourPlan, plan_interpolation, plan_tour, with_preset
from omnisyn_cli.interpolation.run import run_interpolation
from omnisyn_cli.io import read_panorama, write_image
from omnisyn_cli.io.encoders import CODECS
from omnisyn_cli.pipeline.config import FALLBACKS, MIN_PAIR_SCORE, RunConfig
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.types import DepthEstimate, View
from synthesis_samples import SIZE, as_bytes, distance_to_wall, hall_image, posed, write_hall, write_mask


def test_the_usual_fallback_fades_the_worst_of_the_pairs_that_are_warned_of() -> None:
    below = {name: RunConfig(fallback=name).faded_below for name in FALLBACKS}
    assert below["none"] == below["fail"] == 0.0 < below["auto"] < below["crossfade"]
    assert PairConfidence(below["crossfade"], 0.0, 0.0, 0.0).score == pytest.approx(MIN_PAIR_SCORE)


def test_depth_comes_from_files_where_all_have_one(tmp_path: Path, pair: Hall) -> None:
    assert pair.plan().config.depth.kind == "file"
    assert pair.plan(depth="matching").config.depth.kind == "matching"
    write_entries(tmp_path, pair.images, depth=None)
    assert pair.plan().config == replace(
        PRESETS[DEFAULT_PRESET].config, adaptive=False, fallback="auto"
    )  # too few frames for flat surfaces
    pair.refuses(PoseError, r"'depth' file for every panorama, got none for p0\.png, p1\.png", depth="file")


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
def test_the_preset_says_how_renderings_of_estimated_depth_are_fused(pair, asked, fusion) -> None:
    plan = pair.plan(**asked)
    assert plan.config.fusion == plan.describe()["fusion"] == fusion
    other = with_preset(plan, "fast")
    assert other.config.fusion == asked.get("fusion", "geometric")


def test_a_missing_depth_file_is_found_before_any_work(tmp_path: Path, pair: Hall) -> None:
    (tmp_path / "p1_depth.exr").unlink()
    pair.refuses(ImageError, r"p1_depth\.exr")
    assert pair.plan(depth="matching").config.depth.kind == "matching"


def test_the_size_is_that_of_the_largest_panorama_unless_asked_for(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2], (33, 66))
    assert plan_interpolation(job_of(tmp_path, images)).size == (34, 68)
    assert plan_interpolation(job_of(tmp_path, images, size=(16, 32))).size == (16, 32)
    with pytest.raises(InputError, match="try 32x16"):
        plan_interpolation(job_of(tmp_path, images, size=(16, 30)))
    write_image(images[1], as_bytes(hall_image(CHAIN[1], (64, 128))))
    assert plan_interpolation(job_of(tmp_path, images)).size == (64, 128)


def test_frames_follow_from_duration_and_rate(chain: Hall) -> None:
    assert len(chain.plan(frames=None).path) == 180
    assert len(chain.plan(frames=None, duration=2.0, fps=12.5).path) == 25


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
        {"save_frames": "kept", "save_confidence": "kept"}, OutputPathError, "place of its own",
    ),
    "confidence as the video": ({"output": "a.mp4", "save_confidence": "./a.mp4"}, OutputPathError, "place of its own"),
    "no folder for depth": ({"save_depth": "none/depth"}, OutputPathError, "create it first"),
    "depth into a file": ({"save_depth": "poses.json"}, OutputPathError, "got a file"),
    "odd size for video": ({"output": "a.mp4", "size": (17, 34)}, InputError, "even width and height"),
    "frames and a duration": ({"duration": 2.0}, InputError, "either frames or a duration"),
    "giant": ({"size": (50_000, 100_000)}, InputError, "at most"),
    "a model that is not there": ({"model": "some.onnx"}, InputError, "found none"),
    "a model for matching": ({"depth": "matching", "model": "some.onnx"}, InputError, "only for depth refined or"),
    "a prior that is not there": ({"depth_prior": "some.onnx"}, InputError, "found none"),
    "a prior that is no file": ({"depth_prior": "nonsense"}, InputError, "one of none.* as --depth-prior"),
    "a prior for matching": ({"depth": "matching", "depth_prior": "none"}, InputError, "with refined depth only"),
    "a prior of no kind": ({"depth_prior": "none", "depth_prior_kind": "cube"}, InputError, "separated by commas"),
    "a kind of nothing": ({"depth_prior_kind": "depth"}, InputError, "--depth-prior with --depth-prior-kind"),
    "a network without a name": ({"depth": "network"}, InputError, "name one"),
    **{f"unknown {key}": ({key: "nonsense"}, InputError, "expected one of")
       for key in ("preset", "depth", "renderer", "heading", "ease")},
}  # fmt: skip


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_work_is_refused_before_any_work(tmp_path: Path, case: str) -> None:
    changes, error, words = REFUSED[case]
    hall = Hall(tmp_path, write_hall(tmp_path, CHAIN)[: changes.get("images", 2)])
    before = listing(tmp_path)
    places = {key: tmp_path / changes[key] for key in changes if key.startswith(("output", "save_"))}
    hall.refuses(error, words, **{key: value for key, value in changes.items() if key != "images"} | places)
    assert listing(tmp_path) == before


def test_overwriting_never_reaches_the_inputs(tmp_path: Path, pair: Hall) -> None:
    """A folder of numbered panoramas as the output would be emptied of its former frames: of the inputs."""
    numbered = [image.rename(tmp_path / f"{index:06d}.png") for index, image in enumerate(pair.images)]
    write_entries(tmp_path, numbered)
    for place in ({"output": tmp_path}, {"save_frames": tmp_path, "output": tmp_path / "a.mp4"}):
        with pytest.raises(OutputPathError, match=r"000000\.png: expected inputs that are not overwritten"):
            plan_interpolation(job_of(tmp_path, numbered, overwrite=True, **place))
    assert plan_interpolation(job_of(tmp_path, numbered, output=tmp_path / "f_%03d.png", overwrite=True))


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


def test_the_encoder_is_named_after_the_pattern(tmp_path: Path, pair: Hall) -> None:
    plan = pair.plan(output=tmp_path / "frame_%05d.jpg")
    assert plan.describe()["encoder"] == "jpg images"


def test_what_headers_tell_is_refused_before_anything_is_decoded(tmp_path: Path, pair: Hall) -> None:
    write_image(tmp_path / "p0_depth.png", as_bytes(hall_image(CHAIN[0])))
    text = (tmp_path / "poses.json").read_text().replace("p0_depth.exr", "p0_depth.png")
    (tmp_path / "poses.json").write_text(text)
    pair.refuses(ImageError, "expected depth as EXR")
    write_image(pair.images[0], np.zeros((1, 2, 3), np.uint8))
    pair.refuses(ImageError, "at least 4×2")


def test_depth_beside_a_model_or_of_some_panoramas_only_is_said_not_to_be_used(tmp_path: Path, pair: Hall) -> None:
    (note,) = pair.plan(model="completion-balanced").notes
    assert "unused with --model" in note
    edit_poses(tmp_path, lambda panoramas: panoramas[pair.images[1].name].pop("depth"))
    (note,) = pair.plan().notes
    assert f"for {pair.images[0].name} only" in note


def test_a_mask_of_another_size_is_refused_wherever_it_is_in_a_chain(tmp_path: Path, chain: Hall) -> None:
    masks = []
    for k, image in enumerate(chain.images):
        mask = np.full_like(as_bytes(hall_image(CHAIN[k])), 255)
        write_image(tmp_path / f"m{k}.png", mask[:4, :8] if k == 2 else mask)
        masks.append(image.with_name(f"m{k}.png"))
    chain.refuses(InputError, r"m2\.png: expected a mask of 128×64 pixels, got 8×4", masks=tuple(masks))


def test_linear_light_is_shown_unless_frames_keep_it(tmp_path: Path) -> None:
    images = write_hall(tmp_path, CHAIN[:2])
    light = [read_panorama(image).image ** 2.2 for image in images]
    for k, samples in enumerate(light):
        buffer = OpenImageIO.ImageBuf(samples)
        assert buffer.write(str(tmp_path / f"p{k}.exr"))
    write_entries(tmp_path, [image.with_suffix(".exr") for image in images])
    pictures = {}
    for codec, changes in (("png", {}), ("exr", {}), ("tif", {"view_transform": False})):
        out = tmp_path / codec
        panoramas = [image.with_suffix(".exr") for image in images]
        plan = plan_interpolation(job_of(tmp_path, panoramas, codec=codec, output=out, **changes))
        assert any("linear light" in note for note in plan.notes) == (codec == "png")
        run_interpolation(plan)
        pictures[codec] = read_panorama(out / f"000000.{codec}").image
    np.testing.assert_allclose(pictures["exr"], light[0], atol=2e-3)
    np.testing.assert_allclose(pictures["tif"], light[0], atol=3e-3)
    assert (pictures["png"] - light[0])[light[0] < 0.5].mean() > 0.1


SMALL_PLAYERS = {"h264": 16, "h265": 24}  # Rows that players show, for pictures of these tests.


@pytest.mark.parametrize(
    ("changes", "size", "note"),
    [({}, (16, 32), "the video is 32x16, the panoramas are 128x64: few players show larger H.264; ask for more with "
      "--size or --codec h265"), ({"codec": "h265"}, (24, 48), "show larger H.265; ask for more with --size"),
     ({"size": (32, 64)}, (32, 64), None), ({"codec": "prores", "output": "a.mov"}, SIZE, None),
     ({"output": "frames"}, SIZE, None)],
)  # fmt: skip
def test_the_usual_size_is_what_players_show(pair: Hall, changes, size, note, monkeypatch) -> None:
    for codec, rows in SMALL_PLAYERS.items():
        monkeypatch.setitem(CODECS, codec, replace(CODECS[codec], player_rows=rows))
    plan = pair.plan(**{**changes, "output": pair.folder / changes.get("output", "a.mp4")})
    assert plan.size == size
    assert [each for each in plan.notes if "players" in each] == ([] if note is None else [plan.notes[0]])
    assert note is None or note in plan.notes[0]


def test_much_larger_photographs_are_read_at_the_size_that_frames_show(pair: Hall, monkeypatch) -> None:
    monkeypatch.setattr(planning, "MIN_READING_ROWS", 16)
    for rows, read in ((8, (16, 32)), (20, (40, 80)), (30, SIZE), (32, SIZE)):
        plan = pair.plan(size=(rows, 2 * rows))
        assert plan.source_sizes == (read, read)
        assert any(f"p0.png and 1 more: read at {read[1]}x{read[0]}" in note for note in plan.notes) == (read != SIZE)
    masks = tuple(write_mask(pair.folder / f"m{k}.png", 60) for k in range(2))
    run_interpolation(pair.plan(size=(8, 16), frames=3, output=pair.folder / "frames", masks=masks))
    assert read_panorama(pair.folder / "frames" / "000001.png").image.shape == (8, 16, 3)


def test_two_pictures_of_one_name_are_refused_and_the_same_one_again_is_not(tmp_path: Path, chain: Hall) -> None:
    """Unless the pose file calls them by their folders."""
    (tmp_path / "other").mkdir()
    other = tmp_path / "other" / chain.images[0].name
    other.write_bytes(chain.images[1].read_bytes())
    with pytest.raises(PoseError, match=r"other.*expected an entry of its own in .*, got that of"):
        plan_interpolation(job_of(tmp_path, [chain.images[0], chain.images[1], other]))
    first = chain.images[0].name
    edit_poses(tmp_path, lambda document: document.update({f"other/{first}": document[chain.images[2].name]}))
    named = plan_interpolation(job_of(tmp_path, [chain.images[0], chain.images[1], other]))
    np.testing.assert_array_equal(named.entries[2].pose.position, CHAIN[2].position)
    edit_poses(tmp_path, lambda document: document.pop(f"other/{first}"))
    other.unlink()
    other.symlink_to(chain.images[0])
    assert len(plan_interpolation(job_of(tmp_path, [chain.images[0], chain.images[1], other])).entries) == 3


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


def surfaces_of(plan: TourPlan) -> list[PanoramaSurface]:
    return list(panorama_surfaces(tour_surfaces(plan)))


def test_every_pair_has_both_views_with_their_depth_and_mesh(tmp_path: Path) -> None:
    plan = plan_tour(job_of(tmp_path, write_hall(tmp_path, CHAIN)))
    pairs = list(tour_surfaces(plan))
    assert [[surface.index for surface in pair.surfaces] for pair in pairs] == [[0, 1], [1, 2]]
    for pair in pairs:
        assert pair.cross_check.confidence.score > 0.9
        for surface in pair.surfaces:
            pose = CHAIN[surface.index]
            np.testing.assert_allclose(surface.view.pose.position, pose.position)
            np.testing.assert_allclose(1 / surface.mesh.inverse_depth, distance_to_wall(pose, SIZE), rtol=1e-5)
            np.testing.assert_array_equal(surface.texture(), as_bytes(hall_image(pose)))


def test_every_panorama_has_one_surface_of_what_both_its_pairs_found(tmp_path: Path, monkeypatch) -> None:
    plan = plan_tour(job_of(tmp_path, write_hall(tmp_path, CHAIN, with_depth=False), fallback="none"))
    left = np.arange(SIZE[1]) < SIZE[1] // 2
    knows = iter([left, ~left])

    def estimator(first: View, second: View) -> tuple[DepthEstimate, DepthEstimate]:
        known = np.broadcast_to(next(knows), SIZE).astype(np.float32)
        estimate = DepthEstimate(np.where(known > 0, np.float32(0.25), np.float32(0.7)), known)
        return estimate, estimate

    monkeypatch.setattr(loading, "make_estimator", lambda *_, **__: estimator)
    first, middle, last = surfaces_of(plan)
    assert [first.index, middle.index, last.index] == [0, 1, 2]
    np.testing.assert_array_equal(middle.mesh.inverse_depth, np.float32(0.25))
    for end, known in ((first, left), (last, ~left)):
        np.testing.assert_array_equal(end.mesh.inverse_depth == np.float32(0.25), np.broadcast_to(known, SIZE))


def test_a_panorama_at_a_neighbours_place_has_the_surface_of_the_other_pair(tmp_path: Path, monkeypatch) -> None:
    poses = [CHAIN[0], CHAIN[1], CHAIN[1]]
    plan = plan_tour(job_of(tmp_path, write_hall(tmp_path, poses, with_depth=False)))
    found = DepthEstimate(np.full(SIZE, 0.25, np.float32), np.ones(SIZE, np.float32))
    monkeypatch.setattr(loading, "make_estimator", lambda *_, **__: lambda *_: (found, found))
    middle = surfaces_of(plan)[1]
    assert middle.depth is found


def test_masked_pixels_have_no_surface_and_no_colour_of_their_own(tmp_path: Path, pair: Hall) -> None:
    painted = as_bytes(hall_image(CHAIN[0]))
    painted[48:] = 255
    write_image(pair.images[0], painted)
    masks = write_mask(tmp_path / "mask 0.png", 48), write_mask(tmp_path / "mask 1.png", SIZE[0])
    first, second = surfaces_of(plan_tour(pair.job(masks=masks)))
    assert (first.mesh.inverse_depth[48:] < 0).all()
    assert (first.mesh.inverse_depth[:48] > 0).all()
    assert (second.mesh.inverse_depth > 0).all()
    assert first.texture().max() <= painted[:48].max()


def test_panoramas_of_one_place_are_as_far_as_the_sky(tmp_path: Path) -> None:
    plan = plan_tour(job_of(tmp_path, write_hall(tmp_path, [CHAIN[0]] * 2, with_depth=False)))
    for surface in surfaces_of(plan):
        assert not surface.depth.inverse_depth.any()


def test_a_tour_is_refused_as_a_video_is_but_for_its_place(tmp_path: Path, chain: Hall) -> None:
    with pytest.raises(InputError, match="two or more panoramas, got 1"):
        plan_tour(job_of(tmp_path, chain.images[:1]))
    (tmp_path / "other.png").write_bytes(chain.images[0].read_bytes())
    with pytest.raises(PoseError, match=r"other\.png"):
        plan_tour(job_of(tmp_path, [*chain.images, tmp_path / "other.png"]))
    plan_tour(chain.job(output=tmp_path / "no such folder" / "model.glb"))

"""Records of an evaluation that was never made: figures that are easy to check, names that are hard to print."""

from pathlib import Path

import numpy as np

from omnisyn_cli.evaluation.results import DepthRecord, FrameRecord, UnitRecord, worst_frames
from omnisyn_cli.evaluation.visualization import error_map, turbo
from omnisyn_cli.io import write_image

SIZE = (32, 64)
STAGES = ("depth", "mesh", "render", "fuse")
DEPTH_FIELDS = (
    "imae", "irmse", "mae", "rmse", "abs_rel",
    "delta_105", "delta_110", "delta_125", "delta_125_squared", "delta_125_cubed",
)  # fmt: skip


def frame(t: float, score: float, *, length: float = 4.0, pictures: dict[str, str] | None = None) -> FrameRecord:
    scores = {"ws_psnr": score, "psnr": score + 0.5, "ws_ssim": 0.9, "ssim": 0.91, "lrce": 0.01}
    scores |= {"flying": 0.001, "shards": 0.02}
    if t > 0.25:  # not of the first of three
        scores["change_psnr"] = score + 3.0
    by_kind = {
        "psnr": {"agree": score + 2, "one_view": score - 6}, "area": {"agree": 0.75, "one_view": 0.25},
        "error": {"agree": 0.25, "one_view": 0.75},
    }  # fmt: skip
    return FrameRecord(f"t{t:.2f}.png", t, min(t, 1 - t) * length, scores, pictures or {}, by_kind)


def depth(view: str, error: float, pictures: dict[str, str] | None = None) -> DepthRecord:
    plain = {name: error if index < 5 else 1 - error for index, name in enumerate(DEPTH_FIELDS)}
    doubt = {"unsure_area": 2 * error, "within_5_unsure": 0.25, "within_5_sure": 0.75, "rank_correlation": 0.5}
    reliability = {
        "area": {"0.05": error, "0.95": 1 - error}, "confidence": {"0.05": 0.1, "0.95": 0.9},
        "within_5": {"0.05": 0.2, "0.95": 0.7}, "within_10": {"0.05": 0.3, "0.95": 0.8},
    }  # fmt: skip
    weighted = {name: value / 2 for name, value in plain.items()}
    return DepthRecord(view, plain, weighted, pictures or {}, doubt, reliability if error else {})


def unit(scene: str, method: str, scores: tuple[float, ...] = (20.0, 18.0, 22.0), **changes) -> UnitRecord:
    times = [(index + 1) / (len(scores) + 1) for index in range(len(scores))]
    frames = tuple(frame(t, score) for t, score in zip(times, scores, strict=True))
    values = {
        "key": f"{scene}-{method}", "scene": scene, "first": "a.jpg", "second": "b.jpg", "method": method,
        "status": "done", "baseline": 4.0, "size": SIZE,
        "frames": frames, "worst": worst_frames(frames),
        "temporal": {"warping_error": 0.01, "flicker": 0.002, "end_first": 0.0, "end_second": 0.0},
        "seconds": {stage: index + 0.5 for index, stage in enumerate(STAGES)} | {"total": 8.0},
    }  # fmt: skip
    return UnitRecord(**(values | changes))


def absent(scene: str, method: str, status: str, reason: str) -> UnitRecord:
    return unit(scene, method, (), status=status, reason=reason, temporal={}, seconds={})


def some_records() -> list[UnitRecord]:
    """Two scenes, three methods that measured both or one of them, one that is not there, one scene without truth."""
    return [
        unit("hall", "matching", (26.0, 24.0, 28.0), depths=(depth("a.jpg", 0.1), depth("b.jpg", 0.3))),
        unit("hall", "crossfade", (16.0, 15.0, 17.0), seconds={"fuse": 0.5, "total": 0.5}),
        unit("hall", "oracle-depth", (32.0, 30.0, 34.0), depths=(depth("a.jpg", 0.0), depth("b.jpg", 0.0))),
        unit("street", "matching", (22.0, 20.0, 24.0), baseline=8.0, depths=(depth("a.jpg", 0.2),)),
        unit("street", "crossfade", (15.0, 14.0, 16.0), baseline=8.0, seconds={"fuse": 0.7, "total": 0.7}),
        absent("street", "oracle-depth", "unavailable", "expected true depth, got none"),
        absent("hall", "synsin", "unavailable", "expected the network 'synsin', this version has none"),
        absent("street", "synsin", "unavailable", "expected the network 'synsin', this version has none"),
        absent("campus", "", "skipped", "expected frames between the panoramas, got none"),
    ]


def with_pictures(folder: Path, record: UnitRecord) -> UnitRecord:
    """The record with small pictures of every frame and every depth, written below ``folder``."""
    rng = np.random.default_rng(len(record.method))
    truth = np.tile(np.linspace(0.1, 0.9, SIZE[1])[None, :, None], (SIZE[0], 1, 3))
    (folder / "pictures").mkdir(exist_ok=True)

    def save(name: str, image: np.ndarray) -> str:
        path = f"pictures/{record.scene}-{record.method}-{name}.png"
        write_image(folder / path, image)
        return path

    def of_frame(index: int) -> dict[str, str]:
        image = np.clip(truth + 0.1 * rng.normal(size=truth.shape), 0, 1)
        return {
            "frame": save(f"{index}-frame", np.uint8(255 * image)),
            "truth": save(f"{index}-truth", np.uint8(255 * truth)),
            "error": save(f"{index}-error", error_map(image, truth)),
        }

    inverse_depth = truth[..., 0] / 2
    frames = tuple(
        FrameRecord(f.name, f.t, f.distance, f.scores, of_frame(index)) for index, f in enumerate(record.frames)
    )
    depths = tuple(
        DepthRecord(d.view, d.plain, d.weighted, {
            "depth": save(f"{d.view}-depth", turbo(0.8 * inverse_depth, largest=0.5)),
            "truth": save(f"{d.view}-true-depth", turbo(inverse_depth, largest=0.5)),
        })
        for d in record.depths
    )  # fmt: skip
    return UnitRecord(**(vars(record) | {"frames": frames, "depths": depths}))

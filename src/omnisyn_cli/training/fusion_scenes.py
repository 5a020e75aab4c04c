"""Training data for the fusion network: renderings as the program makes them, and the truth.

The ends of a straight way through a scene are photographed, a little wrong now and then, their depth is estimated or,
for a few, known, and both surfaces are rendered from positions in between. Pictures are stored at twice the size of the
pool, rendered at twice that again. Every position is stored for a network at the size of the pool and, from 128 rows
on, for one at half of it, since frames of several sizes are corrected. Networks that paint see one size.

Instead of new scenes a pool may show walks (:mod:`omnisyn_cli.training.walks`): their ends are the photographs.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from jaxtyping import Float, Float32, Shaped

from omnisyn_cli.errors import InputError
from omnisyn_cli.fusion import input_channels as channel
from omnisyn_cli.fusion import warp_candidates as warp
from omnisyn_cli.fusion.residual import ResidualFuser
from omnisyn_cli.fusion.warp_candidates import WarpCandidates
from omnisyn_cli.geometry.pose import interpolate_pose
from omnisyn_cli.geometry.resize import resize_area
from omnisyn_cli.geometry.sphere import direction_tables, mean_over_sphere
from omnisyn_cli.pipeline.config import DepthSource, RunConfig
from omnisyn_cli.pipeline.depth_sources import make_estimator
from omnisyn_cli.pipeline.presets import DEFAULT_PRESET, PRESETS
from omnisyn_cli.render.mesh import Cut
from omnisyn_cli.scenes import render_panorama
from omnisyn_cli.synthesis.methods import SurfaceMethod
from omnisyn_cli.synthesis.prepared_pair import SynthesisOptions
from omnisyn_cli.synthesis.synthesize import synthesize
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.training.data import Array, load_samples, load_walk, save_samples, stacked, walk_views
from omnisyn_cli.training.scene_makers import SceneConfig, noisy_pose, scene_path, take_photograph
from omnisyn_cli.types import DepthEstimator, Layer, View

# Height of photographs and renderings, and of the stored pictures, in heights of the network inputs.
RENDER_SCALE, PICTURE_SCALE = 4, 2
# Rows from which a pool serves half of them too: of fewer than 64 rows, windows are too narrow for the network.
MIN_HALVED_ROWS = 128
# First channel of the first view, of the second, and how many: what changes places when the views do.
SWAPPED_CHANNELS = (
    (channel.FIRST_RGB, channel.SECOND_RGB, 3),
    (channel.BLEND_WEIGHTS, channel.BLEND_WEIGHTS + 1, 1),
    (channel.SQRT_INVERSE_DEPTHS, channel.SQRT_INVERSE_DEPTHS + 1, 1),
    (channel.SEEN_MASKS, channel.SEEN_MASKS + 1, 1),
    (warp.CROSS_VIEW, warp.CROSS_VIEW + 6, 6),
    *((begin, begin + 3, 3) for begin in (warp.CANDIDATE_RGB, warp.CANDIDATE_RGB + 6)),
    *((begin, begin + 1, 1) for begin in (warp.HYPOTHESIS_OCCLUSION, warp.HYPOTHESIS_OCCLUSION + 2)),
)
# First of the three channels of each picture.
COLOUR_CHANNELS = (
    channel.FIRST_RGB, channel.SECOND_RGB, channel.FUSED_RGB, warp.CROSS_VIEW, warp.CROSS_VIEW + 6,
    *range(warp.CANDIDATE_RGB, warp.HYPOTHESIS_DEPTHS, 3),
)  # fmt: skip
# Channels that are differences of colours.
DIFFERENCE_CHANNELS = [warp.CROSS_VIEW + 3, warp.CROSS_VIEW + 9, *(warp.CANDIDATE_DIFFERENCE + k for k in range(2))]
# Windows have this fraction of the columns of a sample: most pixels teach nothing, and steps get shorter.
WINDOW_DIVISOR = 4
MIN_RELEVANCE = 1e-3  # Relevance of a column without any, so that windows are drawn there as well, now and then
# Difference of √(inverse depth × baseline) between depth hypotheses that matters, and its relevance beside that of a
# contradiction between the views.
MIN_HYPOTHESIS_GAP, HYPOTHESIS_RELEVANCE = 0.05, 0.3
# Where the channels of the stored pictures are when the views change places.
SWAPPED_PICTURES = [*range(3), *range(6, 9), *range(3, 6), *range(12, 15), *range(9, 12)]
# Channels that change their sign then.
SIGNED_CHANNELS = [channel.LOG_WEIGHT_RATIO, channel.DEPTH_GAP, channel.PATH_POSITION]


@dataclass(frozen=True)
class FusionSceneConfig(SceneConfig):
    """How scenes are rendered."""

    views_between: int = 3  # per scene
    position_range: tuple[float, float] = (0.1, 0.9)  # shares of the way between which they lie
    preset: str = DEFAULT_PRESET  # whose depth and renderer they are made with
    matched_share: float = 0.1  # share of scenes whose depth comes from matching alone instead
    known_share: float = 0.1  # share of scenes whose depth is the true one
    rows: int = 1024  # that depth is looked for at
    walks: tuple[Path, ...] = ()  # files of walks to show, the seed's in turn; none makes scenes
    size: tuple[int, int] = (128, 256)

    @property
    def photograph_size(self) -> tuple[int, int]:
        """Height and width of photographs and renderings."""
        return RENDER_SCALE * self.size[0], RENDER_SCALE * self.size[1]


@dataclass(frozen=True)
class FusionBatch:
    """Positions, or some of their columns, for one step, as tensors; one, without the first axis, as arrays."""

    channels: Float[Array, "*batch channels height width"]  # network inputs
    pictures: Float[Array, "*batch 15 rows cols"]  # the fused picture with its candidates
    truth: Float[Array, "*batch 3 rows cols"]  # what is to be seen
    fused_error: Float[Array, "*batch"]  # squared error of the fused picture


class _RecordingFuser(ResidualFuser):
    """Fuses by rules; keeps what networks of several heights would see and choose from, at ``stored_size``."""

    def __init__(self, size: tuple[int, int], heights: Sequence[int], stored_size: tuple[int, int]) -> None:
        super().__init__(size, lambda channels: channels[:4], heights[0], threads=1)
        self._stored_size = stored_size
        self._others = [_RecordingFuser(size, [rows], stored_size) for rows in heights[1:]]
        self.seen: list[tuple[np.ndarray, np.ndarray]] = []

    def __call__(
        self, first: Layer, second: Layer, t: float, out: np.ndarray | None = None,
        confidence: np.ndarray | None = None,
    ) -> np.ndarray:  # fmt: skip
        """See :class:`omnisyn_cli.types.Fuser`; what was seen before is forgotten."""
        self.seen.clear()
        picture = super().__call__(first, second, t, out, confidence)
        for other in self._others:
            picture = other(first, second, t, out, confidence)
            self.seen += other.seen
        return picture

    def correct(
        self, channels: np.ndarray, candidates: WarpCandidates, strength: np.ndarray, picture: np.ndarray
    ) -> None:
        """See :class:`omnisyn_cli.fusion.residual.ResidualFuser`; nothing is corrected."""
        pictures = [picture, *candidates.candidates(self.size)[..., :3]]
        shown = [np.ascontiguousarray(resize_area(each, self._stored_size).transpose(2, 0, 1)) for each in pictures]
        self.seen.append((channels, np.concatenate(shown)))


def make_fusion_scene(folder: Path, seed: int, config: FusionSceneConfig) -> Path | None:
    """Render a seed's scene into a pool; None: no room, or nothing to decide. InputError: its walk has another size."""
    rng = np.random.default_rng([23, seed])
    run_config = replace(PRESETS[config.preset].config, depth=_depth_source(rng.random(), config))
    pair = _pair_of_walk(seed, rng, config) if config.walks else _pair_of_scene(seed, rng, config)
    samples = [] if pair is None else list(_samples(pair, run_config, config))
    if not samples:
        return None
    file = scene_path(folder, seed)
    save_samples(file, [samples[k] for k in rng.permutation(len(samples))])
    return file


@dataclass(frozen=True)
class _TruePair:
    """A pair of photographs, waypoints between them, and the true picture from each, by its index."""

    ends: list[View]
    path: list[Waypoint]
    truth: Callable[[int], Float32[np.ndarray, "height width 3"]]


def _pair_of_scene(seed: int, rng: np.random.Generator, config: FusionSceneConfig) -> _TruePair | None:
    """A generated scene."""
    found = config.scene(seed, 2)
    if found is None:
        return None
    scene, (first, second) = found
    tilt, error, size = float(rng.choice(config.tilts)), config.pose_error(rng), config.photograph_size
    ends = [
        take_photograph(scene, end.position, tilt, error, rng, size, size, supersample=1) for end in (first, second)
    ]
    shares = np.sort(rng.uniform(*config.position_range, config.views_between))
    path = [Waypoint(0, share, interpolate_pose(ends[0].pose, ends[1].pose, share)) for share in shares]
    return _TruePair(ends, path, lambda k: render_panorama(scene, path[k].pose, size, supersample=1, threads=1)[0])


def _pair_of_walk(seed: int, rng: np.random.Generator, config: FusionSceneConfig) -> _TruePair:
    """The ends of the seed's walk, and its views between them."""
    file = config.walks[seed % len(config.walks)]
    walk = load_walk(file)
    if walk.images.shape[1:3] != config.photograph_size:
        expected = "×".join(map(str, reversed(config.photograph_size)))
        raise InputError(f"{file}: expected pictures of {expected}, got {walk.images.shape[2]}×{walk.images.shape[1]}")
    views, error = walk_views(walk), config.pose_error(rng)
    way = views[-1].pose.position
    path = [Waypoint(0, float(view.pose.position @ way / (way @ way)), view.pose) for view in views[1:-1]]
    ends = [replace(view, pose=noisy_pose(view.pose, error, rng)) for view in (views[0], views[-1])]
    return _TruePair(ends, path, lambda k: views[1 + k].image)


def _depth_source(draw: float, config: FusionSceneConfig) -> DepthSource:
    """What a number drawn from [0, 1) decides."""
    if draw < config.matched_share:
        return DepthSource("matching", config.rows)
    if draw < config.matched_share + config.known_share:
        return DepthSource("file")
    return replace(PRESETS[config.preset].config.depth, rows=config.rows)


@lru_cache(maxsize=3)
def _estimator(depth: DepthSource) -> DepthEstimator:
    return make_estimator(depth, device="cpu", threads=1)


def _samples(pair: _TruePair, run_config: RunConfig, config: FusionSceneConfig) -> Iterator[FusionBatch]:
    size, stored_size = config.photograph_size, (PICTURE_SCALE * config.size[0], PICTURE_SCALE * config.size[1])
    rows, by_rules = config.size[0], run_config.fusion_strategy.by_rules
    heights = (rows, rows // 2) if by_rules and rows >= MIN_HALVED_ROWS else (rows,)
    fuser = _RecordingFuser(size, heights, stored_size)
    cut = Cut(run_config.cut, run_config.cut_metres)
    options = SynthesisOptions(size, run_config.renderer_strategy.load(), cut, threads=1)
    method = SurfaceMethod(_estimator(run_config.depth), options, fuser)
    for k, _ in enumerate(synthesize(pair.ends, pair.path, method)):
        if fuser.seen:
            truth = np.ascontiguousarray(resize_area(pair.truth(k), stored_size).transpose(2, 0, 1))
            for channels, pictures in fuser.seen:
                error = mean_over_sphere(np.square(pictures[:3] - truth).transpose(1, 2, 0))
                half, squared = np.float16, np.asarray(error, np.float32)
                yield FusionBatch(channels.astype(half), pictures.astype(half), truth.astype(half), squared)


def draw_fusion(pool: list[Path], rng: np.random.Generator, batch: int) -> FusionBatch:
    """Windows of random places of random scenes, mirrored, lit and tinted otherwise, and with views that change places.

    A window has all rows and a quarter of the columns, preferably where the views contradict each other. All have the
    sizes of the first that is drawn: a pool may hold scenes of several.
    """
    drawn: list[FusionBatch] = []
    while len(drawn) < batch:
        path, which = pool[rng.integers(len(pool))], int(rng.integers(1 << 16))
        sample = load_samples(path, FusionBatch, which, np.float16)[0]
        rows = sample.channels.shape[-2], sample.truth.shape[-2]
        if not drawn or rows == (drawn[0].channels.shape[-2], drawn[0].truth.shape[-2]):
            drawn.append(_augment(sample, rng))
    return stacked(drawn)


def _augment(sample: FusionBatch, rng: np.random.Generator) -> FusionBatch:
    """All that is done to colours is linear, so that blends of varied colours are varied blends."""
    channels, pictures, truth = _window(sample, rng)
    tint = (rng.uniform(0.7, 1.05) * rng.uniform(0.9, 1.1, 3)).astype(np.float32)[:, None, None]
    order = rng.permutation(3) if rng.random() < 0.3 else np.arange(3)
    for begin in COLOUR_CHANNELS:
        channels[begin : begin + 3] = (channels[begin : begin + 3] * tint)[order]
    channels[DIFFERENCE_CHANNELS] *= tint.mean()
    pictures, truth = ((x.reshape(-1, 3, *x.shape[1:]) * tint)[:, order].reshape(x.shape) for x in (pictures, truth))
    if rng.random() < 0.5:
        channels, pictures = swap_views(channels), pictures[SWAPPED_PICTURES]
    if rng.random() < 0.5:
        channels, pictures, truth = (x[..., ::-1] for x in (channels, pictures, truth))
    fused_error = np.asarray(sample.fused_error * np.square(tint).mean(), np.float32)
    channels, pictures, truth = map(np.ascontiguousarray, (channels, pictures, truth))
    return FusionBatch(channels, pictures, truth, fused_error)


def _window(sample: FusionBatch, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Planes and pictures of a quarter of the columns, in single precision."""
    relevance, farthest, nearest = (
        sample.channels[k].astype(np.float32)
        for k in (channel.RELEVANCE, warp.HYPOTHESIS_DEPTHS, warp.HYPOTHESIS_DEPTHS + 1)
    )
    columns = window_columns(relevance + HYPOTHESIS_RELEVANCE * (nearest - farthest > MIN_HYPOTHESIS_GAP), rng)
    finer = sample.truth.shape[-1] // sample.channels.shape[-1]
    fine = (finer * columns[:, None] + np.arange(finer)).ravel()
    channels, pictures, truth = (
        x[..., some].astype(np.float32)
        for x, some in ((sample.channels, columns), (sample.pictures, fine), (sample.truth, fine))
    )
    return channels, pictures, truth


def window_columns(relevance: Shaped[np.ndarray, "height width"], rng: np.random.Generator) -> np.ndarray:
    """A quarter of the columns side by side, across the seam or not, where there is much of what matters."""
    height, width = relevance.shape
    columns = direction_tables(height, width)[0] @ relevance + MIN_RELEVANCE
    sums = np.concatenate([[0.0], np.cumsum(np.concatenate([columns, columns]), dtype=np.float64)])
    inside = sums[width // WINDOW_DIVISOR :][:width] - sums[:width]
    begin = int(rng.choice(width, p=inside / inside.sum()))
    return np.asarray((begin + np.arange(width // WINDOW_DIVISOR)) % width)


def swap_views(channels: Float32[np.ndarray, "channels height width"]) -> Float32[np.ndarray, "channels height width"]:
    """What the network sees when the views change places and the way is walked from its other end."""
    other = channels.copy()
    for first, second, count in SWAPPED_CHANNELS:
        other[first : first + count] = channels[second : second + count]
        other[second : second + count] = channels[first : first + count]
    other[SIGNED_CHANNELS] *= -1.0
    return other

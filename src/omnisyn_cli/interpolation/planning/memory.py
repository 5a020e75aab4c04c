"""The memory that a job will take, estimated from the sizes of what is held at its three peaks."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from omnisyn_cli.compute.threads import frames_at_once
from omnisyn_cli.fusion.ghost_grid import ghost_sample_step
from omnisyn_cli.interpolation.job import InterpolationJob, TourJob, is_rounded, sample_types
from omnisyn_cli.io import read_header
from omnisyn_cli.io.video import frames_in_queue
from omnisyn_cli.pipeline.config import RunConfig

# Bytes of each pixel of a frame that are held for a moment on the way from one form to another; if it is made of
# samples of 8 bits.
FRAME_COPY_BYTES, ROUNDED_COPY_BYTES = 18, 10
# Bytes of each pixel of a frame for how far it can be relied on, and on the way of that to where it goes.
CONFIDENCE_BYTES = 12
WORKER_BYTES = 8  # of each pixel of a frame: what one more thread that makes frames needs besides
# Pixels of a texture with its mip levels, in those of the picture; bytes of each pixel of a panorama as numbers.
MIP_LEVEL_SHARE, FLOAT_PIXEL_BYTES = 4 / 3, 12

# Bytes that finding the depth of one pair leaves lying until that of the next is found; and those of each vertex of a
# surface that are held of the pair after the one at work, and while both are joined.
UNCOLLECTED_BYTES, LOOK_AHEAD_VERTEX_BYTES = 150e6, 4 * 8


@dataclass(frozen=True)
class Footprint:
    """Bytes that something made of surfaces takes."""

    # of each pixel and each vertex until all surfaces are there
    per_pixel: float = 0.0
    per_vertex: float = 0.0
    closing: float = 0.0  # of each vertex when all are there
    writing: float = 0.0  # of each pixel of one picture while it is written
    columns: int | None = None  # that its pictures have at most


@dataclass(frozen=True)
class PriorCost:
    """What a depth network of the user's takes if all pairs ask it."""

    memory: int = 0  # bytes
    seconds: float | None = 0.0  # None if it was never run on this machine
    words: str = ""  # that in the plan


@dataclass(frozen=True)
class MemoryEstimate:
    """What memory is estimated from: the most of what is held at a peak. ImageError: a panorama is unreadable."""

    job: TourJob
    config: RunConfig
    sources: Sequence[tuple[int, int]]  # height and width of the panoramas
    # those of the surfaces, the first one that of a network's answers; refined ones with more than one come to their
    # size by :mod:`omnisyn_cli.stereo.refined_estimator`
    depths: Sequence[tuple[int, int]]
    looks_ahead: bool  # whether the next pair is compared as well
    prior: PriorCost  # of a network of the user's

    @cached_property
    def is_8_bit(self) -> bool:
        """Whether all panoramas are samples of 8 bits."""
        return all(read_header(image).dtype == "uint8" for image in self.job.images)

    @property
    def pixels(self) -> int:
        """Of the largest panorama."""
        return max(height * width for height, width in self.sources)

    @property
    def vertices(self) -> int:
        """Of the largest surface."""
        return max(height * width for height, width in self.depths)

    @property
    def program_bytes(self) -> float:
        """Of the program and all networks for depth."""
        return self.config.depth.bytes_of_program(self.depths) + self.prior.memory

    def of_surfaces(self, footprint: Footprint) -> int:
        """Bytes while depth is found and while something is made of a surface."""
        config, pixels, vertices, count = self.config, self.pixels, self.vertices, len(self.sources)
        program = self.program_bytes
        panorama = FLOAT_PIXEL_BYTES + (3 if self.is_8_bit else FLOAT_PIXEL_BYTES)
        more = (panorama * pixels + UNCOLLECTED_BYTES) if count > 2 else 0.0
        if self.looks_ahead:
            more += panorama * pixels + LOOK_AHEAD_VERTEX_BYTES * vertices
        picture = pixels if footprint.columns is None else min(pixels, footprint.columns**2 // 2)
        kept = count * (footprint.per_pixel * picture + footprint.per_vertex * vertices)
        drawing_bytes = max(
            config.depth.strategy.bytes_of_estimation(self.depths),
            footprint.writing * pixels + config.renderer_strategy.building_bytes * vertices,
            count * footprint.closing * vertices,
        )
        return int(program + 2 * panorama * pixels + more + kept + drawing_bytes)

    def of_frames(self, job: InterpolationJob, size: tuple[int, int]) -> int:
        """Bytes while depth is sharpened, while surfaces are made, and while frames of a size are."""
        config, pixels, vertices = self.config, self.pixels, self.vertices
        source, program = config.depth.strategy, self.program_bytes
        renderer = config.renderer_strategy
        is_kept_as_samples = self.is_8_bit and renderer.shades_on_demand
        kept = (3 if self.is_8_bit else 12) + MIP_LEVEL_SHARE * 4 * (1 if is_kept_as_samples else 4)
        texturing = 4  # numbers are those of both for depth; of the last one again, when it is shown
        frames = _bytes_of_frames(job, config, size) + FLOAT_PIXEL_BYTES * pixels
        if not config.draws_surfaces:
            return int(program + 2 * kept * pixels + frames)
        depth_bytes = source.bytes_of_estimation(self.depths)
        if source.refines(self.depths):
            depth_bytes += 2 * FLOAT_PIXEL_BYTES * pixels
        ahead = 0.0
        if self.looks_ahead:
            ahead = (FLOAT_PIXEL_BYTES + (3 if self.is_8_bit else 0)) * pixels + LOOK_AHEAD_VERTEX_BYTES * vertices
            ahead += UNCOLLECTED_BYTES
        texturing_surfaces = 2 * renderer.building_bytes * vertices + 2 * (FLOAT_PIXEL_BYTES + texturing) * pixels
        frames += 2 * renderer.kept_bytes * vertices
        return int(program + 2 * kept * pixels + ahead + max(depth_bytes, texturing_surfaces, frames))


def _bytes_of_frames(job: InterpolationJob, config: RunConfig, size: tuple[int, int]) -> float:
    """What making frames takes: two surfaces as seen, marks of pixels, the pyramid of holes, frames under way."""
    pixels = size[0] * size[1]
    largest_sample = max(np.dtype(kind).itemsize for kind in sample_types(job))
    if not config.draws_surfaces:
        return pixels * (16 + 12 + 3 * largest_sample * (frames_in_queue(size) + 2) + 1.5)
    pyramid, planes = 16 / 3, 1.5
    renderer, fusion = config.renderer_strategy, config.fusion_strategy
    is_held = not renderer.shades_on_demand or (fusion.by_rules and ghost_sample_step(size) == 1)
    is_judged = config.faded_below > 0.0 or config.confidence
    marked = 1 if config.edges and renderer.shades_on_demand and fusion.by_rules else 0
    frame = ROUNDED_COPY_BYTES if is_rounded(job) else 12 + FRAME_COPY_BYTES
    held, judged = 16 if is_held else 0, CONFIDENCE_BYTES if is_judged else 0
    whole = 2 * (renderer.pixel_bytes + held) + 1 + marked + frame + judged + pyramid
    made = frames_at_once(size, job.threads) if renderer.shades_on_demand and fusion.by_rules else 1
    waiting = 3 * largest_sample * (frames_in_queue(size) + 1 + made)
    kept = made + (made > 1 and job.ease == "smooth")  # where the camera is slow, frames are made one after the other
    return fusion.network_bytes(pixels) + pixels * (kept * whole + (made - 1) * WORKER_BYTES + waiting + planes)

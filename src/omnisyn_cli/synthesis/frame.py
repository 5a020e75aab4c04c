"""A frame between two panoramas: both surfaces seen from a waypoint, given one exposure, joined to one picture."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float32, Shaped, UInt8

from omnisyn_cli.compute.stopwatch import Stopwatch
from omnisyn_cli.fusion.photometry import ExposureMatcher
from omnisyn_cli.geometry.perspective import pixels_per_radian
from omnisyn_cli.geometry.pose import distance_between, rotation_vector_from_rotation
from omnisyn_cli.synthesis.prepared_pair import PreparedPair, SynthesisOptions
from omnisyn_cli.synthesis.trajectory import Waypoint
from omnisyn_cli.types import Fuser

Samples = UInt8[np.ndarray, "height width 3"]
FrameAllocator = Callable[[], Samples]


# Pixels by which everything may be seen aside of where it was in the frame before for that to be shown again.
MAX_SHIFT_PIXELS = 0.25
MAX_REUSE_T_STEP = 1.0 / 512.0  # a share of the way that changes no colour by more than half of one of 256 levels


@dataclass(frozen=True)
class Frame:
    """One picture of the video."""

    # RGB, >= 0, a buffer that the next frame overwrites; or samples of 8 bits
    image: Float32[np.ndarray, "height width 3"] | UInt8[np.ndarray, "height width 3"]
    waypoint: Waypoint  # where it was taken
    # index of the panorama that is shown unchanged, if it is shown unchanged and unturned, else None
    panorama: int | None
    # in [0, 1], if asked for; 1 everywhere in a photograph
    confidence: Float32[np.ndarray, "height width"] | None = None
    is_shown_again: bool = False  # whether it is the frame before, in which nothing would be seen aside of where it was


@dataclass(frozen=True)
class FusedFrame:
    """A frame and what it was made of, in buffers that the next one overwrites."""

    frame: Frame
    nearest: Callable[[], float]  # the greatest inverse depth that either view sees, 1/metre
    pixels_per_radian: float

    def looks_the_same_from(self, waypoint: Waypoint) -> bool:
        """Whether nothing in the frame would be seen more than a quarter of a pixel aside from there."""
        before = self.frame.waypoint
        if abs(waypoint.t - before.t) > MAX_REUSE_T_STEP:
            return False
        angle = MAX_SHIFT_PIXELS / self.pixels_per_radian
        turned = np.linalg.norm(rotation_vector_from_rotation(before.pose.rotation.T @ waypoint.pose.rotation))
        moved = distance_between(before.pose, waypoint.pose)
        if turned > angle or moved == 0.0:
            return bool(turned <= angle)
        return bool(turned + moved * self.nearest() <= angle)

    def again(self, waypoint: Waypoint, samples: FrameAllocator | None) -> Frame:
        """The frame at another place; samples, which are kept until they are written, in memory of their own."""
        image = self.frame.image
        if samples is not None and image.dtype == np.uint8:
            image = samples()
            image[:] = self.frame.image
        return replace(self.frame, image=image, waypoint=waypoint, is_shown_again=True)


def fuse_frame(
    pair: PreparedPair, waypoint: Waypoint, fuser: Fuser, options: SynthesisOptions, clock: Stopwatch,
    samples: Samples | None,
) -> FusedFrame:  # fmt: skip
    """The frame of two renderings that were given one exposure, rounded into ``samples`` if they are given."""
    is_judged = options.confidence or pair.cross_fade is not None
    confidence = np.empty(options.size, np.float32) if is_judged else None
    with clock("render"):
        target_from_sources = (waypoint.pose.inverse() @ pose for pose in pair.poses)
        seen = [render(pose) for render, pose in zip(pair.renderers, target_from_sources, strict=True)]
    with clock("fuse"):
        first, second = ExposureMatcher(pair.cross_check.curve)(seen[0], seen[1], waypoint.t)
        asked = {"out": samples, "confidence": confidence}
        image = fuser(first, second, waypoint.t, **{name: kept for name, kept in asked.items() if kept is not None})
        frame = finish_frame(pair, image, confidence, waypoint)
    return FusedFrame(
        frame, lambda: max(float(view.inverse_depth.max()) for view in seen), pixels_per_radian(options.size)
    )


# Makes the frame at a waypoint, rounded into samples if they are given; the clock collects seconds by stage.
FrameMaker = Callable[[Waypoint, Samples | None, Stopwatch], FusedFrame]


def finish_frame(
    pair: PreparedPair, image: Shaped[np.ndarray, "height width 3"],
    confidence: Float32[np.ndarray, "height width"] | None, waypoint: Waypoint,
) -> Frame:  # fmt: skip
    """The frame of a fused picture, in which doubtful regions and what is masked are faded."""
    if pair.cross_fade is not None and confidence is not None:
        pair.cross_fade(image, confidence, waypoint.pose, waypoint.t)
    if pair.masked_fade is not None:
        pair.masked_fade(image, waypoint.pose, waypoint.t)
    return Frame(image, waypoint, None, confidence)

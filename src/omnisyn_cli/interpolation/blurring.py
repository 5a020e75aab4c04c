"""People in panoramas made unrecognizable: areas of mask pictures, or faces that a detector finds.

What is blurred is gone from all that is made of a panorama, as it is blurred when it is read; its file stays.

Source: Wu et al., "YuNet: A Tiny Millisecond-level Face Detector", 2023; OpenCV's FaceDetectorYN runs it.
"""

import os
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
from jaxtyping import Bool, Float, Shaped

from omnisyn_cli.errors import InputError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.geometry.sphere import pixel_directions
from omnisyn_cli.interpolation.job import FACE_MODEL_VARIABLE, FACES, TourJob, reading_of
from omnisyn_cli.io.images import Panorama, read_mask
from omnisyn_cli.stereo.monocular_answer import perspective_pictures, perspective_size, picture_rotations
from omnisyn_cli.types import View

# Averaged cells around the horizon, 2.8° each: half a face at 2 m; and across what is larger than they. Set by hand.
CELLS_AROUND, CELLS_ACROSS = 128, 4
# Sides of perspective pictures, of 90° each: faces of 10 pixels are found, which are 8 m away at 1280.
MIN_PICTURE_SIDE, MAX_PICTURE_SIDE = 320, 1280
# Least score of a face, low as a face too many does no harm; overlap from which on two are one; most of a picture.
DETECTION = (0.6, 0.3, 200)
FACE_MARGIN = 1.4  # axes of the ellipse that is blurred, in those of the box that was found
MAX_SEARCH_ROWS = 1024  # at which faces are drawn into the area


def check_blur(job: TourJob) -> None:
    """Refuse (InputError) another number of mask pictures than of panoramas, or faces without a detector's file."""
    if job.blur == (FACES,):
        _detector(job, MIN_PICTURE_SIDE)
    elif FACES in job.blur or len(job.blur) not in (0, len(job.images)):
        raise InputError(
            f"expected one mask to blur for each of {len(job.images)} panoramas in their order, or {FACES} alone, got "
            f"{len(job.blur)}; name as many"
        )


def blurred_panorama(job: TourJob, index: int, panorama: Panorama) -> Panorama:
    """A panorama of the job without what is to be blurred in it. ImageError: a mask cannot be read."""
    if not job.blur:
        return panorama
    rows, columns = panorama.image.shape[:2]
    if job.blur == (FACES,):
        side = min(max(rows // 2 // 32 * 32, MIN_PICTURE_SIDE), MAX_PICTURE_SIDE)
        area = face_area(panorama.image, _detector(job, side))
    else:
        reading = replace(reading_of(job), size=(rows, columns))
        area = ~read_mask(job.blur[index], allow_aspect=job.allow_aspect, max_pixels=job.max_pixels, reading=reading)
    original = None if panorama.original is None else blur(panorama.original, area)
    return replace(panorama, image=blur(panorama.image, area), original=original)


def blur(
    samples: Shaped[np.ndarray, "height width 3"], area: Bool[np.ndarray, "height width"]
) -> Shaped[np.ndarray, "height width 3"]:
    """Samples whose area shows means of cells instead, smoothly joined: what was there cannot be had back."""
    _, labels, figures, _ = cv2.connectedComponentsWithStats(area.astype(np.uint8))
    height, width = area.shape
    extents = figures[:, [cv2.CC_STAT_WIDTH, cv2.CC_STAT_HEIGHT]].max(axis=1) * CELLS_AROUND / (CELLS_ACROSS * width)
    doubled = np.ceil(np.log2(np.maximum(extents, 1.0))).astype(int)  # how often cells are, for the larger areas
    result = samples.copy()
    for times in {*doubled[1:].tolist()}:
        inside = area & (doubled[labels] == times)
        grid = (max(CELLS_AROUND >> times, 1), max(CELLS_AROUND // 2 >> times, 1))
        means = cv2.resize(samples.astype(np.float32), grid, interpolation=cv2.INTER_AREA)
        smooth = cv2.resize(means, (width, height), interpolation=cv2.INTER_LINEAR)
        result[inside] = smooth[inside].astype(samples.dtype)
    return result


def face_area(image: Float[np.ndarray, "height width 3"], detector: "cv2.FaceDetectorYN") -> Bool[np.ndarray, "h w"]:
    """Where faces are in a panorama, as perspective pictures all around show them to the detector."""
    side = detector.getInputSize()[0]
    rows, rotations = min(image.shape[0], MAX_SEARCH_ROWS), picture_rotations()
    directions, area = pixel_directions(rows, 2 * rows), np.zeros((rows, 2 * rows), bool)
    pictures = perspective_pictures(View(image, Pose.identity()), rotations, perspective_size((side, side)))
    for picture, rotation in zip(pictures, rotations, strict=True):
        in_bgr = np.rint(255.0 * np.clip(picture[..., ::-1], 0.0, 1.0)).astype(np.uint8)
        _, faces = detector.detect(np.ascontiguousarray(in_bgr))
        for left, top, *box in () if faces is None else faces[:, :4].astype(float):
            seen = directions @ rotation
            ahead = np.where(seen[..., 2] < 0.0, -seen[..., 2], np.nan)
            x, y = (0.5 * side * (1.0 + sign * seen[..., k] / ahead) for k, sign in ((0, 1.0), (1, -1.0)))
            width, height = (FACE_MARGIN * length / 2.0 for length in box)
            area |= ((x - left - box[0] / 2.0) / width) ** 2 + ((y - top - box[1] / 2.0) / height) ** 2 <= 1.0
    return cv2.resize(area.astype(np.uint8), image.shape[1::-1], interpolation=cv2.INTER_NEAREST) > 0


def _detector(job: TourJob, side: int) -> "cv2.FaceDetectorYN":
    """The detector of pictures of a side; InputError: there is no file for it, or none that it can use."""
    named, reason = job.face_model or os.environ.get(FACE_MODEL_VARIABLE), "no such file"
    if named and Path(named).is_file():
        cv2.utils.logging.setLogLevel(cv2.utils.logging.LOG_LEVEL_ERROR)  # it warns of choices of its own
        try:
            detector = cv2.FaceDetectorYN.create(str(named), "", (side, side), *DETECTION)
            detector.detect(np.zeros((side, side, 3), np.uint8))
        except (cv2.error, SystemError) as error:
            reason = f"{' '.join(str(error).split()):.120}"
        else:
            return detector
    found = f"{named} ({reason})" if named else "none"
    raise InputError(
        f"expected the file of a YuNet face detector for --blur {FACES}, got {found}; get "
        "face_detection_yunet_2023mar.onnx from github.com/opencv/opencv_zoo (models/face_detection_yunet), name it "
        f"(--face-model FILE, or {FACE_MODEL_VARIABLE} in the environment)"
    )

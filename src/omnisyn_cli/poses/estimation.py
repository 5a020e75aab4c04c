"""Poses checked against the pictures, corrected by them, or found in them alone.

Pairs are taken in the order of the panoramas; every picture is read once. What pictures cannot tell is kept or assumed:
the distance between two panoramas, and how the first one was held.
"""

from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path

import numpy as np
from jaxtyping import Bool

from omnisyn_cli.errors import InputError, PoseError
from omnisyn_cli.geometry.pose import Pose
from omnisyn_cli.io import MAX_PIXELS, read_panorama
from omnisyn_cli.io.decode import check_is_file
from omnisyn_cli.io.images import usable_part
from omnisyn_cli.io.outputs import real_path
from omnisyn_cli.io.placement import DEFAULT_READING, Reading
from omnisyn_cli.poses.file import PosedPanorama, PoseFile, check_names_tell_apart, distinct_names
from omnisyn_cli.poses.registration.diagnosis import Diagnosis, diagnose
from omnisyn_cli.poses.registration.features import Features, Matches, find_features, match_features
from omnisyn_cli.poses.registration.least_squares import relative_pose
from omnisyn_cli.poses.registration.robust import Estimate, estimate_relative_pose, inlier_threshold, support_mask

__all__ = ["PairDiagnosis", "PictureOptions", "check_poses", "estimate_poses", "refine_poses"]

DEFAULT_BASELINE = 1.0
"""Metres between two panoramas where no baseline is given."""


@dataclass(frozen=True)
class PictureOptions:
    """How pictures are read.

    Attributes:
        allow_aspect: see :func:`omnisyn_cli.io.read_panorama`.
        threads: at most this many; None is one per core.
        max_pixels: see :func:`omnisyn_cli.io.read_panorama`.
        masks: an image for every panorama that is black where it must not be used, besides those of poses; or none.
        nadir: radians around straight down that must not be used: tripod, roof of a car.
        reading: what the files do not say of their pictures.
    """

    allow_aspect: bool = False
    threads: int | None = None
    max_pixels: int = MAX_PIXELS
    masks: tuple[Path, ...] = ()
    nadir: float = 0.0
    reading: Reading = DEFAULT_READING


@dataclass(frozen=True)
class PairDiagnosis:
    """A pair and what is wrong with its poses.

    Attributes:
        first, second: the images.
        diagnosis: what the matches say.
        matches: of both.
        fits: ``(n,)`` the matches that agree with the poses given.
    """

    first: Path
    second: Path
    diagnosis: Diagnosis
    matches: Matches
    fits: Bool[np.ndarray, " n"]


@dataclass(frozen=True)
class FoundPoses:
    """Poses that come from the pictures.

    Attributes:
        panoramas: entries by what a pose file calls the images.
        notes: what was assumed, changed or left as it was, one sentence each.
        changed: number of pairs whose relative pose comes from the pictures.
    """

    panoramas: Mapping[str, PosedPanorama]
    notes: tuple[str, ...]
    changed: int


def check_poses(
    images: Sequence[Path], pose_file: PoseFile, options: PictureOptions | None = None
) -> Iterator[PairDiagnosis]:
    """Judge the poses of all neighbours, one after the other.

    Raises:
        InputError: fewer than two panoramas, another number of masks, or an image or mask that cannot be used.
        PoseError: no entry for one, or two of one name.
    """
    _check_images(images)
    check_names_tell_apart(images, pose_file)
    entries = [pose_file.of(image) for image in images]
    pairs = _matched_pairs(images, [entry.mask for entry in entries], options or PictureOptions())
    for (first, second), (a, b), matches in zip(pairwise(images), pairwise(entries), pairs, strict=True):
        fits = support_mask(relative_pose(a.pose, b.pose), matches, inlier_threshold(matches))
        yield PairDiagnosis(first, second, diagnose(a.pose, b.pose, matches), matches, fits)


def refine_poses(images: Sequence[Path], pose_file: PoseFile, options: PictureOptions | None = None) -> FoundPoses:
    """Correct rotation and direction of every panorama but the first where that makes the pictures fit better.

    Distances between neighbours stay. A pair is left as it is where too few matches agree, where nothing is gained, and
    where its poses contradict the pictures, which is a mistake to be found and not an inaccuracy. Later panoramas move
    along with the earlier ones. InputError, PoseError: as :func:`check_poses`; also for a panorama that is named twice.
    """
    _check_images(images, may_repeat=False)
    entries, notes, changed = dict(pose_file.panoramas), [], 0
    for pair in check_poses(images, pose_file, options):
        first, second = (pose_file.of(image).pose for image in (pair.first, pair.second))
        relative = first.inverse() @ second
        if pair.diagnosis.is_refinable and pair.diagnosis.estimate is not None:
            found = pair.diagnosis.estimate.first_from_second
            relative = Pose(found.rotation, found.position * np.linalg.norm(relative.position))
            changed += 1
        former, name = (pose_file.name_of(image) for image in (pair.first, pair.second))
        entries[name] = replace(entries[name], pose=entries[former].pose @ relative)
        notes.append(f"{pair.first.name} and {pair.second.name}: {_refinement_note(pair.diagnosis)}")
    return FoundPoses(entries if changed else pose_file.panoramas, tuple(notes), changed)


def estimate_poses(
    images: Sequence[Path], baselines: Sequence[float] = (), options: PictureOptions | None = None
) -> FoundPoses:
    """Find the poses of panoramas in the pictures.

    The first one is put at the origin, level and looking along −z, whatever it was.

    ``images`` are in walking order; ``baselines`` are the metres between neighbours, one for all pairs or one for each,
    and :data:`DEFAULT_BASELINE` without any.

    Raises:
        InputError: fewer than two, one named twice, unusable images, or another number of baselines or masks.
        PoseError: too few matches between two neighbours.
    """
    _check_images(images, may_repeat=False)
    if not baselines:
        note = f"neighbours are taken to be {DEFAULT_BASELINE:g} m apart: pictures do not tell how far (--baseline)"
    else:
        note = f"distances between neighbours as given ({', '.join(f'{length:g}' for length in baselines)} m)"
    notes = [f"{images[0].name} is taken for level and looks along −z, at the origin", note]
    lengths = _lengths(baselines or (DEFAULT_BASELINE,), len(images) - 1)
    pose = Pose.identity()
    names = distinct_names(images)
    entries = {names[0]: PosedPanorama(pose)}
    pairs = _matched_pairs(images, [None] * len(images), options or PictureOptions())
    for (first, second), name, length, matches in zip(pairwise(images), names[1:], lengths, pairs, strict=True):
        estimate = estimate_relative_pose(matches)
        if estimate is None:
            raise PoseError(
                f"{first} and {second}: expected more matches that agree with a pose than by chance, got too few "
                f"(of {len(matches)}); give their poses in a file, or take panoramas that have more in common"
            )
        relative = estimate.first_from_second
        pose = pose @ Pose(relative.rotation, relative.position * length)
        entries[name] = PosedPanorama(pose)
        notes.append(f"{first.name} and {second.name}: {_estimate_note(estimate, matches)}")
    return FoundPoses(entries, tuple(notes), len(images) - 1)


def _check_images(images: Sequence[Path], *, may_repeat: bool = True) -> None:
    if len(images) < 2:
        raise InputError(f"expected two or more panoramas, got {len(images)}; name at least a first and a second one")
    image, count = Counter(map(real_path, images)).most_common(1)[0]
    if count > 1 and not may_repeat:
        raise InputError(f"expected every panorama once, got '{image.name}' several times; name it once")
    for image in images:
        check_is_file(image)


def _lengths(baselines: Sequence[float], pairs: int) -> list[float]:
    if len(baselines) not in (1, pairs):
        raise InputError(f"expected one baseline, or one for each of {pairs} pairs, got {len(baselines)}; name as many")
    if not all(np.isfinite(length) and length > 0 for length in baselines):
        raise InputError(f"expected baselines above 0 m, got {', '.join(map(str, baselines))}; measure them")
    return list(baselines) * (pairs if len(baselines) == 1 else 1)


def _matched_pairs(images: Sequence[Path], masks: Sequence[Path | None], options: PictureOptions) -> Iterator[Matches]:
    if options.masks and len(options.masks) != len(images):
        raise InputError(f"expected one mask for each of {len(images)} panoramas, got {len(options.masks)}")
    given = options.masks or (None,) * len(images)
    features = (_features(image, both, options) for image, *both in zip(images, masks, given, strict=True))
    for first, second in pairwise(features):
        yield match_features(first, second)


def _features(image: Path, masks: Sequence[Path | None], options: PictureOptions) -> Features:
    panorama = read_panorama(
        image, allow_aspect=options.allow_aspect, max_pixels=options.max_pixels, reading=options.reading
    )
    usable = usable_part(
        panorama.mask, panorama.image.shape[:2], masks, options.nadir,
        allow_aspect=options.allow_aspect, max_pixels=options.max_pixels,
        reading=replace(options.reading, view_transform=False),
    )  # fmt: skip
    return find_features(panorama.image, usable, options.threads)


def _estimate_note(estimate: Estimate, matches: Matches) -> str:
    agreed = f"{int(estimate.inliers.sum())} of {len(matches)} matches agree"
    if estimate.have_same_position:
        return f"{agreed} with a turn on the spot, no distance between them can be seen; both get one position"
    spread = np.degrees([estimate.residual, estimate.uncertainty.rotation, estimate.uncertainty.direction])
    return f"{agreed} within {spread[0]:.3f}° (median); rotation ± {spread[1]:.3f}°, direction ± {spread[2]:.3f}°"


def _refinement_note(diagnosis: Diagnosis) -> str:
    given, estimate = diagnosis.given, diagnosis.estimate
    if given is None or estimate is None:
        return f"too few of {diagnosis.matches} matches agree; the poses stay as they are"
    if diagnosis.is_refinable:
        before, after = np.degrees([given.residual, estimate.residual])
        turned, moved = np.degrees([given.rotation, given.direction])
        return (
            f"rotation corrected by {turned:.3f}° and direction by {moved:.3f}°; median residual {before:.3f}° before, "
            f"{after:.3f}° now"
        )
    see = "; the poses stay as they are, see `omnisyn poses check`"
    if diagnosis.explanations:
        return f"it looks as if {diagnosis.explanations[0].hypothesis.words}{see}"
    if diagnosis.verdict == "contradiction":
        return f"they contradict the pictures (rotation off by {np.degrees(given.rotation):.1f}°){see}"
    if diagnosis.verdict == "in place":
        return "taken from one place, so that no direction can be seen; the poses stay as they are"
    return "refining gains nothing; the poses stay as they are"

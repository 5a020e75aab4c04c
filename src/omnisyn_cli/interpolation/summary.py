"""What was done: how long it took, and how far it can be relied on, in figures and in words."""

import math
import shlex
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from statistics import fmean, median
from typing import Any, ClassVar

import numpy as np
from jaxtyping import Float

from omnisyn_cli.errors import InputError
from omnisyn_cli.fusion.confidence import PairConfidence
from omnisyn_cli.geometry.pose import distance_between, interpolate_pose
from omnisyn_cli.geometry.sphere import direction_to_angles
from omnisyn_cli.interpolation.job import POSES_FROM_PICTURES
from omnisyn_cli.interpolation.plan import InterpolationPlan, TourPlan
from omnisyn_cli.pipeline.config import MIN_PAIR_SCORE
from omnisyn_cli.poses.registration.diagnosis import camera_height_sentence, is_plausible_camera_height

# Least score of a word. Set by hand.
CONFIDENCE_WORDS = ((0.6, "high"), (0.45, "medium"), (MIN_PAIR_SCORE, "low"), (0.0, "very low"))
# Of the sphere that may be unseen, in disagreement or inconsistent without advice about it. Set by hand.
MAX_GOOD_SHARE = 0.02
# Of the distance of the nearest wall that panoramas may be apart. Set by hand.
MAX_SPACING_SHARE = 0.75
# Eighths of a turn, clockwise from the centre of the picture.
DIRECTIONS = (
    "ahead", "ahead to the right", "to the right", "behind to the right", "behind", "behind to the left",
    "to the left", "ahead to the left",
)  # fmt: skip
# Elevations from which on a direction is straight up or down, and below which it is level.
MIN_STEEP_DEG, MAX_LEVEL_DEG = 60.0, 15.0


@dataclass(frozen=True)
class TourSummary:
    """What was done, whatever was made; :func:`omnisyn_cli.interpolation.loading.tour_surfaces` fills it."""

    plan: TourPlan  # what was planned
    seconds: dict[str, float] = field(default_factory=dict)  # wall time by stage; ``total`` is all of it
    # how far what is made of two panoramas can be relied on, by the index of the first
    pairs: dict[int, PairConfidence] = field(default_factory=dict)
    # share of the sphere that moves with the camera or is painted over, by the index of the panorama
    left_out: dict[int, float] = field(default_factory=dict)
    # metres to the nearest wall or thing at the height of the cameras, by the same index
    walls: dict[int, float | None] = field(default_factory=dict)
    results: dict[str, Any] = field(default_factory=dict)  # what was made, as plain values

    advice: ClassVar[str] = "show a cross-fade there (--fallback crossfade)"
    """What to do about a doubtful pair where nothing else helps."""

    @property
    def confidence(self) -> dict[str, Any] | None:
        """The score of all is that of the worst pair; the shares are the means. None: nobody knows."""
        if not self.plan.config.draws_surfaces:
            return None
        described = {index: pair.describe() for index, pair in self.pairs.items()}
        pairs = [{"first": index, "is_faded": self.is_faded(index), **pair} for index, pair in described.items()]
        columns = {key: [pair[key] for pair in described.values()] for key in next(iter(described.values()), {})}
        score = min(columns.pop("score", [1.0]))
        return {"score": score, **{key: round(fmean(values), 4) for key, values in columns.items()}, "pairs": pairs}

    def is_faded(self, index: int) -> bool:
        """Whether the photographs of a pair are cross-faded where its confidence is low; a walk's are everywhere."""
        return self.pairs[index].scored_db < self.plan.config.faded_below

    def __repr__(self) -> str:
        worst = f", confidence {min(pair.score for pair in self.pairs.values()):.2f}" if self.pairs else ""
        what = f"{self.plan.job.output}: {self.plan.what()} in {self.seconds['total']:.1f} s"
        return f"{type(self).__name__}({what}{worst})"

    def describe(self) -> dict[str, Any]:
        """The summary as plain values, for people and for JSON."""
        stages = {stage: round(value, 3) for stage, value in self.seconds.items()}
        left_out = [{"panorama": index, "share": round(share, 4)} for index, share in sorted(self.left_out.items())]
        described = {**self.plan.describe(), **self.results, "left_out": left_out}
        return {**described, "stages": stages, "confidence": self.confidence}

    def lines(self, *, is_report_possible: bool = True) -> Iterator[str]:
        """For people: what was left out, how far the worst pair can be relied on, where it is weakest, what to try."""
        if self.left_out:
            shares = [f"{share:.1%} of {self.plan.job.images[k].name}" for k, share in sorted(self.left_out.items())]
            more = f" and {len(shares) - 2} more" if len(shares) > 2 else ""
            why = "because it moves with the camera or is painted over"
            yield f"left out, {why}: {', '.join(shares[:2])}{more} (--nadir 0 keeps it)"
        if not self.pairs:
            return
        index = min(self.pairs, key=lambda each: self.pairs[each].score)
        worst = self.pairs[index]
        word = next(word for least, word in CONFIDENCE_WORDS if worst.score >= least)
        weakest = np.array(worst.weakest)
        faded = ", cross-faded" if self.is_faded(index) else ""
        yield f"confidence: {word} ({worst.score:.2f}){faded}, weakest {self.place(index, weakest)}"
        if remedies := list(self._remedies(index)):
            yield f"to try: {', '.join(remedies)} (docs/confidence.md)"
        if word != CONFIDENCE_WORDS[0][1] and is_report_possible:
            yield f"to see why: {shlex.join(self._report_command())}"

    @property
    def found_baseline(self) -> float | None:
        """Mean metres between neighbours that poses from the pictures were scaled to; None where others gave metres."""
        job = self.plan.job
        if job.poses != POSES_FROM_PICTURES or job.camera_height is not None:
            return None
        return self.plan.length / (len(self.plan.entries) - 1)

    def place(self, index: int, direction: Float[np.ndarray, " 3"]) -> str:
        """Where that is, in words, for a direction half way between the panoramas of a pair."""
        first, second = (self.plan.job.images[view] for view in self.plan.pairs[index])
        return f"between {first.name} and {second.name}, {direction_in_words(direction)}"

    def _report_command(self) -> list[str]:
        """The words of the command that writes a page about the pairs, with the same poses and metres."""
        job = self.plan.job
        more = [str(job.poses)]
        if job.poses == POSES_FROM_PICTURES:
            scales = {"--baseline": job.baseline, "--camera-height": job.camera_height}
            more = [word for option, metres in scales.items() if metres for word in (option, f"{metres:g}")]
        angles = {"--hfov": job.hfov, "--vfov": job.vfov}
        more += [word for option, angle in angles.items() if angle for word in (option, f"{math.degrees(angle):g}")]
        more += ["--upper-half"] * job.upper_half
        return ["omnisyn", "info", *map(str, job.images), *more, "--report", "report.html"]

    def closer_together(self, index: int) -> str:
        """The spacing that would do for a pair, where depth shows that it has a longer one."""
        first, second = (self.plan.entries[view].pose for view in self.plan.pairs[index])
        wall, spacing = self.walls.get(index), distance_between(first, second)
        if wall is None or spacing <= MAX_SPACING_SHARE * wall:
            return "panoramas closer together"
        most = f"at most {MAX_SPACING_SHARE * wall:.2g} m apart here"
        return f"panoramas {most}, not {spacing:.2g} m, as the nearest wall is {wall:.2g} m away"

    def _remedies(self, index: int) -> Iterator[str]:
        """What may raise the score of a pair; of advice that was tried on 14 real places, what did."""
        pair, (high, medium) = self.pairs[index], (least for least, _ in CONFIDENCE_WORDS[:2])
        is_below = math.degrees(math.asin(pair.weakest[1])) < -MIN_STEEP_DEG
        if is_below and pair.score >= medium and not (self.plan.job.nadir or self.left_out):
            yield "--nadir 25 if a tripod shows"  # of a poor pair it takes ground that matched
        if pair.score >= high:
            return
        if pair.depth_disagreement > MAX_GOOD_SHARE and self.plan.job.poses != POSES_FROM_PICTURES:
            yield "omnisyn poses check"
        yield self.closer_together(index)
        if pair.inconsistency > MAX_GOOD_SHARE:
            yield "--mask if people or things moved"

    def warnings(self) -> list[str]:
        """A line for every pair that scores too low to be relied on."""
        return [
            warning_about(self.plan, index, pair, self.advice, is_faded=self.is_faded(index))
            for index, pair in self.pairs.items()
            if pair.score < MIN_PAIR_SCORE
        ]


@dataclass(frozen=True, repr=False)
class Summary(TourSummary):
    """What was done for a video. Encoding runs beside the other stages: ``encode`` is the time that they waited for it.

    Pairs are named by the index of the first panorama; those without a frame of their own are left out.
    """

    plan: InterpolationPlan
    # how many are ``photographs``, were ``rendered``, or are the one before ``shown_again``
    frames: Counter[str] = field(default_factory=lambda: Counter(photographs=0, rendered=0, shown_again=0))
    # how many are drawn for each frame of a pair, and how many its two meshes have
    triangles: dict[int, tuple[int, int]] = field(default_factory=dict)
    # share of the sphere that has no parallax, the mean of both panoramas of a pair
    infinitely_far: dict[int, float] = field(default_factory=dict)
    # metres of the cameras above the floor, of pairs that show it
    camera_heights: dict[int, float] = field(default_factory=dict)
    remarks: list[str] = field(default_factory=list)  # about what went otherwise than planned

    def warnings(self) -> list[str]:
        """Also what went otherwise than planned."""
        return [*self.remarks, *super().warnings()]

    @property
    def camera_height(self) -> float | None:
        """The median of the pairs."""
        return median(self.camera_heights.values()) if self.camera_heights else None

    def modelled(self) -> dict[str, Any]:
        """That as plain values."""
        triangles = [{"first": index, "drawn": drawn, "of": every} for index, (drawn, every) in self.triangles.items()]
        far = [{"first": index, "share": round(share, 4)} for index, share in self.infinitely_far.items()]
        heights = [{"first": index, "metres": round(height, 3)} for index, height in self.camera_heights.items()]
        made = {"frames_made": dict(self.frames), "triangles": triangles, "infinitely_far": far}
        return {**made, "camera_heights": heights}

    def modelled_in_words(self) -> Iterator[str]:
        """That for people who ask for more."""
        yield ", ".join(f"{count} {kind.replace('_', ' ')}" for kind, count in self.frames.items())
        drawn, every = (sum(counts[k] for counts in self.triangles.values()) for k in (0, 1))
        if every:
            yield f"triangles drawn: {drawn / 1e6:.2f} of {every / 1e6:.2f} million"
        if self.infinitely_far:
            yield f"infinitely far: {fmean(self.infinitely_far.values()):.0%} of the sphere"
        if self.camera_height is not None:
            yield f"height of the cameras above the floor: {self.camera_height:.2f} m"

    def lines(self, *, is_report_possible: bool = True) -> Iterator[str]:
        """Also an unusual height of the cameras: distances are wrong then."""
        yield from super().lines(is_report_possible=is_report_possible)
        height = self.camera_height
        if height is not None and not is_plausible_camera_height(height):
            yield camera_height_sentence(height, self.found_baseline)

    def place(self, index: int, direction: Float[np.ndarray, " 3"]) -> str:
        """The time in the video and the direction in its picture then."""
        path = self.plan.path
        number = min(range(len(path)), key=lambda k: abs(path[k].segment + path[k].t - index - 0.5))
        first, second = (entry.pose for entry in self.plan.entries[index : index + 2])
        half_way = interpolate_pose(first, second, 0.5)
        shown = path[number].pose.rotation.T @ half_way.rotation @ direction
        return f"around {number / self.plan.job.fps:.1f} s, {direction_in_words(shown)}"


def direction_in_words(direction: Float[np.ndarray, " 3"]) -> str:
    """Where somebody who looks at the centre of a picture finds a direction in the frame of its camera."""
    azimuth, polar_angle = (math.degrees(angle) for angle in direction_to_angles(direction))
    elevation = 90.0 - polar_angle
    if abs(elevation) > MIN_STEEP_DEG:
        return "straight up" if elevation > 0 else "straight down"
    side = DIRECTIONS[round(azimuth / 360.0 * len(DIRECTIONS)) % len(DIRECTIONS)]
    if abs(elevation) < MAX_LEVEL_DEG:
        return side
    return f"{side}, {'above' if elevation > 0 else 'below'} the horizon"


def refuse_doubtful(plan: TourPlan, index: int, pair: PairConfidence) -> None:
    """Give up (InputError) on a pair that cannot be relied on, if that is what the plan wants then."""
    if plan.config.fallback == "fail" and pair.score < MIN_PAIR_SCORE:
        raise InputError(warning_about(plan, index, pair))


def warning_about(
    plan: TourPlan, index: int, pair: PairConfidence, advice: str = TourSummary.advice, *, is_faded: bool = False
) -> str:
    """What is wrong with a pair, what was done about it and what to do, in one line."""
    first, second = (plan.job.images[view] for view in plan.pairs[index])
    closer = "take panoramas that are closer together"
    return (
        f"{first.name} and {second.name}: expected a confidence of at least {MIN_PAIR_SCORE:g}, got {pair.score:.2f} "
        f"({pair.unseen:.0%} unseen, {pair.depth_disagreement:.0%} in disagreement)"
        + (f"; cross-faded: check the poses, or {closer}" if is_faded else f"; check the poses, {closer}, or {advice}")
    )

"""``omnisyn interpolate``: the 360° video between posed panoramas."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from omnisyn_cli.cli.help import SectionedCommand
from omnisyn_cli.cli.options import (
    check_one_cut,
    device_option,
    json_option,
    listed,
    named,
    quiet_option,
    surface_options,
    tour_options,
)
from omnisyn_cli.cli.parameters import (
    DegreeRange,
    FilePath,
    FiniteRange,
    FramePlace,
    FrameRate,
    Seconds,
    Size,
    WholeRange,
)
from omnisyn_cli.cli.runner import run_job
from omnisyn_cli.cli.terminal import say
from omnisyn_cli.errors import InputError
from omnisyn_cli.pipeline.config import FALLBACKS
from omnisyn_cli.pipeline.fusions import FUSIONS
from omnisyn_cli.pipeline.methods import METHODS, OMNISYN
from omnisyn_cli.pipeline.renderers import RENDERERS

if TYPE_CHECKING:
    from omnisyn_cli.interpolation.plan import InterpolationPlan
    from omnisyn_cli.interpolation.summary import Summary


@click.command(cls=SectionedCommand)
@tour_options
@click.option(
    "-o", "--output", type=FramePlace(),
    help="Video (.mp4, .mov), folder of frames, or a pattern like frames/%05d.png.  [default: FOLDER.mp4 or A-C.mp4, "
    "here]",
)  # fmt: skip
@click.option("--path", metavar="A,B[,C...]", help="Follow the links of the folder from A to B.")
@click.option(
    "--every", metavar="SECONDS", type=Seconds(0, min_open=True),
    help="Take panoramas at this interval from a 360° video.",
)  # fmt: skip
@click.option("--frames", type=WholeRange(2), help="Number of frames.  [default: from --duration and --fps]")
@click.option("--duration", type=FiniteRange(0, min_open=True), help="Seconds.  [default: 3 per pair]")
@click.option("--fps", type=FrameRate(), default=30.0, help="Frames per second, such as 25 or 30000/1001.")
@click.option(
    "--size", type=Size(is_free=True),
    help="Size of the video, such as 2048x1024.  [default: that of the largest panorama, in H.264 at most 4096x2048]",
)  # fmt: skip
@click.option(
    "--method", type=click.Choice([name for name, method in METHODS.items() if method.is_offered]), default=OMNISYN,
    help="omnisyn, or the baseline SynSin from the nearer panorama or from both (256x128, blurred).",
)  # fmt: skip
@surface_options
@click.option(
    "--budget", metavar="SECONDS", type=FiniteRange(0, min_open=True),
    help="Pick the most accurate preset that should finish in this time.",
)  # fmt: skip
@click.option(
    "--renderer", type=click.Choice(["auto", *RENDERERS]), default="auto",
    help=f"Renderer of the meshes. {listed(RENDERERS)}; auto: the preset's.",
)  # fmt: skip
@click.option(
    "--adaptive/--no-adaptive", default=None,
    help="Draw flat surfaces with fewer triangles; nothing moves by more than an eighth of a pixel.  [default: from "
    "33 frames per pair on]",
)  # fmt: skip
@click.option(
    "--fusion", type=click.Choice(["auto", *FUSIONS]), default="auto",
    help=f"How two renderings become one frame. {listed(FUSIONS)}; auto: the preset's, but geometric "
    "with --depth, depth files or frames on a GPU.",
)  # fmt: skip
@click.option(
    "--ease", type=click.Choice(["linear", "smooth"]), default="linear",
    help="Constant speed, or a gentle start and stop.",
)  # fmt: skip
@click.option(
    "--heading", type=click.Choice(["panoramas", "first", "fixed", "travel"]), default="panoramas",
    help="Where the image centre looks. panoramas: from one panorama's heading to the next; first: that of the "
    "first; fixed: the world's −z; travel: along the path.",
)  # fmt: skip
@click.option(
    "--codec", type=click.Choice(["h264", "h265", "av1", "prores", "png", "jpg", "exr", "tif"]),
    help="Codec of the video, or format of the frames.  [default: h264, or png for a folder]",
)  # fmt: skip
@click.option(
    "--crf", type=float,
    help="Quality of the encoder (CRF), lower is better; h264 at 0 is lossless, which few players support.  [default: "
    "17 for h264]",
)  # fmt: skip
@click.option("--encoder-preset", help="Speed of the encoder, such as veryfast or slow.  [default: the codec's own]")
@click.option("--nadir-fill", is_flag=True, help="Fill masked areas with ground in the first and last frame, too.")
@click.option(
    "--fallback", type=click.Choice(list(FALLBACKS)), default="auto",
    help="For poor pairs. auto: the worst are cross-faded where confidence is low; crossfade: all are; none: a "
    "warning; fail: exit code 3.",
)  # fmt: skip
@click.option(
    "--audio", metavar="FILE", type=FilePath(),
    help="Sound of the video, from any file with some; cut or padded to fit.",
)  # fmt: skip
@click.option(
    "--save-confidence", metavar="FILE", type=FilePath(), help="Save the confidence of every pixel as a video."
)
@click.option("--save-depth", metavar="FOLDER", type=FilePath(), help="Save the depth of every panorama (EXR, metres).")
@click.option(
    "--save-frames", metavar="FOLDER", type=FramePlace(),
    help="Save the frames as images too: PNG, or a pattern such as DIR/%05d.jpg.",
)  # fmt: skip
@click.option(
    "--view", "views", metavar="flat|FILE", multiple=True, type=FilePath(),
    help="flat: an ordinary video instead of a 360° one. FILE (.html): also write a page to walk in, see `omnisyn "
    "view`.",
)  # fmt: skip
@click.option(
    "--fov", metavar="DEGREES", type=DegreeRange(10, 150), help="Horizontal angle of a flat video.  [default: 90]"
)
@click.option(
    "--look", metavar="WHERE",
    help="Where a flat video looks: ahead, first (the centre of the first panorama), YAW,PITCH in degrees from there, "
    "or a JSON file of keyframes.  [default: ahead]",
)  # fmt: skip
@click.option(
    "--stereo", type=click.Choice(["mono", "top-bottom"]), default="mono",
    help="top-bottom: both eyes for headsets. Distances have to be in metres.",
)  # fmt: skip
@device_option(
    "What makes frames and runs networks; auto uses a GPU where numba-cuda and ONNX Runtime have one. All else runs on "
    "the processor (docs/gpu.md)."
)
@click.option("--overwrite", is_flag=True, help="Replace the output if it exists.")
@click.option("--dry-run", is_flag=True, help="Print the plan and the expected time, and make nothing.")
@json_option("the summary")
@click.option("-v", "--verbose", is_flag=True, help="Print the seconds of every stage, and mesh statistics.")
@quiet_option
def interpolate(
    *, as_json: bool, dry_run: bool, verbose: bool, quiet: bool, budget: float | None,
    views: tuple[Path, ...], every: float | None, **options: Any,
) -> None:  # fmt: skip
    """Make a 360° video from panorama A to B, and on through C and more.

    \b
    omnisyn interpolate a.jpg b.jpg --poses auto --baseline 1.4
    omnisyn interpolate tour/ -o walk.mp4 --ease smooth --size 4096x2048
    omnisyn interpolate a.jpg b.jpg c.jpg -o frames/ --frames 12
    omnisyn interpolate walk.mp4 --every 2s

    FOLDER means the panoramas in its poses.json, in the order of that file. With --poses auto it means all pictures in
    it, in an order found from their matches.

    With the default --heading, the first and the last frame are the panoramas themselves.

    Put `--` before names that begin with a dash.
    """  # noqa: D301 - click's \b is a backspace
    from omnisyn_cli.interpolation.inputs import video_ending
    from omnisyn_cli.interpolation.job import InterpolationJob
    from omnisyn_cli.interpolation.plan import plan_interpolation

    check_one_cut(options)
    options |= _views(views)
    if options["size"] is not None and options["projection"] != "flat":
        Size().convert("{1}x{0}".format(*options["size"]), None, click.get_current_context())
    options |= _frames_of_video(options, every)
    if budget is not None:
        _check_budget_decides(options["method"])
    given = named(options, lambda: video_ending(options["codec"]))

    def plan_of(job: InterpolationJob) -> InterpolationPlan:
        plan = plan_interpolation(job)
        if budget is not None:
            from omnisyn_cli.interpolation.planning.duration import apply_budget

            plan = apply_budget(plan, budget)
        return plan

    run_job(
        InterpolationJob(**given), plan_of, "run:run_interpolation",
        lambda made: _print_summary(made, verbose=verbose), as_json=as_json, dry_run=dry_run, quiet=quiet,
        expected=_expected, frames=lambda plan: len(plan.path), is_report_possible=every is None,
    )  # fmt: skip


def _views(given: tuple[Path, ...]) -> dict[str, Any]:
    """The projection of the video, and the page to walk in, of what ``--view`` was given."""
    pages = [path for path in given if str(path) != "flat"]
    if len(pages) > 1:
        raise click.UsageError(f"expected one page (--view FILE), got {len(pages)}; leave out all but one")
    projection = "equirectangular" if len(pages) == len(given) else "flat"
    return {"view": pages[0] if pages else None, "projection": projection}


def _frames_of_video(options: dict[str, Any], every: float | None) -> dict[str, Any]:
    """Panoramas, poses and output where one video is given; its frames are there as long as the command runs."""
    from omnisyn_cli.interpolation.inputs import video_ending
    from omnisyn_cli.io.ffmpeg_process import VIDEO_SUFFIXES, frames_of_video
    from omnisyn_cli.io.outputs import check_kept

    video, *others = options["images"]
    is_video = not others and video.suffix.lower() in VIDEO_SUFFIXES
    if is_video == (every is None):
        found, remedy = (f"the video {video}", "add --every 2s") if is_video else ("others", "leave --every out")
        raise InputError(f"expected one video for --every, or panoramas without it, got {found}; {remedy}")
    if every is None:
        return {}
    output = options["output"] or Path(f"{video.stem}-tour{video_ending(options['codec'])}")
    check_kept([output], [video])
    frames = click.get_current_context().with_resource(frames_of_video(video, every))
    return {"images": frames, "poses": options["poses"] or Path("auto"), "output": output}


def _expected(plan: InterpolationPlan) -> dict[str, Any]:
    """What the job is expected to take."""
    from omnisyn_cli.interpolation.planning.duration import expected_duration

    duration = expected_duration(plan)
    if duration is None:
        return {"expected_seconds": None, "expected_range": None, "expected_words": ""}
    return {
        "expected_seconds": round(duration.seconds, 1),
        "expected_range": [round(bound, 1) for bound in duration.bounds],
        "expected_words": duration.words,
    }


def _check_budget_decides(method: str) -> None:
    """Refuse a preset beside a budget, and methods that have none."""
    from click.core import ParameterSource

    if click.get_current_context().get_parameter_source("preset") is ParameterSource.COMMANDLINE:
        raise click.UsageError("expected --preset or --budget, which chooses one, got both; leave one of them out")
    if not METHODS[method].draws_surfaces:
        raise click.UsageError(f"expected --budget only with --method {OMNISYN}, got {method}; leave one of them out")


def _print_summary(summary: Summary, *, verbose: bool) -> None:
    if verbose:
        for stage, seconds in summary.seconds.items():
            say(f"{stage:>8}: {seconds:8.2f} s", err=True)
        for line in summary.modelled_in_words():
            say(line, err=True)
    height, width = summary.plan.frame_size
    frames, total = len(summary.plan.path), summary.seconds["total"]
    say(f"{summary.plan.job.output}: {frames} frames of {width}x{height} in {total:.1f} s")
    if summary.plan.job.view is not None:
        say(f"{summary.plan.job.view}: a walk through {len(summary.plan.entries)} panoramas")

"""Codecs and sound, and the ffmpeg arguments for them.

Videos are converted to BT.709 and tagged as that. Sound is added while frames are encoded.
"""

import functools
import re
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any

import ffmpeg
import imageio_ffmpeg

from omnisyn_cli.errors import EncodingError, InputError, OutputPathError
from omnisyn_cli.io.encode import is_ambiguous

X26X_PRESETS = (
    "ultrafast", "superfast", "veryfast", "faster", "fast", "medium", "slow", "slower", "veryslow", "placebo",
)  # fmt: skip

PRORES_PROFILES = ("proxy", "lt", "standard", "hq")  # in the order of FFmpeg's numbers, from 0
# What most encoders work on; for it frames are converted here (:mod:`.yuv`) and not by ffmpeg.
PLANAR_FORMAT = "yuv420p"
# ffmpeg's names of the frames that are handed to it, where it converts them.
RAW_FORMATS = {"uint8": "rgb24", "uint16": "rgb48le"}


@dataclass(frozen=True)
class VideoCodec:
    """One way to encode."""

    encoders: tuple[str, ...]  # ffmpeg's encoders for it, the best first
    crf: int | None  # the default constant quality, None where there is none; lower is better
    # rows of the largest video of 2:1 that players in use show; None where nobody plays them
    player_rows: int | None = None
    largest_crf: int = 51  # the end of its scale
    preset: str = "medium"  # the default
    presets: tuple[str, ...] = X26X_PRESETS  # from fast to slow (ProRes: from small to large)
    suffixes: tuple[str, ...] = (".mp4", ".mov", ".m4v")  # endings of the files that hold it
    # ffmpeg's pixel format by the type of the frames
    pixel_formats: Mapping[str, str] = field(default_factory=lambda: {"uint8": PLANAR_FORMAT, "uint16": "yuv420p10le"})
    tag: str | None = None  # the sample entry's name where ffmpeg's own choice is not played everywhere


# By the name that users choose.
CODECS: Mapping[str, VideoCodec] = {
    "h264": VideoCodec(("libx264",), 17, 2048, preset="veryfast", pixel_formats={"uint8": PLANAR_FORMAT}),
    "h265": VideoCodec(("libx265",), 20, 4096, tag="hvc1"),
    "av1": VideoCodec(
        ("libsvtav1", "libaom-av1"), 28, 4096, 63, "8", tuple(str(speed) for speed in range(13, -1, -1)), (".mp4",)
    ),
    "prores": VideoCodec(
        ("prores_ks",), None, None, 0, "hq", PRORES_PROFILES, (".mov",), dict.fromkeys(RAW_FORMATS, "yuv422p10le")
    ),
}
# Containers by the name's ending; left alone, ffmpeg makes of .m4v an iPod's, without H.265 and without colours.
MUXERS = {".mp4": "mp4", ".m4v": "mp4", ".mov": "mov"}
# Frame rates of television, which are written rounded to two or three decimals.
NTSC_RATES = tuple(Fraction(1000 * rate, 1001) for rate in (24, 30, 48, 60, 120))
# Removes x264's SEI message with its settings (and threads) from the video: equal pictures are equal files.
STRIP_SEI_FILTER = "filter_units=remove_types=6"
SLOWEST_AOM_SPEED = 8  # libaom's speeds end here; SVT-AV1's go on to 13.


AAC_BITRATE = "192k"  # of two channels: no difference is heard. Set by hand.
MAX_GAP_SECONDS = 0.05  # at the end of a video, that nobody hears


@dataclass(frozen=True)
class Soundtrack:
    """The first sound of a file, cut or padded with silence to the length of a video."""

    path: Path  # any file with sound that ffmpeg reads, a video too
    codec: str  # ffmpeg's name
    seconds: float  # that it lasts
    video_seconds: float

    @property
    def is_short(self) -> bool:
        """Whether silence follows it."""
        return self.seconds < self.video_seconds - MAX_GAP_SECONDS

    def is_copied(self, video: Path) -> bool:
        """Whether it stays as it is, instead of being encoded as AAC: silence cannot follow then."""
        is_playable = self.codec == "aac" or (self.codec.startswith("pcm_") and video.suffix.lower() == ".mov")
        return is_playable and not self.is_short

    def in_words(self, video: Path) -> str:
        """What becomes of it, in one line."""
        fit = "padded with silence" if self.is_short else "cut"
        if abs(self.seconds - self.video_seconds) <= MAX_GAP_SECONDS:
            fit = "as long as the video"
        else:
            fit = f"{self.seconds:.1f} s, {fit} to the {self.video_seconds:.1f} s of the video"
        return f"{self.path.name}: sound, {fit}, {'copied' if self.is_copied(video) else 'encoded as AAC'}"

    def stream(self) -> Any:
        """The input of ffmpeg; no list in the file makes it open another one."""
        return ffmpeg.input(f"file:{self.path.absolute()}", protocol_whitelist="file")["a:0"]

    def options(self, video: Path) -> dict[str, Any]:
        """Arguments of ffmpeg's output."""
        length = {"t": f"{self.video_seconds:.6f}", "map_metadata": -1, "map_chapters": -1}
        if self.is_copied(video):
            return {"c:a": "copy", **length}
        return {"c:a": "aac", "b:a": AAC_BITRATE, "af": "apad", **length}


@dataclass(frozen=True)
class EncoderSettings:
    """How a video is encoded, see :class:`omnisyn_cli.io.video.Encoding`; None takes the codec's default."""

    size: tuple[int, int]
    fps: float | Fraction
    codec: str = "h264"
    crf: float | None = None
    preset: str | None = None
    threads: int = 0
    dtype: str = "uint8"
    stereo_mode: str | None = "mono"  # which no encoder sees
    soundtrack: Soundtrack | None = None


def check_settings(path: Path, settings: EncoderSettings) -> None:
    """Refuse what no encoder would take, before any work.

    OutputPathError: the name's ending does not go with the codec. InputError: odd or empty size, unknown codec, a frame
    rate, quality, preset or sample type out of range.
    """
    if settings.codec not in CODECS:
        raise InputError(f"expected a codec among {', '.join(CODECS)}, got '{settings.codec}'; choose one of them")
    codec = CODECS[settings.codec]
    if path.suffix.lower() not in codec.suffixes:
        folder = " (a folder of frames: end its name with /)" if is_ambiguous(path) else ""
        raise OutputPathError(
            f"{path}: expected a name ending in {' or '.join(codec.suffixes)} for {settings.codec}, got "
            f"'{path.suffix}'; change the name or the codec{folder}"
        )
    height, width = settings.size
    if height < 2 or width < 2 or height % 2 or width % 2:
        raise InputError(f"expected an even width and height for video, got {width}×{height}; choose an even size")
    if not (0 < settings.fps <= 1000 and as_fraction(settings.fps) > 0):
        raise InputError(f"expected a frame rate from 0.001 to 1000 per second, got {settings.fps}; choose another")
    if settings.preset is not None and settings.preset not in codec.presets:
        raise InputError(f"expected a preset among {', '.join(codec.presets)}, got '{settings.preset}'; choose one")
    if settings.crf is not None and codec.crf is None:
        raise InputError(f"expected no quality for {settings.codec}, got {settings.crf}; choose a preset instead")
    if settings.crf is not None and not 0 <= settings.crf <= codec.largest_crf:
        scale = f"0 (largest file) to {codec.largest_crf}"
        raise InputError(f"expected a quality from {scale} for {settings.codec}, got {settings.crf}; choose another")
    if settings.dtype not in codec.pixel_formats:
        raise InputError(
            f"expected {' or '.join(codec.pixel_formats)} frames for {settings.codec}, got {settings.dtype}; "
            "convert the frames or choose another codec"
        )


def as_fraction(fps: float | Fraction) -> Fraction:
    """The nearest rate that containers can say; 23.976, 23.98, 29.97, 47.95, 59.94 and 119.88 stand for n·1000/1001."""
    for exact in NTSC_RATES:
        if fps in (round(float(exact), 2), round(float(exact), 3)):
            return exact
    return Fraction(fps).limit_denominator(1001)


def raw_format(settings: EncoderSettings) -> str:
    """Name, in ffmpeg, of the frames that :func:`encoder_command` expects."""
    wanted = CODECS[settings.codec].pixel_formats[settings.dtype]
    return PLANAR_FORMAT if wanted == PLANAR_FORMAT else RAW_FORMATS[settings.dtype]


def encoder_command(path: Path, settings: EncoderSettings) -> list[str]:
    """The command that reads raw frames of :func:`raw_format` from its standard input and writes ``path``.

    RGB is converted to limited-range BT.709 with exact rounding, and tagged as that: left alone, ffmpeg converts to
    untagged BT.601, which a BT.709 player shows up to 28/255 wrong. The rate is said for the output too, because ffmpeg
    takes the input's for 120 where it is 120000/1001.
    """
    codec = CODECS[settings.codec]
    encoder = _available_encoder(settings.codec, ffmpeg_program())
    height, width = settings.size
    rate = str(as_fraction(settings.fps))
    expected = raw_format(settings)
    frames = ffmpeg.input("pipe:0", format="rawvideo", pix_fmt=expected, s=f"{width}x{height}", framerate=rate)
    if expected != PLANAR_FORMAT:
        flags = "bicubic+accurate_rnd+full_chroma_int"
        frames = frames.filter("scale", out_color_matrix="bt709", out_range="tv", flags=flags)
        frames = frames.filter("format", codec.pixel_formats[settings.dtype])
    converted = frames.filter("setparams", colorspace="bt709", color_primaries="bt709", color_trc="bt709", range="tv")
    options = {"r": rate, "c:v": encoder, "threads": settings.threads, **_quality_options(encoder, settings, codec)}
    if codec.tag:
        options["tag:v"] = codec.tag
    muxer = MUXERS[path.suffix.lower()]
    sound = settings.soundtrack
    streams = [converted] if sound is None else [converted, sound.stream()]
    options |= {"an": None} if sound is None else sound.options(path)
    output = ffmpeg.output(*streams, f"file:{path.absolute()}", format=muxer, **options)
    quiet = output.global_args("-hide_banner", "-nostats", "-loglevel", "error")
    command: list[str] = ffmpeg.compile(quiet, cmd=ffmpeg_program(), overwrite_output=True)
    return command


@functools.cache
def ffmpeg_program() -> str:
    """Path of imageio-ffmpeg's program, or what ``IMAGEIO_FFMPEG_EXE`` names; EncodingError: none for this platform."""
    try:
        return str(imageio_ffmpeg.get_ffmpeg_exe())
    except RuntimeError as error:
        raise EncodingError(f"expected ffmpeg, got '{error}'; set IMAGEIO_FFMPEG_EXE to its path") from error


@functools.cache
def _available_encoder(codec: str, program: str) -> str:
    """The best of a codec's encoders that this ffmpeg has."""
    listing = subprocess.run(  # noqa: S603 - the program is imageio-ffmpeg's own
        [program, "-hide_banner", "-encoders"], capture_output=True, text=True, errors="replace", check=False
    )
    names = re.findall(r"^ [VAS][A-Z.]{5} (\S+)", listing.stdout, re.MULTILINE)
    for encoder in CODECS[codec].encoders:
        if encoder in names:
            return encoder
    raise EncodingError(
        f"expected an ffmpeg with {' or '.join(CODECS[codec].encoders)}, got {program} without; "
        "choose another codec or set IMAGEIO_FFMPEG_EXE to a fuller ffmpeg"
    )


def _quality_options(encoder: str, settings: EncoderSettings, codec: VideoCodec) -> dict[str, Any]:
    """Arguments for quality, speed, threads and silence, each encoder in its own dialect."""
    preset, crf = settings.preset or codec.preset, codec.crf if settings.crf is None else settings.crf
    threads = settings.threads
    if encoder == "prores_ks":
        return {"profile:v": preset, "vendor": "apl0"}
    if encoder == "libsvtav1":
        # SVT-AV1 takes whole numbers only.
        options: dict[str, Any] = {"preset": preset, "crf": round(crf or 0)}
        return {**options, "svtav1-params": f"lp={threads}"} if threads else options
    if encoder == "libaom-av1":
        return {"cpu-used": min(int(preset), SLOWEST_AOM_SPEED), "crf": round(crf or 0), "row-mt": 1}
    if encoder == "libx265":
        pools = f":pools={threads}" if threads else ""
        return {"preset": preset, "crf": crf, "x265-params": f"log-level=error:info=0{pools}"}
    return {"preset": preset, "crf": crf, "bsf:v": STRIP_SEI_FILTER}

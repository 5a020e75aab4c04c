"""The sound of a video: what a file has of it, and how ffmpeg adds it while frames are encoded."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import ffmpeg

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

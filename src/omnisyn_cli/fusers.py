"""How two renderings become one picture, by name: what the commands offer as ``--fusion``.

``geometric``: by rules. ``network``: by rules that a network corrects where the views contradict each other.
``painting``: a network paints all of it, as in the paper.
"""

from __future__ import annotations

from omnisyn_cli.fusion import GeometricFuser
from omnisyn_cli.presets import FUSION_MODELS, FUSIONS
from omnisyn_cli.types import Fuser

__all__ = ["make_fuser"]


def make_fuser(
    name: str, size: tuple[int, int], *, model: str | None = None, device: str = "auto", threads: int | None = None
) -> Fuser:
    """A fuser for frames of a size.

    Args:
        name: one of :data:`omnisyn_cli.presets.FUSIONS`.
        size: height and width of the frames.
        model: name in the manifest or path of an ONNX file; by default that of
            :data:`omnisyn_cli.presets.FUSION_MODELS`.
        device: where the network runs: ``auto``, ``cpu`` or ``cuda``.
        threads: at most this many; None is one per core.

    Raises:
        ValueError: an unknown name.
        InputError: the model cannot be found or loaded, or not on that device.
    """
    if name not in FUSIONS:
        raise ValueError(f"expected a fusion of {', '.join(FUSIONS)}, got {name!r}")
    if name == "geometric":
        return GeometricFuser(size, threads=threads)
    from omnisyn_cli.runtime.fusion import SessionFusion, SessionPainter
    from omnisyn_cli.runtime.models import find_model
    from omnisyn_cli.runtime.session import open_session

    session = open_session(find_model(model or FUSION_MODELS[name]), device=device, threads=threads)
    if name == "painting":
        from omnisyn_cli.fusion.painting import PaintingFuser

        return PaintingFuser(size, SessionPainter(session), threads=threads)
    from omnisyn_cli.fusion.network import NetworkFuser

    return NetworkFuser(size, SessionFusion(session), threads=threads)

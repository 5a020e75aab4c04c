"""SynSin without training: networks in closed form about the hall, and small random ones as ONNX files."""

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from omnisyn_cli.geometry.sphere import pixel_directions
from synthesis_samples import RADIUS

TINY_SIZE = (32, 64)


@dataclass
class HallNetworks:
    """SynSin's sessions with true depth and plain colours; positions are told, in the order of the panoramas."""

    positions: list[np.ndarray]
    size: tuple[int, int] = (64, 128)
    radius: float = 1.5
    points: int = 32
    looked_at: int = field(default=0, init=False)

    @property
    def estimator(self) -> SimpleNamespace:
        return SimpleNamespace(inverse_depth=self.inverse_depth)

    def inverse_depth(self, image: np.ndarray) -> np.ndarray:
        position = self.positions[self.looked_at]
        self.looked_at += 1
        along = pixel_directions(*self.size) @ position
        return (1.0 / (-along + np.sqrt(along**2 + RADIUS**2 - position @ position))).astype(np.float32)

    def features(self, image: np.ndarray) -> np.ndarray:
        return image

    def picture(self, points: np.ndarray) -> np.ndarray:
        return np.clip(points[..., :3] / np.maximum(points[..., 3:], 1e-6), 0.0, 1.0).astype(np.float32)


def write_synsin_models(folder: Path) -> Path:
    """Small untrained networks under the names that the program looks for, with a manifest."""
    import torch

    from omnisyn_cli.networks.synsin import SynSinConfig
    from omnisyn_cli.training.checkpoint import publish, save_checkpoint
    from omnisyn_cli.training.loop import Trainer
    from omnisyn_cli.training.tasks import TrainConfig

    tiny = SynSinConfig("tiny", TINY_SIZE, features=6, depth_widths=(6, 8), decoder_widths=(6, 8, 8), fine=4, points=8)
    torch.manual_seed(0)
    save_checkpoint(folder / "fresh.pt", Trainer(tiny, TrainConfig("", "", size=TINY_SIZE)).state())
    publish(folder / "fresh.pt", folder)
    return folder

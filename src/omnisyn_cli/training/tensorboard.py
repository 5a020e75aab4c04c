"""What a run logs, for TensorBoard as well: figures as curves, pictures beside them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from jaxtyping import Float32

from omnisyn_cli.errors import InputError
from omnisyn_cli.io.paths import write_errors

__all__ = ["Board"]


class Board:
    """Event files in a folder.

    Args:
        folder: that ``tensorboard --logdir`` is pointed at; made if it is not there.

    Raises:
        InputError: TensorBoard is not installed.
        WriteError: the folder cannot be written.
    """

    def __init__(self, folder: Path) -> None:
        try:
            from torch.utils.tensorboard import SummaryWriter
        except ImportError as error:
            raise InputError(
                "expected the package tensorboard for --tensorboard, found none; pip install tensorboard"
            ) from error
        self._folder = folder
        with write_errors(folder):
            self._writer = SummaryWriter(str(folder))

    def add(
        self, row: Mapping[str, float], pictures: Mapping[str, Float32[np.ndarray, "height width 3"]] | None = None
    ) -> None:
        """Add a row of the log at its ``step``, and pictures by name; they have reached the disk when this returns.

        Args:
            row: of the log, with ``step``.
            pictures: RGB in [0, 1].
        """
        step = int(row["step"])
        with write_errors(self._folder):
            for name, value in row.items():
                if name != "step":
                    self._writer.add_scalar(name, value, step)
            for name, picture in (pictures or {}).items():
                self._writer.add_image(name, picture, step, dataformats="HWC")
            self._writer.flush()

    def close(self) -> None:
        """Close the event file."""
        self._writer.close()
